"""Influence tables: the elastic teeth of one gear as a contact solver needs them."""

import hashlib
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError
from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Array, ArrayLike, Float

FEWEST_RADII = 4  # points that a cubic needs
ASYMMETRY = 1e-6  # share of the largest entry: rounding of a file with seven digits
ANGLES = 16  # angles at which the spectrum of a row of teeth is calculated


class InfluenceTable(eqx.Module):
    """Normal displacements of the flanks of a gear per normal force on them; all teeth of the gear are equal.

    ``matrix[d, a, b]`` is the displacement at node ``b`` of the tooth that is ``d`` teeth ahead, towards increasing
    polar angles, per force at node ``a`` of a tooth. Forces press on the flank and displacements point into the
    material, both along the ideal normal. By Maxwell's reciprocity ``matrix[d].T`` is the influence on a tooth that is
    ``d`` teeth behind. The table is for flanks that face increasing polar angles. Because teeth are symmetric,
    `mirrored` is the table of the other flanks. Nodes are counted across the face first: node ``a`` is at
    ``radius[a // len(face)]`` and ``face[a % len(face)]``.

    Args:
        radius: radii of the nodes about the gear's centre, increasing, at least four, shape (radius,) [m].
        face: places of the nodes across the face, from where two gears begin to overlap, increasing, shape (face,) [m].
        matrix: influence by the distance between the teeth, shape (distance, radius * face, radius * face) [m/N]; zero
            at larger distances.
        made_for: hash of the gear, from `gear_hash`.

    Raises:
        GearjaxError: shapes do not agree, numbers are not finite, or the matrix is not symmetric or positive definite.
    """

    radius: Float[Array, " radius"]
    face: Float[Array, " face"]
    matrix: Float[Array, "distance node node"]
    slopes: Float[Array, "radius radius"]  # slopes of a cubic spline at the nodes, per value at each node
    made_for: str = eqx.field(static=True)

    def __init__(self, radius: ArrayLike, face: ArrayLike, matrix: ArrayLike, made_for: str):
        radii, faces, blocks = checked(radius, face, matrix)
        self.radius, self.face, self.matrix = jnp.asarray(radii), jnp.asarray(faces), jnp.asarray(blocks)
        from scipy.interpolate import CubicSpline  # this import takes a tenth of a second, and only this needs it

        self.slopes = jnp.asarray(CubicSpline(radii, np.eye(len(radii)))(radii, 1))
        self.made_for = made_for

    @property
    def mirrored(self) -> "InfluenceTable":
        """Table of the flanks that face decreasing polar angles: teeth ahead and teeth behind change places."""
        return eqx.tree_at(lambda table: table.matrix, self, jnp.swapaxes(self.matrix, 1, 2))

    def check_gear(self, gear: InvoluteGear) -> None:
        """Refuse a gear that the table was not made for.

        Raises:
            GearjaxError: the table was made for another gear.
        """
        if self.made_for != gear_hash(gear):
            raise GearjaxError(
                f"influence table: made for another gear (hash {self.made_for[:12]}) than this one of {gear.teeth} "
                f"teeth (hash {gear_hash(gear)[:12]}); compute it again with tooth_influence"
            )


def checked(radius: ArrayLike, face: ArrayLike, matrix: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of a table in float64, with an exactly symmetric matrix of distance zero.

    Raises:
        GearjaxError: as for `InfluenceTable`.
    """
    radii, faces, blocks = (np.asarray(array, dtype=np.float64) for array in (radius, face, matrix))
    nodes = radii.size * faces.size
    if radii.ndim != 1 or faces.ndim != 1 or blocks.ndim != 3 or blocks.shape[1:] != (nodes, nodes) or not len(blocks):
        raise GearjaxError(
            f"influence table: radius {radii.shape}, face {faces.shape}, matrix {blocks.shape}; right are (r,), (f,) "
            f"and (distance, r f, r f)"
        )
    if radii.size < FEWEST_RADII or faces.size < 2:
        raise GearjaxError(
            f"influence table: {radii.size} radii, {faces.size} places across the face; at least {FEWEST_RADII} and 2"
        )
    for name, array in (("radius", radii), ("face", faces), ("matrix", blocks)):
        if not np.isfinite(array).all():
            raise GearjaxError(f"influence table: {name} has numbers that are not finite")
    for name, array in (("radius", radii), ("face", faces)):
        if (np.diff(array) <= 0).any():
            raise GearjaxError(f"influence table: {name} does not increase")
    uneven, largest = np.abs(blocks[0] - blocks[0].T).max(), np.abs(blocks[0]).max()
    if uneven > ASYMMETRY * largest:
        raise GearjaxError(
            f"influence table: matrix[0] is not symmetric, by {uneven / largest:.2g} of its largest entry"
        )
    blocks = np.concatenate([0.5 * (blocks[:1] + blocks[:1].transpose(0, 2, 1)), blocks[1:]])
    least = smallest_eigenvalue(blocks)
    if not least > 0:
        raise GearjaxError(f"influence table: not positive definite, smallest eigenvalue {least:.3g} m/N; right is > 0")
    return radii, faces, blocks


def smallest_eigenvalue(blocks: Float[np.ndarray, "distance node node"]) -> float:
    """Smallest eigenvalue of the influence matrix of a long row of equal teeth [m/N].

    The eigenvectors of an infinite row are waves. The function takes the smallest eigenvalue of
    ``C_0 + sum_d (C_d exp(i d u) + its adjoint)`` at some angles ``u``. The smallest eigenvalue of any number of teeth
    is not below the minimum over all angles.
    """
    waves = np.exp(1j * np.outer(np.linspace(0, np.pi, ANGLES), np.arange(1, len(blocks))))
    least = np.inf
    for wave in waves if len(blocks) > 1 else waves[:1]:
        ahead = np.tensordot(wave, blocks[1:], axes=1)
        least = min(least, np.linalg.eigvalsh(blocks[0] + ahead + ahead.conj().T)[0])
    return float(least)


def gear_definition(gear: InvoluteGear) -> dict[str, str]:
    """Numbers that define the shape of a gear, as texts in SI units with the six digits that single precision keeps."""
    named = ("module", "pressure_angle", "profile_shift", "addendum", "dedendum")
    numbers = {name: f"{float(getattr(gear, name)):.6g}" for name in named}
    return {"teeth": str(gear.teeth), "internal": "yes" if gear.internal else "no", **numbers}


def hash_of(definition: dict) -> str:
    """SHA-256 of the JSON text of a definition, with sorted keys and without blanks."""
    return hashlib.sha256(json.dumps(definition, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def gear_hash(gear: InvoluteGear) -> str:
    """SHA-256 of the definition of a gear (`gear_definition`)."""
    return hash_of(gear_definition(gear))
