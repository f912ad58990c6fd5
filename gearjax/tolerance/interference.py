"""Interference in a population: how many of its gear sets cannot be assembled without deformation."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.resting import clash, tolerated
from gearjax.tolerance.measures import angles
from gearjax.tolerance.population import Tolerances
from gearjax.typing import Array, ArrayLike
from gearjax.units import deg, um


class Clashes(NamedTuple):
    """Interference of some gear sets of a population.

    Args:
        looked_at: number of gear sets that were examined, from the first on.
        interfering: number of them whose rigid bodies overlap at some input angle, at every position of the output.
        sample: index of the worst gear set.
        overlap: largest overlap of the worst gear set [m].
        contact: name of the contact with the largest overlap.
        theta: input angle of the largest overlap [rad].
    """

    looked_at: int
    interfering: int
    sample: int
    overlap: float
    contact: str
    theta: float

    @property
    def told(self) -> str | None:
        """The interference in words, ``None`` if there is none."""
        if self.interfering == 0:
            return None
        return (
            f"interference: rigid bodies overlap in {self.interfering} of the first {self.looked_at} gear sets, most "
            f"in sample {self.sample}, by {self.overlap / um:.3g} um ({self.contact}, input angle "
            f"{self.theta / deg:.5g} deg)"
        )

    def as_json(self) -> dict:
        """The entry of ``gearjax tolerance --json``."""
        return {
            "looked_at": self.looked_at,
            "interfering": self.interfering,
            "worst_sample": self.sample,
            "overlap_um": self.overlap / um,
            "contact": self.contact,
            "input_angle_deg": self.theta / deg,
        }


def clashes(tolerances: Tolerances, rows: np.ndarray, theta: ArrayLike | None = None) -> Clashes | None:
    """Interference of the first gear sets of a population; ``None`` if the scene does not model the clearance.

    Args:
        tolerances: the population.
        rows: numbers of the gear sets, in the order of the paths of the population, shape (n, free).
        theta: input angles, as for `Measures`, shape (m,) [rad].
    """
    scene, free = tolerances.scene, tolerances.free
    if not scene.has_clearance:
        return None
    physics = scene.physics("backlash", *(path.split(".")[0] for path in free.paths))
    places = angles(scene, theta)

    def worst(row: Array) -> tuple[Array, Array, Array]:
        one = free.set(physics, row).both_flanks.anchored()
        overlaps = jax.vmap(lambda angle: clash(one, angle))(places)
        index = jnp.argmax(overlaps.overlap)
        return overlaps.overlap[index], overlaps.contact[index], places[index]

    given = jnp.asarray(rows, scene.dtype)
    overlap, contact, theta_worst = jax.jit(lambda rows: jax.lax.map(worst, rows))(given)
    sample, limit = int(jnp.argmax(overlap)), tolerated(overlap.dtype)
    return Clashes(
        len(rows),
        int((overlap > limit).sum()),
        sample,
        float(overlap[sample]),
        scene.system.contact_name(int(contact[sample])),
        float(theta_worst[sample]),
    )
