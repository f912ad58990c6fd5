"""A gear set with a single contact, which `gearjax.one_contact` makes from the loaded analysis of another gear set."""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError
from gearjax.contact import Layout, Pose, Request
from gearjax.geometry.waves import Waves
from gearjax.parameters import with_known
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Scalar


class OneContact(AbstractSystem):
    """One driving flank, and one back flank if requested, whose gaps are Fourier series of the input angle.

    It has no bodies: its gaps contain the errors of the gear set that it represents.

    Args:
        input_speed: speed of the input [rad/s].
        lever: lever of both flanks [m].
        gaps: gap of the driving flank, and gap of the back flank if there is one [m], as series in an angle that turns
            once in each period.
        period: input angle after which the gaps repeat [rad].
        names: orders of the gear set that it represents, in cycles per turn of the input.
    """

    kind: ClassVar[str] = "one_contact"
    input_speed: Array
    lever: Scalar
    gaps: tuple[Waves, ...]
    period: float = eqx.field(static=True)
    names: tuple[tuple[str, float], ...] = eqx.field(static=True)

    @property
    def precomputes(self) -> bool:
        return any(gap.many for gap in self.gaps)

    def precomputed(self) -> "OneContact":
        return with_known(self, gaps=tuple(gap.tabulated() for gap in self.gaps))

    @property
    def bodies(self) -> tuple[str, ...]:
        return ()

    @property
    def orders(self) -> Mapping[str, float]:
        mesh = 2 * math.pi / self.period
        return dict(self.names) | {"mesh": mesh, "waves": mesh * self.gaps[0].cosine.shape[0]}

    @property
    def cycle(self) -> float:
        return self.period

    @property
    def told_of_forces(self) -> str | None:
        return "forces are sums over all contacts: one contact represents them"

    def contact_name(self, contact: int) -> str:
        return f"the contact that stands for all {('driving', 'back')[contact]} flanks"

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        if request.bodies:
            raise ParameterError("body", request.bodies[0], "does not exist: a one_contact scene has no bodies")
        side = jnp.asarray(np.asarray(self.layout(request).side), theta.dtype)
        phase = jnp.reshape(self.orders["mesh"] * theta, (1,))
        gap = jnp.concatenate([waves.at(phase) for waves in self.gaps[: len(side)]])
        return Pose(theta, -side[:, None] * self.lever, gap, {}, phase if request.mesh else None)
