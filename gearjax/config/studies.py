"""Reading of the sections of studies: ``optimise``, ``identify`` and ``tolerance``."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gearjax.checks import GearjaxError
from gearjax.config.build import read_tables, scene_of, with_files
from gearjax.config.optimise import OptimiseSection, read_optimise
from gearjax.config.tolerance import ToleranceSection, example_path, inlined, read_tolerance
from gearjax.scene import Scene
from gearjax.tolerance import Tolerances

if TYPE_CHECKING:
    from gearjax.config.identify import IdentifySection


def check_studies(tables: dict[str, Any], scene: Scene, folder: Path) -> None:
    """Check the sections ``optimise`` and ``tolerance`` of a configuration.

    Raises:
        ParameterError: a value is wrong; the message names the key, what was given and what would be right.
    """
    if "optimise" in tables:
        _read_optimise(tables, scene, folder)
    if "tolerance" in tables:
        read_tolerance(tables["tolerance"], scene, folder)


def loads_optimise(text: str, folder: str | Path = ".") -> tuple[Scene, OptimiseSection]:
    """Load a scene and its optimise section from TOML text; file names in the text are relative to the folder.

    Raises:
        GearjaxError: something in the text is wrong, or it has no such section; the message is one line that says
            where.
    """
    tables, scene = _with_section(
        "optimise",
        text,
        folder,
        "objective and where",
        lambda scene: f'optimise = {{objective = "no_load_amplitude", where = ["{example_path(scene, "phase")}"]}}',
    )
    return scene, _read_optimise(tables, scene, Path(folder))


def _read_optimise(tables: dict[str, Any], scene: Scene, folder: Path) -> OptimiseSection:
    def population() -> Tolerances | None:
        return read_tolerance(tables["tolerance"], scene, folder).tolerances if "tolerance" in tables else None

    return read_optimise(tables["optimise"], scene, population)


def loads_identify(text: str, folder: str | Path = ".") -> "tuple[Scene, IdentifySection]":
    """Load a scene and its identify section from TOML text; file names in the text are relative to the folder.

    If the text has no identify section, the section has its default values.

    Raises:
        GearjaxError: something in the text is wrong; the message is one line that says where.
    """
    from gearjax.config.identify import read_identify  # what it reads for takes half a second to import

    tables = with_files(read_tables(text), Path(folder))
    scene = scene_of(tables)
    return scene, read_identify(tables.get("identify", {}), scene, Path(folder))


def loads_tolerance(text: str, folder: str | Path = ".") -> tuple[dict[str, Any], Scene, ToleranceSection]:
    """Load tables, scene and tolerance section from TOML text; the tables hold measured values in place of file names.

    Raises:
        GearjaxError: something in the text is wrong, or it has no such section; the message is one line that says
            where.
    """
    tables, scene = _with_section(
        "tolerance",
        text,
        folder,
        "samples, measures and numbers",
        lambda scene: (
            'tolerance = {samples = 10000, measures = ["no_load.peak_to_peak"], '
            f'"{example_path(scene, "amplitude")}" = {{kind = "rayleigh", scale = "6 um"}}}}'
        ),
    )
    section = read_tolerance(tables["tolerance"], scene, Path(folder))
    return inlined(tables, scene, Path(folder)), scene, section


def _with_section(
    section: str, text: str, folder: str | Path, keys: str, example: Callable[[Scene], str]
) -> tuple[dict[str, Any], Scene]:
    """Tables and scene of a configuration that must have a section; else an error with its keys and an example."""
    tables = with_files(read_tables(text), Path(folder))
    scene = scene_of(tables)
    if section not in tables:
        raise GearjaxError(
            f"the configuration has no [{section}]: add a section with {keys}, such as this line before the first "
            f"section: {example(scene)}"
        )
    return tables, scene
