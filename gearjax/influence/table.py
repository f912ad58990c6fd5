"""What a contact solver needs to know of the elastic teeth of one gear."""

import hashlib
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError
from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Array, ArrayLike, Float

FEWEST_RADII = 4  # that a cubic goes through
ASYMMETRY = 1e-6  # of the largest entry: rounding of a file with seven digits
ANGLES = 16  # at which the spectrum of a row of teeth is looked at


class InfluenceTable(eqx.Module):
    """Normal displacements of the flanks of a gear per normal force on them, as if all of its teeth were equal.

    ``matrix[d, a, b]`` is the displacement at node ``b`` of the tooth that stands ``d`` teeth ahead, towards increasing
    polar angles, per force at node ``a`` of a tooth. Forces press on the flank and displacements go into the material,
    both along the ideal normal. By Maxwell's reciprocity ``matrix[d].T`` is that of a tooth ``d`` teeth behind. All
    this holds for flanks that face increasing polar angles; teeth are symmetric, so that the other flanks have
    `mirrored`. Nodes are counted across the face first: node ``a`` is at ``radius[a // len(face)]`` and
    ``face[a % len(face)]``.

    Args:
        radius: of the nodes about the gear's centre, increasing, at least four, shape (radius,) [m].
        face: of the nodes across the face, from where two gears begin to overlap, increasing, shape (face,) [m].
        matrix: by the distance of the teeth, shape (distance, radius * face, radius * face) [m/N]; zero beyond.
        made_for: hash of the gear, as `gear_hash` gives it.

    Raises:
        GearjaxError: shapes do not agree, numbers are not finite, or the matrix is not symmetric or positive definite.
    """

    radius: Float[Array, " radius"]
    face: Float[Array, " face"]
    matrix: Float[Array, "distance node node"]
    slopes: Float[Array, "radius radius"]  # of cubic splines at the nodes, per value at each
    made_for: str = eqx.field(static=True)

    def __init__(self, radius: ArrayLike, face: ArrayLike, matrix: ArrayLike, made_for: str):
        radii, faces, blocks = checked(radius, face, matrix)
        self.radius, self.face, self.matrix = jnp.asarray(radii), jnp.asarray(faces), jnp.asarray(blocks)
        from scipy.interpolate import CubicSpline  # takes a tenth of a second, which only this needs

        self.slopes = jnp.asarray(CubicSpline(radii, np.eye(len(radii)))(radii, 1))
        self.made_for = made_for

    @property
    def mirrored(self) -> "InfluenceTable":
        """The same of the flanks that face decreasing polar angles: ahead and behind change places."""
        return eqx.tree_at(lambda table: table.matrix, self, jnp.swapaxes(self.matrix, 1, 2))

    def check_gear(self, gear: InvoluteGear) -> None:
        """Refuse a table of other teeth.

        Raises:
            GearjaxError: the table was not made for this gear.
        """
        if self.made_for != gear_hash(gear):
            raise GearjaxError(
                f"influence table: made for another gear (hash {self.made_for[:12]}) than this one of {gear.teeth} "
                f"teeth (hash {gear_hash(gear)[:12]}); make it anew by tooth_influence"
            )


def checked(radius: ArrayLike, face: ArrayLike, matrix: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of a table in float64, the matrix of distance zero made exactly symmetric.

    Raises:
        GearjaxError: as `InfluenceTable` tells.
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
    """The smallest eigenvalue that a long row of equal teeth has [m/N].

    Eigenvectors of an endless row are waves: what is looked at is ``C_0 + sum_d (C_d exp(i d u) + its adjoint)`` at
    some angles ``u``. That of any number of teeth is not below the least over all angles.
    """
    waves = np.exp(1j * np.outer(np.linspace(0, np.pi, ANGLES), np.arange(1, len(blocks))))
    least = np.inf
    for wave in waves if len(blocks) > 1 else waves[:1]:
        ahead = np.tensordot(wave, blocks[1:], axes=1)
        least = min(least, np.linalg.eigvalsh(blocks[0] + ahead + ahead.conj().T)[0])
    return float(least)


def gear_definition(gear: InvoluteGear) -> dict[str, str]:
    """What the shape of a gear follows from, numbers in SI with the six digits that single precision keeps."""
    named = ("module", "pressure_angle", "profile_shift", "addendum", "dedendum")
    numbers = {name: f"{float(getattr(gear, name)):.6g}" for name in named}
    return {"teeth": str(gear.teeth), "internal": "yes" if gear.internal else "no", **numbers}


def hash_of(definition: dict) -> str:
    """SHA-256 of the JSON text of a definition, keys in order, without blanks."""
    return hashlib.sha256(json.dumps(definition, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def gear_hash(gear: InvoluteGear) -> str:
    """SHA-256 of `gear_definition`."""
    return hash_of(gear_definition(gear))
