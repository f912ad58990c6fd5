"""Errors of single pins or teeth, and errors of the pitch around a body."""

from typing import ClassVar

import jax.numpy as jnp

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.contact import BodyView, Rim
from gearjax.errors.base import AbstractError
from gearjax.errors.eccentricity import Displacement, rim_of
from gearjax.parameters import angle, check_parameters, count, length, name, series
from gearjax.typing import Array, Float, Number


class Positions(AbstractError):
    """Displacements of the single pins or teeth of a body, along the radius and along the circumference.

    A single value of ``outward`` changes the radius of the circle of pins or teeth; a single value of ``around`` turns
    all of them together (Hu et al. 2020, eqs. 7 and 11). The first value, ``outward[0]`` in a path, is that of pin 1
    or tooth 0.

    On an involute flank each point moves along its own radius and circumference, not along those of the middle of its
    tooth. Where teeth move outward as rigid bodies, gaps of an external gear change by less: by 8 % less with 40 teeth,
    by 16 % less with 18.

    Args:
        body: body of the system that carries the pins or teeth.
        outward: displacement along the radius, positive outwards: one value per pin or tooth, shape (element,), or one
            for all; empty for none [m].
        around: displacement along the circumference: one value per pin or tooth, shape (element,), or one for all;
            empty for none [m].
    """

    kind: ClassVar[str] = "positions"
    deviations: ClassVar[tuple[str, ...]] = ("outward", "around")
    on_rim: ClassVar[bool] = True
    body: str = name()
    outward: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["0 um"])
    around: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["0 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        rim = rim_of(self.body, view)
        outward = _spread("outward", self.outward, rim) * rim.outward if self.outward.size else None
        if not self.around.size:
            return jnp.zeros_like(rim.sine) if outward is None else outward
        around = _spread("around", self.around, rim) * rim.around
        return around if outward is None else outward + around


class Sizes(AbstractError):
    """Deviations of the radii of the single pins of a body, or of its flanks along their normals.

    A larger pin closes its gap (Hu et al. 2020, eq. 8), and so does a lobe or tooth with more material. A clearance
    between pin and groove opens the gap: give minus one half of it (eq. 9).

    Args:
        body: body of the system that carries the pins, lobes or teeth.
        larger: deviation of the radius, positive if the pin is too large; of a lobe or tooth the material on a flank:
            one value per pin, lobe or tooth, shape (element,), or one for all [m].
    """

    kind: ClassVar[str] = "sizes"
    deviations: ClassVar[tuple[str, ...]] = ("larger",)
    on_rim: ClassVar[bool] = True
    body: str = name()
    larger: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["0 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        return -_spread("larger", self.larger, rim_of(self.body, view))


class CumulativePitch(AbstractError):
    """Cumulative pitch error as a wave around the body (Hu et al. 2020, eq. 12: half of F_p, one wave).

    A tooth at the angle ``eta`` on the body is displaced by ``amplitude sin(waves eta + phase)`` along the
    circumference.

    Args:
        body: body of the system that carries the error.
        amplitude: half of the total cumulative pitch error [m].
        phase: phase of the wave at the angle zero on the body [rad].
        waves: number of waves around the body.
    """

    kind: ClassVar[str] = "cumulative_pitch"
    deviations: ClassVar[tuple[str, ...]] = ("amplitude",)
    on_rim: ClassVar[bool] = True
    body: str = name()
    amplitude: Number = length(at_least=0.0, at_most=1.0, example="2 um")
    phase: Number = angle(at_least=-1e6, at_most=1e6, periodic=True)
    waves: int = count(default=1, at_most=100)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        return self.proportional().gap(view)

    def proportional(self) -> Displacement:
        sine, cosine = self.amplitude * jnp.cos(self.phase), self.amplitude * jnp.sin(self.phase)
        return Displacement(self.body, sine, cosine, self.waves)


def spread(key: str, values: Float[Array, " given"], view: BodyView) -> Float[Array, " contact"]:
    """One value per contact, from one value per tooth of its body or from one value for all teeth.

    Raises:
        ParameterError: the number of values is another one, or the contacts do not state their teeth.
    """
    if view.rim is None:
        return jnp.broadcast_to(values, view.influence.shape)
    return _spread(key, values, view.rim)


def _spread(key: str, values: Float[Array, " given"], rim: Rim) -> Float[Array, " contact"]:
    """One value per contact, from one value per element of the rim or for all; zero at contacts of other bodies."""
    each = _each(key, values, rim)
    return each if rim.own is None else each * rim.own


def _each(key: str, values: Float[Array, " given"], rim: Rim) -> Float[Array, " contact"]:
    contacts = rim.sine.shape[0]
    if values.shape == (1,):
        return jnp.broadcast_to(values, (contacts,))
    if rim.elements is None:
        raise ParameterError(key, f"{values.size} values", "give one value: contacts of this body have no known tooth")
    if values.shape != (rim.elements,):
        raise ParameterError(
            key, f"{values.size} values", f"must be {rim.elements}, one per tooth or pin, or one for all"
        )
    if rim.element is not None:
        return values[rim.element]
    # broadcasting, unlike concatenation, fuses with the operations around it
    return jnp.broadcast_to(values, (contacts // rim.elements, rim.elements)).reshape(contacts)
