"""A compensated design: its requirements, and its evaluation with the hard contact law."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from gearjax.analysis.metrics import top
from gearjax.analysis.resting import tolerated
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Int, Scalar
from gearjax.units import deg, um

RADIAL = 2e-6  # least clearance of radial contacts, as an angle at the mean lever [rad]: 0.1 um at 50 mm
Requirement = Callable[[Scene], Scalar]


class Judged(eqx.Module):
    """A design under each set of errors, evaluated with the hard contact law.

    Args:
        mean_lag: mean of the loaded transmission error, positive if the output moves as the torque turns it, which is
            behind for a positive torque, shape (set,) [rad].
        peak_to_peak: peak-to-peak of the loaded transmission error at the samples, shape (set,) [rad].
        minimum_backlash: smallest backlash over the angles, also between samples, shape (set,) [rad].
        mean_backlash: mean backlash over the angles, shape (set,) [rad].
        largest_force: largest contact force, shape (set,) [N].
        largest_pressure: largest pressure by Hertz, shape (set,) [Pa]; ``None`` if no limit was given.
        overlap: largest interference over the angles, negative if all contacts can be clear (`gj.interference`),
            shape (set,) [m].
        overlap_contact, overlap_theta: contact and input angle [rad] of the largest interference, shape (set,).
        radial_clearance: smallest gap of contacts whose lever is less than a tenth of the mean, such as pins at tips
            and roots, shape (set,) [m]; 10 mm if there are none.
    """

    mean_lag: Float[Array, " set"]
    peak_to_peak: Float[Array, " set"]
    minimum_backlash: Float[Array, " set"]
    mean_backlash: Float[Array, " set"]
    largest_force: Float[Array, " set"]
    largest_pressure: Float[Array, " set"] | None
    radial_clearance: Float[Array, " set"]
    overlap: Float[Array, " set"]
    overlap_contact: Int[Array, " set"]
    overlap_theta: Float[Array, " set"]

    def clash(self, scene: Scene) -> str | None:
        """Interference in words, ``None`` if there is none under any set."""
        worst = int(jnp.argmax(self.overlap))
        interfering = self.overlap > tolerated(self.overlap.dtype)
        if not bool(interfering[worst]):
            return None
        count, name = int(interfering.sum()), scene.system.contact_name(int(self.overlap_contact[worst]))
        return (
            f"interference under {count} of {len(self.overlap)} sets: rigid bodies overlap by up to "
            f"{float(self.overlap[worst]) / um:.3g} um ({name}, input angle "
            f"{float(self.overlap_theta[worst]) / deg:.5g} deg)"
        )


@dataclasses.dataclass(frozen=True)
class Compensation:
    """A compensated design, and the design from which the search started.

    Args:
        scene: the compensated scene.
        values: the chosen numbers by path, SI.
        before, after: evaluation of the design at the start and of the compensated design.
        holds: whether every requirement is met under every set of errors, evaluated with the hard contact law.
        complaints: requirements that are not met, one line each.
        interferes: whether bodies of the design at the start interfere under some set of errors (`Judged.clash` names
            them).
    """

    scene: Scene
    values: dict[str, float]
    before: Judged
    after: Judged
    holds: bool
    complaints: tuple[str, ...]
    interferes: bool

    @property
    def lag_reduction(self) -> float:
        """Share by which the mean lag over all sets was reduced [-]."""
        return 1 - float(self.after.mean_lag.mean() / self.before.mean_lag.mean())


@dataclasses.dataclass(frozen=True)
class Limits:
    """Requirements on a design under each set of errors, as in `gearjax.compensate`."""

    minimum_backlash: float
    maximum_backlash: float | None
    maximum_pressure: float | None
    positive: tuple[Requirement, ...]

    def slack(
        self, scene: Scene, backlash: Array, radial: Array, pressure: Array | None, margin: Scalar
    ) -> Float[Array, " requirement"]:
        """Slacks of the requirements, which must not be negative: in radians, or a thousandth of a share of pressure.

        At the samples, the backlash must exceed its minimum by a margin [rad].
        """
        slacks = [-top(-backlash) - self.minimum_backlash - margin, radial - RADIAL]
        if self.maximum_backlash is not None:
            slacks.append(self.maximum_backlash - backlash.mean(axis=1))
        if self.maximum_pressure is not None and pressure is not None:
            slacks.append(1e-3 * (1 - pressure / self.maximum_pressure))
        slacks += [jnp.asarray(requirement(scene), backlash.dtype)[None] for requirement in self.positive]
        return jnp.concatenate(slacks)

    def complaints(self, scene: Scene, judged: Judged) -> tuple[str, ...]:
        """Requirements that are not met, one line each."""
        complaints = []
        sets = len(judged.mean_lag)
        short = judged.minimum_backlash < self.minimum_backlash
        if bool(short.any()):
            low = float(judged.minimum_backlash.min())
            complaints.append(
                f"backlash below {self.minimum_backlash:g} rad under {int(short.sum())} of {sets} sets: {low:g}"
            )
        if self.maximum_backlash is not None and bool(
            (judged.mean_backlash > self.maximum_backlash * (1 + 1e-6)).any()
        ):
            complaints.append(
                f"mean backlash above {self.maximum_backlash:g} rad: {float(judged.mean_backlash.max()):g}"
            )
        if self.maximum_pressure is not None and judged.largest_pressure is not None:
            high = float(judged.largest_pressure.max())
            if high > self.maximum_pressure * (1 + 1e-6):
                complaints.append(f"pressure above {self.maximum_pressure:g} Pa: {high:g}")
        clash = judged.clash(scene)
        if clash is not None:
            complaints.append(clash)
        low = float(judged.radial_clearance.min())
        if low < 0:
            complaints.append(f"tips or roots touch: radial clearance {low:g} m")
        for index, requirement in enumerate(self.positive):
            value = float(requirement(scene))
            if value < -1e-12:
                complaints.append(f"require_positive[{index}]: {value:g}")
        return tuple(complaints)
