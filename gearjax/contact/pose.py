"""Pose of a system at one input angle: levers and gaps of ideal bodies, and views of the errors of its bodies.

A view describes how an error that is fixed on a body changes the gaps of the contacts.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError
from gearjax.contact.slices import Slices
from gearjax.geometry.involute import InvoluteGear
from gearjax.geometry.line_contact import Radii
from gearjax.typing import Array, Float, Int, Scalar


@dataclasses.dataclass(frozen=True)
class Request:
    """Request of a scene to a system; only the requested parts of a pose are computed.

    Args:
        back: whether back flanks are modelled.
        bodies: names of the bodies that carry errors.
        mesh: whether the mesh phase is needed.
        radii: whether the radii of curvature are needed.
        places: whether the places of the contacts on their teeth are needed.
        slices: whether the slices of contact lines are needed.
        moving: whether gaps are followed in time. They must then not jump where slices enter and leave the path of
            contact; the stiffness of the slices is zero there.
        coordinates: coordinates of the bodies that have supports, such as ``disc_1.x``.
    """

    back: bool = False
    bodies: tuple[str, ...] = ()
    mesh: bool = False
    radii: bool = False
    places: bool = False
    slices: bool = False
    moving: bool = False
    coordinates: tuple[str, ...] = ()


class Pose(eqx.Module):
    """Contacts of a system with ideal bodies at one input angle. A pose does not depend on errors: assemblies share it.

    Args:
        theta: input angle [rad].
        jacobian: change of overlap per change of the output's position [m/rad] in the first column, and per
            displacement in each requested coordinate [-] in the others, shape (contact, coordinate).
        gap: gaps of ideal bodies, shape (contact,) [m].
        views: views of the requested bodies, by name.
        mesh_angle: mesh phase of each pair, ``2 pi`` per tooth, shape (pair,) [rad]; ``None`` if not requested.
        radii: radii of curvature of the line contacts, shape (contact,); ``None`` if not requested.
        places: places of the contacts on their teeth; ``None`` if not requested.
        slices: slices of contact lines that the contacts of each mesh are; ``None`` if not requested.
    """

    theta: Scalar
    jacobian: Float[Array, "contact coordinate"]
    gap: Float[Array, " contact"]
    views: dict[str, "BodyView"] = eqx.field(default_factory=dict)
    mesh_angle: Float[Array, " pair"] | None = None
    radii: Radii | None = None
    places: "Places | None" = None
    slices: tuple[Slices, ...] | None = None

    def require(self, bodies: Sequence[str], contacts: int) -> None:
        """Refuse a pose that is not of one angle, or of another gear set.

        Args:
            bodies: names of the bodies whose views are needed.
            contacts: number of contacts.

        Raises:
            ParameterError: tells what is wrong.
        """
        missing = [body for body in bodies if body not in self.views]
        if self.theta.ndim:
            given, right = f"poses at {self.theta.size} angles", "must be one pose: give them one by one, by jax.vmap"
        elif missing or len(self.gap) != contacts:
            given = f"a pose without {missing[0]}" if missing else f"a pose of {len(self.gap)} contacts"
            right = "must be scene.pose(angle) of this scene"
        else:
            return
        raise ParameterError("theta", given, right)


class Places(eqx.Module):
    """Places of the contacts on the teeth of a pair of gears.

    The contacts are in blocks that share no tooth; within a block they are in the order pair, point of the profile,
    place across the face.

    Args:
        gears: both gears.
        radius: radii of the contacts on each gear, about its own axis, shape (block, pair, point) [m].
        pair: number of the tooth of each pair, rising in the direction ahead, shape (block, pair) [-].
        shared: length of the flanks that face each other, shape (block, pair) [m].
        face: places across the face, counted from its middle, as shares of the width, shape (face,) [-].
    """

    gears: tuple[InvoluteGear, InvoluteGear]
    radius: tuple[Float[Array, "block pair point"], Float[Array, "block pair point"]]
    pair: Float[Array, "block pair"]
    shared: Float[Array, "block pair"]
    face: Float[Array, " face"]

    @property
    def curvature(self) -> Float[Array, "block pair point"]:
        """Relative curvature of the flanks at the contacts (ISO 21771), shape (block, pair, point) [1/m].

        For an external gear in an internal gear it is ``1 / rho_1 - 1 / rho_2`` with ``rho = sqrt(R^2 - r_b^2)``, but
        not below zero.
        """
        signs = (-1.0 if gear.internal else 1.0 for gear in self.gears)
        each = zip(signs, self.gears, self.radius, strict=True)
        bent = [sign / (gear.base_radius * gear.roll_at(radius)) for sign, gear, radius in each]
        return jnp.maximum(bent[0] + bent[1], 0.0)

    def strips(self, width: Scalar) -> tuple[Float[Array, "block pair point"], Float[Array, " face"]]:
        """Parts of the facing flanks that each contact represents, along the profile and across the face [m].

        The parts have equal lengths, except that those at the ends are half as long.

        Args:
            width: face width [m].
        """
        along, across = (even_parts(number, self.face.dtype) for number in (self.radius[0].shape[-1], len(self.face)))
        return self.shared[..., None] * along[None, None], width * across


def even_parts(number: int, dtype: jnp.dtype) -> Float[Array, " number"]:
    """Shares of a length that evenly spaced points from end to end represent; the shares add up to one.

    The points at the ends represent half as much as the others; a single point represents the whole length.
    """
    if number == 1:
        return jnp.ones(1, dtype)
    parts = np.full(number, 1.0 / (number - 1))
    parts[[0, -1]] *= 0.5
    return jnp.asarray(parts, dtype)


class GearSize(NamedTuple):
    """Sizes of a gear that its deviations are checked against.

    Args:
        teeth: tooth number.
        module: normal module [m].
        diameter: diameter of the reference circle [m].
        width: face width [m].
        pressure_angle: pressure angle in a transverse section, at the reference circle [rad].
        space: half of the angle of a tooth space at the reference circle [rad].
        roll: smallest and largest length of roll of the part of the flank that may touch [m].
        internal: whether its teeth point inwards.
    """

    teeth: int
    module: Scalar
    diameter: Scalar
    width: Scalar
    pressure_angle: Scalar
    space: Scalar
    roll: tuple[Scalar, Scalar]
    internal: bool


class ProfilePlace(eqx.Module):
    """Places of the contacts of a body along the profile and across the face.

    Args:
        to_tip: length of roll from each contact to the tip of its tooth, along the path of contact, shape (contact,)
            [m].
        length: length of roll of the part of the flank that may touch [m].
        across: place of each contact from the middle of the face, shape (contact,) [m]; ``None`` if the gear set does
            not give it.
        width: face width [m]; ``None`` if the gear set does not give it.
        normal: change of gap per material in a transverse section, ``cos beta_b``, one for all contacts or shape
            (contact,), zero at contacts of other bodies; ``None`` for spur gears.
        roll: length of roll of each contact from the base circle, shape (contact,) [m]; ``None`` if the gear set does
            not give it.
        side: side of each contact, 1 on driving flanks, -1 on back flanks, shape (contact,); ``None`` if the gear set
            does not give it.
        ahead: change of gap per length along the reference circle by which a flank is ahead in the sense in which its
            gear turns, shape (contact,) [-]; ``None`` if the gear set does not give it.
    """

    to_tip: Float[Array, " contact"]
    length: Scalar
    across: Float[Array, " contact"] | None = None
    width: Scalar | None = None
    normal: Scalar | Float[Array, " contact"] | None = None
    roll: Float[Array, " contact"] | None = None
    side: Float[Array, " contact"] | None = None
    ahead: Float[Array, " contact"] | None = None

    def seen(self, removed: Array) -> Array:
        """Change of gap if material is removed along the base tangent of a transverse section [m]."""
        return removed if self.normal is None else removed * self.normal


class Rim(eqx.Module):
    """View of displacements of single teeth or pins of a body, each in the axes of its own place on the body.

    Args:
        angle: angle of the place of each contact around the body, counted on the body, shape (contact,) [rad].
        outward: change of gap per outward displacement, shape (contact,) [-].
        around: change of gap per displacement along the circumference, shape (contact,) [-].
        elements: number of teeth or pins; ``None`` if the contacts move around the body and belong to no fixed element.
        element: number of the element of each contact, counted from 0, shape (contact,); without it, contact i belongs
            to the element ``i % elements``.
        own: one at the contacts of this body, zero at those of other bodies, shape (contact,) [-]; ``None`` if all
            contacts touch this body.

    Attributes:
        sine, cosine: sine and cosine of the angle, shape (contact,).
    """

    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]
    outward: Float[Array, " contact"]
    around: Float[Array, " contact"]
    elements: int | None = eqx.field(static=True)
    element: Int[Array, " contact"] | None
    own: Float[Array, " contact"] | None

    def __init__(
        self,
        angle: Float[Array, " contact"],
        outward: Float[Array, " contact"],
        around: Float[Array, " contact"],
        elements: int | None,
        element: Int[Array, " contact"] | None = None,
        own: Float[Array, " contact"] | None = None,
    ):
        self.sine, self.cosine = jnp.sin(angle), jnp.cos(angle)
        self.outward, self.around, self.elements, self.element = outward, around, elements, element
        self.own = own

    def wave(self, number: int) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Sine and cosine of a multiple of the angle, by the addition theorem."""
        sine, cosine = self.sine, self.cosine
        for _ in range(number - 1):
            sine, cosine = sine * self.cosine + cosine * self.sine, cosine * self.cosine - sine * self.sine
        return sine, cosine


class BodyView(eqx.Module):
    """View of a displacement that is fixed on one body, from the lines of action of the contacts.

    A displacement of size ``e`` at the phase ``p`` changes the gaps by ``influence * e * sin(angle + p)``.

    Args:
        turn: angle by which the body has turned relative to the lines of action [rad].
        place: angle from each line of action to the reference direction of the body before this turn, shape (contact,)
            [rad].
        influence: change of gap per displacement along the line of action, shape (contact,) [-].
        rim: view of single teeth or pins of the body; ``None`` for a body without them.
        flank: places of the contacts along the profile of the body; ``None`` for a body without an involute profile.
        of_place: sine and cosine of ``place``, shape (contact,), if the system calculates them with less effort.

    Attributes:
        angle: angle from each line of action to the reference direction, shape (contact,) [rad].
        sine, cosine: sine and cosine of this angle, shape (contact,); the sine of ``turn`` is calculated only once for
            all contacts.
    """

    angle: Float[Array, " contact"]
    influence: Float[Array, " contact"]
    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]
    rim: Rim | None
    flank: ProfilePlace | None

    def __init__(
        self,
        turn: Scalar,
        place: Float[Array, " contact"],
        influence: Float[Array, " contact"],
        rim: Rim | None = None,
        of_place: tuple[Float[Array, " contact"], Float[Array, " contact"]] | None = None,
        flank: ProfilePlace | None = None,
    ):
        sine, cosine = jnp.sin(turn), jnp.cos(turn)
        self.angle, self.influence, self.rim, self.flank = turn + place, influence, rim, flank
        place_sine, place_cosine = (jnp.sin(place), jnp.cos(place)) if of_place is None else of_place
        self.sine = sine * place_cosine + cosine * place_sine
        self.cosine = cosine * place_cosine - sine * place_sine


class Movements(eqx.Module):
    """Views of one body along each direction in which its errors displace it.

    Args:
        x, y: views of the displacement in two directions, which the system chooses [m].
        turn: view of the rotation [rad].
    """

    x: BodyView | None = None
    y: BodyView | None = None
    turn: BodyView | None = None

    def of(self, errors: "Sequence[Error]") -> "Moved":
        """Displacements of the body due to its errors."""
        views = {name: view for name, view in (("x", self.x), ("y", self.y), ("turn", self.turn)) if view is not None}
        blind = _blind(next(iter(views.values())))

        def seen(view: BodyView) -> Float[Array, " contact"]:
            return jax.tree.reduce(jnp.add, [error.gap(view) for error in errors])

        alone = seen(blind)  # part that opens the gaps independently of the direction, such as a smaller pin
        nothing = jnp.zeros_like(alone)
        return Moved(alone, **{name: seen(views[name]) - alone if name in views else nothing for name in _DIRECTIONS})


_DIRECTIONS = ("x", "y", "turn")


class Error(Protocol):
    """Anything that changes the gaps of a body, from the view of this body."""

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        """Change of the gaps, shape (contact,) [m]."""
        ...


class Moved(eqx.Module):
    """Displacement of a body at each contact.

    Args:
        gap: opening of the gaps that does not depend on a direction, shape (contact,) [m].
        x, y: displacement in the directions that the system chooses, shape (contact,) [m].
        turn: rotation, shape (contact,) [rad].
    """

    gap: Float[Array, " contact"]
    x: Float[Array, " contact"]
    y: Float[Array, " contact"]
    turn: Float[Array, " contact"]


def _blind(view: BodyView) -> BodyView:
    """A copy of a view in which displacements have no influence."""
    nothing = jnp.zeros_like(view.influence)
    rim = view.rim
    if rim is not None:
        rim = eqx.tree_at(lambda rim: (rim.outward, rim.around), rim, (nothing, nothing))
    return eqx.tree_at(lambda view: (view.influence, view.rim), view, (nothing, rim), is_leaf=lambda x: x is None)
