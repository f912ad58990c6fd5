"""Files of influence tables, which any finite-element program can write.

Their layout is described with `save_influence`.
"""

import io
import json
import zipfile
import zlib
from pathlib import Path

import numpy as np

from gearjax.checks import GearjaxError, check_path, place
from gearjax.files import write_file
from gearjax.geometry.involute import InvoluteGear
from gearjax.influence.table import InfluenceTable, gear_definition, gear_hash, hash_of

FORMAT, VERSION = "gearjax influence table", 1
UNITS = {"radius": "m", "face": "m", "matrix": "m/N"}
ARRAYS = ("radius", "face", "matrix")


def save_influence(
    path: str | Path, table: InfluenceTable, gear: InvoluteGear, made: dict[str, str] | None = None
) -> Path:
    """Write an influence table to a file, in a layout that any finite-element program can write.

    A file is an archive ``.npz`` of numpy with four arrays::

        header   text, shape (): JSON with the keys below
        radius   float64, shape (r,) [m]: as in `InfluenceTable`, like the next two
        face     float64, shape (f,) [m]
        matrix   float64, shape (distance, r f, r f) [m/N]

        format   "gearjax influence table"
        version  1
        units    {"radius": "m", "face": "m", "matrix": "m/N"}
        gear     {"teeth", "internal": "yes" or "no", "module", "pressure_angle", "profile_shift", "addendum",
                 "dedendum"}, all values as texts, numbers in SI units and radians as printf writes them with %.6g
        made     {...}: how the table was made, as any texts: material, rim, mesh
        sha256   SHA-256 of the JSON text of {"gear": gear, "made": made}, keys sorted, no blanks, in hexadecimal digits

    ``gearjax.influence.table.hash_of({"gear": gear, "made": made})`` returns the value of ``sha256``.

    Args:
        path: path of the file, ``.npz``.
        table: table to be written.
        gear: gear that the table was made for.
        made: how the table was made, in words.

    Raises:
        GearjaxError: the table was made for another gear, or the file cannot be written.
    """
    table.check_gear(gear)
    return write_arrays(path, gear, made or {}, *(np.asarray(getattr(table, name)) for name in ARRAYS))


def write_arrays(
    path: str | Path, gear: InvoluteGear, made: dict[str, str], radius: np.ndarray, face: np.ndarray, matrix: np.ndarray
) -> Path:
    """Write an influence table to a file, from its arrays."""
    check_path("--out", path)
    definition = {"gear": gear_definition(gear), "made": made}
    header = {"format": FORMAT, "version": VERSION, "units": UNITS, **definition, "sha256": hash_of(definition)}
    content = io.BytesIO()
    np.savez(content, header=np.array(json.dumps(header)), radius=radius, face=face, matrix=matrix)
    return write_file(Path(path), content.getvalue())


def read_influence(path: str | Path, gear: InvoluteGear) -> InfluenceTable:
    """Read an influence table from a file, in the layout of `save_influence`.

    Args:
        path: path of the file.
        gear: gear that the table will be used for.

    Raises:
        GearjaxError: the file is missing, damaged, not of this layout or made for another gear, or its numbers cannot
            be an influence (see `InfluenceTable`).

    Example:
        >>> import jax.numpy as jnp
        >>> import gearjax as gj
        >>> gear = InvoluteGear(40, *map(jnp.asarray, (1e-3, 0.35, 0.0, 1.0, 1.25)))
        >>> gj.read_influence("teeth.npz", gear)
        Traceback (most recent call last):
            ...
        gearjax.checks.GearjaxError: teeth.npz: cannot be read (No such file or directory)
    """
    check_path("influence table", path)
    header, arrays = _contents(Path(path))
    _check_header(path, header)
    definition = {"gear": header["gear"], "made": header["made"]}
    if hash_of(definition) != header["sha256"]:
        raise GearjaxError(
            f"{place(path)}: sha256 does not match gear and made; right is {hash_of(definition)[:12]}..."
        )
    if definition["gear"] != gear_definition(gear):
        theirs, ours = definition["gear"], gear_definition(gear)
        key = next(key for key in (*ours, *theirs) if theirs.get(key) != ours.get(key))
        raise GearjaxError(f"{place(path)}: made for another gear, with {key} = {theirs.get(key)}, not {ours.get(key)}")
    try:
        return InfluenceTable(*arrays, made_for=gear_hash(gear))
    except GearjaxError as fault:
        raise GearjaxError(f"{place(path)}: {fault}") from fault


def _contents(path: Path) -> tuple[dict, list[np.ndarray]]:
    """Header and arrays of a file."""
    try:
        content = io.BytesIO(path.read_bytes())
        if not zipfile.is_zipfile(content):
            raise GearjaxError(f"{place(path)}: damaged, or no influence table (no archive .npz of numpy)")
        with np.load(content, allow_pickle=False) as file:
            missing = [name for name in ("header", *ARRAYS) if name not in file]
            if missing:
                raise GearjaxError(f"{place(path)}: no array {missing[0]}; right are header, {', '.join(ARRAYS)}")
            header, arrays = json.loads(str(file["header"])), [file[name] for name in ARRAYS]
    except OSError as fault:
        raise GearjaxError(f"{place(path)}: cannot be read ({fault.strerror or fault})") from fault
    except GearjaxError:
        raise
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error, AttributeError) as fault:
        raise GearjaxError(f"{place(path)}: damaged, or no influence table ({fault})") from fault
    if not all(np.issubdtype(array.dtype, np.floating) for array in arrays):
        raise GearjaxError(f"{place(path)}: {', '.join(ARRAYS)} have to be of floating-point numbers")
    return header, arrays


def _check_header(path: str | Path, header: object) -> None:
    """Refuse the header of a file with another layout."""
    right = {"format": FORMAT, "version": VERSION, "units": UNITS}
    for key, value in right.items():
        given = header.get(key) if isinstance(header, dict) else None
        if given != value:
            raise GearjaxError(
                f"{place(path)}: header has {key} = {json.dumps(given)[:60]}; right is {json.dumps(value)}"
            )
    for key, kind in (("gear", dict), ("made", dict), ("sha256", str)):
        if not isinstance(header, dict) or not isinstance(header.get(key), kind):
            raise GearjaxError(f"{place(path)}: header has no {key}, which is a {'text' if kind is str else 'table'}")
