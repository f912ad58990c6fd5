"""Profiles of cycloidal discs as points for CAD and measuring machines."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, writing
from gearjax.geometry.cycloid import profile
from gearjax.systems import RVCycloidal
from gearjax.units import mm

FORMATS = (".csv", ".dxf")


def save_profile(system: RVCycloidal, path: Path, points: int = 4000) -> Path:
    """Write the modified profile of a disc, once around, in mm: CSV, or a closed polyline in DXF (R12).

    Args:
        system: the reducer.
        path: ends in ``.csv`` or ``.dxf``.
        points: number of points, evenly spaced in the meshing phase.

    Raises:
        ParameterError: another ending, or too few points.
        GearjaxError: the file cannot be written.
    """
    if path.suffix.lower() not in FORMATS:
        raise ParameterError("path", str(path), f"must end in {' or '.join(FORMATS)}")
    least = 8 * (system.pins - 1)
    if points < least:
        raise ParameterError("points", points, f"must be at least {least}, eight per tooth")
    phase = np.linspace(0.0, 2 * np.pi * (system.pins - 1), points, endpoint=False)
    drawn = np.asarray(profile(system.profile, jnp.asarray(phase))) / mm
    text = _csv(drawn) if path.suffix.lower() == ".csv" else _dxf(drawn)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")
    return path


def _csv(points: np.ndarray) -> str:
    return "\n".join(["x [mm],y [mm]", *(f"{x:.9f},{y:.9f}" for x, y in points)]) + "\n"


def _dxf(points: np.ndarray) -> str:
    """A closed polyline: pairs of lines, a group code and its value."""
    lines = ["0", "SECTION", "2", "ENTITIES", "0", "POLYLINE", "8", "profile", "66", "1", "70", "1"]
    for x, y in points:
        lines += ["0", "VERTEX", "8", "profile", "10", f"{x:.9f}", "20", f"{y:.9f}"]
    return "\n".join([*lines, "0", "SEQEND", "0", "ENDSEC", "0", "EOF"]) + "\n"
