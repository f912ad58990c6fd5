"""Eccentricity: the axis of a body lies off its axis of rotation."""

from typing import ClassVar

import jax.numpy as jnp

from gearjax.contact import BodyView
from gearjax.errors.base import AbstractError
from gearjax.parameters import angle, check_parameters, length, name
from gearjax.typing import Array, Float, Number


class Eccentricity(AbstractError):
    """A vector that rotates with its body; along a line of action it counts ``e sin(angle + phase)``
    (Wang et al. 2020, eqs. 1-4).

    Args:
        body: body of the system that carries it.
        amplitude: eccentricity e [m].
        phase: phase at input angle zero [rad].
    """

    kind: ClassVar[str] = "eccentricity"
    body: str = name()
    amplitude: Number = length(at_least=0.0, at_most=1.0)
    phase: Number = angle(at_least=-1e6, at_most=1e6, periodic=True)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        # by components: a batch of amplitudes and phases shares the sines of the view
        sine = self.amplitude * jnp.cos(self.phase)
        cosine = self.amplitude * jnp.sin(self.phase)
        return view.influence * (sine * view.sine + cosine * view.cosine)
