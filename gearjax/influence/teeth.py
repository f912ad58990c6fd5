"""Influence of the teeth of a gear on each other by finite elements."""

import contextlib
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError, ParameterError
from gearjax.geometry.involute import InvoluteGear
from gearjax.influence.element import scikit_fem, stiffness
from gearjax.influence.files import read_influence, write_arrays
from gearjax.influence.mesh import TeethMesh, teeth_mesh
from gearjax.influence.outline import flank_angle, graded, outline
from gearjax.influence.table import InfluenceTable, gear_definition, gear_hash, hash_of

AT_ONCE = 32  # load cases that are solved together
MADE = 1  # version of the calculation: to be raised when the same parameters give other numbers


class _Elements(NamedTuple):
    """Numbers of elements and teeth of the mesh, as in `tooth_influence`."""

    profile: int
    layers: int
    thickness: int
    space: int
    teeth: int


def tooth_influence(
    gear: InvoluteGear,
    *,
    face_width: float,
    youngs_modulus: float,
    poissons_ratio: float,
    rim: float,
    touching: tuple[float, float],
    meeting: tuple[float, float] | None = None,
    fillet: float | None = None,
    profile_elements: int = 10,
    layers: int = 13,
    thickness_elements: int = 4,
    space_elements: int = 2,
    teeth: int = 11,
    distances: int = 2,
    cache: str | Path | None = None,
) -> InfluenceTable:
    """Normal displacements of the flanks of a gear per unit normal force at each node, by finite elements.

    Some teeth and the rim under them are meshed with eight-node bricks with incompatible modes. The mesh is fixed at a
    depth under the root circle and at both ends. The tooth in the middle is loaded at one node after the other (Yang,
    Tang, Liang 2019, section IV). All teeth are equal, so that the influence of one loaded tooth is enough. The forces
    are nodal forces: the displacement under a nodal force grows as the elements become smaller, while the displacement
    under a force that is distributed over a surface tends to a limit.

    Args:
        gear: one gear of the pair.
        face_width: face width of the gear [m].
        youngs_modulus: Young's modulus [Pa].
        poissons_ratio: Poisson's ratio, from 0 to below 0.5 [-].
        rim: depth under the root circle where the gear is fixed [m].
        touching: radii between which teeth may touch [m]; the nodes there are equally spaced.
        meeting: beginning and end of the part of the face that meets the other gear, counted from one end of the face
            [m]; the whole face if absent.
        fillet: radius of the arc between flank and root circle [m]; 0.2 modules if absent, 0 for a corner.
        profile_elements: number of elements between the radii where teeth may touch, at least 3.
        layers: number of elements across the part of the face that meets the other gear.
        thickness_elements: number of elements through a tooth from flank to flank.
        space_elements: number of elements over half of the space between two teeth, in addition to those of the fillet.
        teeth: number of teeth that are meshed, odd.
        distances: largest distance, in teeth, at which teeth move each other.
        cache: folder where results are kept; a result that is in the folder already is not calculated again.

    Returns:
        The table of flanks that face increasing polar angles; see `InfluenceTable` for its signs.

    Raises:
        GearjaxError: scikit-fem is missing (``pip install 'gearjax[fem]'``), a parameter is out of its range, radii do
            not lie on the flank between fillet and tip, or the fillet does not fit.

    Example:
        >>> import jax.numpy as jnp
        >>> import gearjax as gj
        >>> gear = InvoluteGear(40, *map(jnp.asarray, (1e-3, 0.35, 0.0, 1.0, 1.25)))
        >>> steel = {"youngs_modulus": 2.06e11, "poissons_ratio": 0.3}
        >>> few = {"profile_elements": 3, "layers": 2, "thickness_elements": 2, "teeth": 5}
        >>> table = gj.tooth_influence(gear, face_width=3e-3, rim=1e-3, touching=(20e-3, 21e-3), **steel, **few)
        >>> table.matrix.shape  # of teeth up to two further on, between 4 radii times 3 places across the face
        (3, 12, 12)
    """
    scikit_fem()
    elements = _Elements(profile_elements, layers, thickness_elements, space_elements, teeth)
    fillet = 0.2 * float(gear.module) if fillet is None else float(fillet)
    begin, end = (0.0, face_width) if meeting is None else meeting
    _check_lengths(face_width, youngs_modulus, poissons_ratio, rim, fillet, (begin, end))
    _check_numbers(elements, distances)
    lengths = {"face_width": face_width, "rim": rim, "fillet": fillet, "meeting_from": begin, "meeting_to": end}
    lengths |= {"touching_from": min(touching), "touching_to": max(touching)}
    numbers = lengths | {"youngs_modulus": youngs_modulus, "poissons_ratio": poissons_ratio}
    made = {name: f"{float(number):.12g}" for name, number in numbers.items()}
    made |= {f"{name}_elements": str(number) for name, number in elements._asdict().items()}
    made |= {"distances": str(distances), "by": f"gearjax tooth_influence {MADE}"}
    file = None
    if cache is not None:
        file = Path(cache) / f"{hash_of({'gear': gear_definition(gear), 'made': made})}.npz"
        if file.exists():
            with contextlib.suppress(GearjaxError):  # a damaged file is calculated again
                return read_influence(file, gear)
    inner, outer = sorted(touching)
    radii = np.linspace(inner, outer, profile_elements + 1)
    face, zone = _levels(face_width, begin, end, layers)
    mesh = _meshed(gear, radii, face, zone, elements, rim=rim, fillet=fillet)
    matrix = _loaded(gear, mesh, radii, youngs_modulus, poissons_ratio, distances)
    arrays = radii, face[zone] - begin, matrix
    table = InfluenceTable(*arrays, made_for=gear_hash(gear))
    if file is not None:
        write_arrays(file, gear, made, *arrays)
    return table


def _levels(face_width: float, begin: float, end: float, layers: int) -> tuple[np.ndarray, slice]:
    """Nodes across the face [m], and the range of those that meet the other gear."""
    inner = np.linspace(begin, end, layers + 1)
    slack, step = 1e-9 * face_width, (end - begin) / layers
    before, after = graded(begin, step, slack), graded(face_width - end, step, slack)
    return np.concatenate([begin - before[::-1], inner, end + after]), slice(len(before), len(before) + layers + 1)


def _meshed(
    gear: InvoluteGear,
    radii: np.ndarray,
    face: np.ndarray,
    zone: slice,
    elements: _Elements,
    *,
    rim: float,
    fillet: float,
) -> TeethMesh:
    """Mesh of some teeth, with its flank nodes in the order of increasing radii."""
    order = slice(None, None, -1 if gear.internal else 1)  # an outline goes from the root to the tip
    shape = outline(gear, radii[order], rim=rim, fillet=fillet, space_elements=elements.space)
    pitch = 2 * np.pi / gear.teeth
    mesh = teeth_mesh(shape, pitch, elements.teeth, face, zone, thickness_elements=elements.thickness)
    return mesh._replace(flank=mesh.flank[:, order])


def _loaded(
    gear: InvoluteGear,
    mesh: TeethMesh,
    radii: np.ndarray,
    youngs_modulus: float,
    poissons_ratio: float,
    distances: int,
) -> np.ndarray:
    """Displacements of a tooth and of the teeth ahead per force on the tooth, shape (distance, node, node) [m/N]."""
    matrix, places = stiffness(mesh.mesh, youngs_modulus, poissons_ratio)
    free = np.ones(places.size, dtype=bool)
    free[places[:, mesh.fixed]] = False
    index = np.cumsum(free) - 1
    from scipy import sparse  # this import takes a tenth of a second, and only this function needs it
    from scipy.sparse.linalg import splu

    inner = sparse.csc_array(matrix[free][:, free])
    factor = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    middle = len(mesh.axes) // 2
    near = slice(middle - distances, middle + distances + 1)
    at = index[places[:2][:, mesh.flank[near]]].reshape(2, 2 * distances + 1, -1)  # (axis, tooth, node)
    inwards = np.repeat(_inwards(gear, radii, mesh.axes[near]), mesh.flank.shape[2], axis=2)
    number = at.shape[2]
    moved = np.empty((2 * distances + 1, number, number))  # (tooth, of force, of displacement)
    for begin in range(0, number, AT_ONCE):
        some = np.arange(begin, min(begin + AT_ONCE, number))
        load = np.zeros((int(free.sum()), len(some)))
        for axis in range(2):
            load[at[axis, distances, some], some - begin] = inwards[axis, distances, some]
        answer = factor.solve(load)
        moved[:, some] = np.einsum("atnf,atn->tfn", answer[at], inwards)
    ahead, behind = moved[distances:], moved[distances::-1]
    return 0.5 * (ahead + behind.transpose(0, 2, 1))


def _inwards(gear: InvoluteGear, radii: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Unit normals, pointing into the material, of flanks that face increasing polar angles, (2, tooth, radius)."""
    lean = np.asarray(gear.pressure_angle_at(jnp.asarray(radii))) * (-1.0 if gear.internal else 1.0)
    angle = axes[:, None] + flank_angle(gear, radii) - lean
    return np.stack([np.sin(angle), -np.cos(angle)])


def _check_lengths(
    face_width: float,
    youngs_modulus: float,
    poissons_ratio: float,
    rim: float,
    fillet: float,
    meeting: tuple[float, float],
) -> None:
    """Refuse lengths and material constants that no gear can have."""
    for name, value in (("face_width", face_width), ("youngs_modulus", youngs_modulus), ("rim", rim)):
        if not (np.isfinite(value) and value > 0):
            raise ParameterError(f"tooth_influence.{name}", value, "has to be above 0")
    if not 0 <= poissons_ratio < 0.5:
        raise ParameterError("tooth_influence.poissons_ratio", poissons_ratio, "must be from 0 to below 0.5")
    if not 0 <= fillet < np.inf:
        raise ParameterError("tooth_influence.fillet", fillet, "has to be 0 or above")
    if not 0 <= meeting[0] < meeting[1] <= face_width * (1 + 1e-12):
        raise ParameterError(
            "tooth_influence.meeting", meeting, f"must be start and end between 0 and {face_width:.6g} m"
        )


def _check_numbers(elements: _Elements, distances: int) -> None:
    """Refuse numbers of elements and teeth for which there is no mesh."""
    least = _Elements(profile=3, layers=1, thickness=1, space=1, teeth=1)
    for name, given, needed in zip(elements._fields, elements, least, strict=True):
        if given < needed:
            raise ParameterError(f"tooth_influence.{name}", given, f"must be at least {needed}")
    if elements.teeth % 2 == 0:
        raise ParameterError("tooth_influence.teeth", elements.teeth, "must be odd: the middle tooth is loaded")
    if not 0 <= distances <= elements.teeth // 2:
        right = f"must be from 0 to {elements.teeth // 2}, with {elements.teeth} teeth"
        raise ParameterError("tooth_influence.distances", distances, right)
