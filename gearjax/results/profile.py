"""Profiles of discs and gears for CAD and measuring machines, in DXF and CSV, within a given tolerance."""

from pathlib import Path

import numpy as np

from gearjax.arguments import one_number
from gearjax.checks import ParameterError, SceneError
from gearjax.files import write_file
from gearjax.geometry.cycloid import Cycloid, profile
from gearjax.geometry.noncircular_outline import outline
from gearjax.results.dxf import DIGITS, drawing
from gearjax.scene import Scene
from gearjax.systems import AbstractSystem, DiscProfile, GearOutlines
from gearjax.units import mm, um

FORMATS = (".csv", ".dxf")
TOLERANCE = 0.1 * um
FINEST, COARSEST = 1e-10, 1e-4  # tolerances [m]
FIRST = 4  # pieces of half a tooth before any piece is halved
PROBES = np.arange(1, 32) / 32  # places along a piece at which its distance from the profile is measured
SAFETY = 0.9  # share of the tolerance for a piece at the probes: between them it may be a little further away
MOST_POINTS = 5_000_000


def export_profile(
    of: AbstractSystem | Scene, path: str | Path, *, body: str | None = None, tolerance: float = TOLERANCE
) -> Path:
    """Write the outline of a gear in mm: the profile of a cycloidal disc, or the teeth of a non-circular gear.

    The outline runs once around the gear, counter-clockwise, and is closed; the profile of a disc includes its
    modifications. DXF (AutoCAD 2000, drawing units millimetres) holds one polyline, of arcs for discs and of straight
    lines for teeth. CSV holds points for straight lines; the last point repeats the first. The pieces are
    within the tolerance of the profile; those of a disc are halved one by one, so that they are short where it is
    curved. Half of the backlash of a scene is taken from the teeth of each gear. Their roots have the fillets that a
    rack with rounded tips leaves.

    Args:
        of: the gear set, or a scene of it.
        path: path of the file, which ends in ``.csv`` or ``.dxf``; missing folders are created.
        body: gear of a non-circular pair, the driver if not given; discs are all alike.
        tolerance: largest distance between the written curve and the profile [m].

    Returns:
        The path.

    Raises:
        SceneError: the gear set has no profiles.
        ParameterError: the path has another ending, the gear does not exist, or the tolerance is not a length that can
            be kept.
        GearjaxError: the file cannot be written.

    Example:
        >>> import gearjax as gj, tempfile, pathlib
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> path = gj.export_profile(scene, pathlib.Path(tempfile.mkdtemp()) / "disc.csv")
        >>> path.read_text().splitlines()[:2]
        ['x [mm],y [mm]', '71.4783000000,0.0000000000']
    """
    if isinstance(of, str | Path):
        raise ParameterError("of", str(of), "is a path: give gj.load(path)")
    system = of.system if isinstance(of, Scene) else of
    if not isinstance(system, DiscProfile | GearOutlines):
        kind = getattr(system, "kind", type(system).__name__)
        words = "has no disc with a profile and no gears with outlines; an rv_cycloidal or an elliptic_pair has"
        raise SceneError(f"export_profile: {kind} {words}")
    if not isinstance(path, str | Path):
        raise ParameterError("path", path, "must be a path")
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ParameterError("path", str(path), f"must end in {' or '.join(FORMATS)}")
    one_number("tolerance", tolerance)
    if not FINEST <= float(tolerance) <= COARSEST:
        raise ParameterError("tolerance", tolerance, f"must be at least {FINEST:g} m and at most {COARSEST:g} m")
    arcs = path.suffix.lower() == ".dxf"
    if isinstance(system, DiscProfile):
        points, bulges = _pieces(system.profile, float(tolerance), arcs)
    else:
        own = system.bodies[0] if body is None else body
        backlash = float(of.backlash.initial) if isinstance(of, Scene) and of.backlash is not None else 0.0
        points = _teeth(system, own, backlash, float(tolerance))
        bulges = np.zeros(len(points))
    text = drawing(points / mm, bulges, "profile") if arcs else _csv(points / mm)
    return write_file(path, text)


def _teeth(system: GearOutlines, body: str, backlash: float, tolerance: float) -> np.ndarray:
    """Points of a gear's teeth; straight lines between them keep the tolerance; counter-clockwise, shape (n, 2) [m]."""
    number, pieces = FIRST + 1, {}
    while True:
        fine = system.teeth_of(body, 2 * number - 1, backlash)
        for name, piece in enumerate(fine):
            if name not in pieces and _apart(piece) <= SAFETY * tolerance:
                pieces[name] = piece[:, ::2]
        if len(pieces) == len(fine):
            break
        number = 2 * number - 1
        if number * len(fine) * len(fine[0]) > MOST_POINTS:
            words = f"needs more than {MOST_POINTS} points: give a larger tolerance"
            raise ParameterError("tolerance", f"{tolerance:g} m", words)
    points = outline([pieces[name] for name in range(len(fine))])
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T)
    points = points[apart > FINEST]  # adjacent pieces share a point
    x, y = points.T
    return points if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0 else points[::-1]


def _apart(piece: np.ndarray) -> float:
    """Largest distance of every other point of a piece of all teeth from the line between its neighbours [m]."""
    begin, middle, end = piece[:, :-2:2], piece[:, 1::2], piece[:, 2::2]
    along, off = end - begin, middle - begin
    across = np.abs(along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0])
    return float((across / np.hypot(along[..., 0], along[..., 1])).max())


def _csv(points: np.ndarray) -> str:
    """The text of the CSV file: a header, the points, and the first point again."""
    rows = [f"{x:.{DIGITS}f},{y:.{DIGITS}f}" for x, y in points.tolist()]
    return "\n".join(["x [mm],y [mm]", *rows, rows[0]]) + "\n"


def _pieces(disc: Cycloid, tolerance: float, arcs: bool) -> tuple[np.ndarray, np.ndarray]:
    """Starting points of pieces within the tolerance, shape (n, 2) [m], and their bulges, shape (n,), 0 if straight.

    The computation is in numpy with float64, whatever precision JAX has: float32 resolves only some nanometres.
    """
    exact = disc._replace(**{name: float(part) for name, part in disc._asdict().items() if name != "pins"})
    phases = np.linspace(0.0, np.pi, FIRST + 1)
    while True:
        bulges, apart = _measured(exact, phases, arcs)
        long = apart > SAFETY * tolerance
        if not long.any():
            break
        if 2 * disc.teeth * (len(bulges) + long.sum()) > MOST_POINTS:
            words = f"needs more than {MOST_POINTS} points: give a larger tolerance, or .dxf, which needs fewer arcs"
            raise ParameterError("tolerance", f"{tolerance:g} m", words)
        middles = 0.5 * (phases[:-1] + phases[1:])[long]
        phases = np.sort(np.concatenate([phases, middles]))
    # the other half of a tooth is its mirror image, and all teeth are alike
    tooth = np.concatenate([phases, 2 * np.pi - phases[-2:0:-1]])
    turns = 2 * np.pi * np.arange(disc.teeth)
    around = (turns[:, None] + tooth[None, :]).ravel()
    return _curve(exact, around), np.tile(np.concatenate([bulges, bulges[::-1]]), disc.teeth)


def _curve(disc: Cycloid, phases: np.ndarray) -> np.ndarray:
    """The profile, counter-clockwise, shape (n, 2) [m]; `profile` itself runs clockwise with rising phase."""
    return np.asarray(profile(disc, -phases))


def _measured(disc: Cycloid, phases: np.ndarray, arcs: bool) -> tuple[np.ndarray, np.ndarray]:
    """Bulge of each piece between neighbouring phases, and distance of the profile from it [m]; shape (n - 1,) each.

    The axes x and y lie along and across the chord, with the origin in its middle; c is half the chord. An arc through
    both ends whose top has the height s is ``s (x^2 + y^2 - c^2) = (s^2 - c^2) y``, also for straight pieces (s = 0).
    """
    begin, spans = phases[:-1, None], np.diff(phases)[:, None]
    inner = _curve(disc, (begin + spans * PROBES).ravel()).reshape(len(spans), len(PROBES), 2)
    ends = _curve(disc, phases)
    half = 0.5 * np.diff(ends, axis=0)
    c = np.hypot(*half.T)
    along = half / c[:, None]
    offset = inner - (ends[:-1] + half)[:, None]
    x = np.einsum("npi,ni->np", offset, along)
    y = along[:, :1] * offset[..., 1] - along[:, 1:] * offset[..., 0]
    s = np.zeros_like(c)
    if arcs:  # the arc passes through the middle probe
        bend = y[:, len(PROBES) // 2] / (x[:, len(PROBES) // 2] ** 2 + y[:, len(PROBES) // 2] ** 2 - c**2)
        s = -2 * bend * c**2 / (1 + np.sqrt(1 + 4 * (bend * c) ** 2))
    s, chord = s[:, None], c[:, None]
    missed = s * (x**2 + y**2 - chord**2) - (s**2 - chord**2) * y
    slope = np.hypot(2 * s * x, 2 * s * y - (s**2 - chord**2))
    return -s[:, 0] / c, (np.abs(missed) / slope).max(axis=1)
