"""Eccentricity: the axis of a body lies off its axis of rotation."""

from typing import ClassVar

import jax.numpy as jnp

from gearjax.checks import ParameterError
from gearjax.contact import BodyView, Rim
from gearjax.errors.base import AbstractError
from gearjax.parameters import angle, check_parameters, count, length, name
from gearjax.typing import Array, Float, Number


class Eccentricity(AbstractError):
    """Eccentricity of a body: its axis is off its axis of rotation, by a vector that turns with the body.

    Along a line of action the eccentricity moves the flank by ``e sin(angle + phase)`` (Wang et al. 2020, eqs. 1-4).

    Args:
        body: body of the system that carries the error.
        amplitude: eccentricity e, half of the run-out that a dial gauge or a drawing shows [m].
        phase: phase at input angle zero [rad].
    """

    kind: ClassVar[str] = "eccentricity"
    deviations: ClassVar[tuple[str, ...]] = ("amplitude",)
    body: str = name()
    amplitude: Number = length(at_least=0.0, at_most=1.0, example="2 um")
    phase: Number = angle(at_least=-1e6, at_most=1e6, periodic=True)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        # a batch of amplitudes and phases, written as components, shares the sines of the view
        return self.proportional().gap(view)

    def proportional(self) -> "Displacement":
        return Displacement(self.body, self.amplitude * jnp.cos(self.phase), self.amplitude * jnp.sin(self.phase))


class Displacement(AbstractError):
    """An `Eccentricity` given by its components, or a wave of displacements around the rim of a body.

    Args:
        body: body of the system that carries the error.
        sine, cosine: ``amplitude cos(phase)`` and ``amplitude sin(phase)`` [m].
        waves: number of waves around the body, 0 for a displacement of the whole body.
    """

    kind: ClassVar[str] = "displacement"
    deviations: ClassVar[tuple[str, ...]] = ("sine", "cosine")
    body: str = name()
    sine: Number = length(at_least=-1.0, at_most=1.0)
    cosine: Number = length(at_least=-1.0, at_most=1.0)
    waves: int = count(default=0, at_least=0)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        if self.waves == 0:
            return view.influence * (self.sine * view.sine + self.cosine * view.cosine)
        rim = rim_of(self.body, view)
        sine, cosine = rim.wave(self.waves)
        return rim.around * (self.sine * sine + self.cosine * cosine)


def rim_of(body: str, view: BodyView) -> Rim:
    """The rim of a body, from its view.

    Raises:
        ParameterError: the body has no rim.
    """
    if view.rim is None:
        raise ParameterError("body", body, "has no rim of pins or teeth to carry this error")
    return view.rim
