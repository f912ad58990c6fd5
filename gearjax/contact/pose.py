"""What a system shows at one input angle: levers and gaps of ideal bodies, and how errors of its bodies are seen."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.contact.slices import Slices
from gearjax.geometry.involute import InvoluteGear
from gearjax.geometry.line_contact import Radii
from gearjax.typing import Array, Float, Int, Scalar


@dataclasses.dataclass(frozen=True)
class Request:
    """What a scene asks a system for; what it does not list is not computed.

    Args:
        back: whether back flanks are modelled.
        bodies: those that carry errors.
        mesh: whether the mesh phase counts.
        radii: whether the radii of curvature count.
        places: whether it counts where on their teeth the contacts are.
        slices: whether it counts which slices of contact lines they are.
        moving: whether gaps are followed in time, so that they must not jump where slices come onto the path of contact
            and leave it; there their stiffness is zero.
        coordinates: of the bodies that have supports, such as ``disc_1.x``.
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
    """What a system shows at one input angle. It does not depend on the errors: many assemblies share it.

    Args:
        theta: input angle [rad].
        jacobian: change of overlap per change of the output's position [m/rad], and in further columns per displacement
            in each coordinate that was asked for [-], shape (contact, coordinate).
        gap: of ideal bodies, shape (contact,) [m].
        views: how errors of the bodies are seen that were asked for.
        mesh_angle: mesh phase of each pair, ``2 pi`` per tooth, shape (pair,) [rad]; ``None`` where not asked for.
        radii: of the line contacts, shape (contact,); ``None`` where not asked for.
        places: where on their teeth the contacts are; ``None`` where not asked for.
        slices: which slices of contact lines they are; ``None`` where not asked for.
    """

    theta: Scalar
    jacobian: Float[Array, "contact coordinate"]
    gap: Float[Array, " contact"]
    views: dict[str, "BodyView"] = eqx.field(default_factory=dict)
    mesh_angle: Float[Array, " pair"] | None = None
    radii: Radii | None = None
    places: "Places | None" = None
    slices: Slices | None = None


class Places(eqx.Module):
    """Where contacts are on the teeth of a pair of gears: in blocks that share no tooth, in each of them pair by pair,
    along the profile, then across the face.

    Args:
        gears: whose teeth they are on.
        radius: of the contacts on each of the gears, about its own axis, shape (block, pair, point) [m].
        pair: which tooth of its gear each pair has, counted on ahead, shape (block, pair) [-].
        shared: length of the flanks that face each other, shape (block, pair) [m].
        face: places across the face, counted from its middle, shape (face,), a part of the width [-].
    """

    gears: tuple[InvoluteGear, InvoluteGear]
    radius: tuple[Float[Array, "block pair point"], Float[Array, "block pair point"]]
    pair: Float[Array, "block pair"]
    shared: Float[Array, "block pair"]
    face: Float[Array, " face"]

    @property
    def curvature(self) -> Float[Array, "block pair point"]:
        """Relative curvature of the flanks at the contacts, ``1 / rho_1 - 1 / rho_2`` of an external gear in an
        internal one, with ``rho = sqrt(R^2 - r_b^2)`` (ISO 21771); not below zero, shape (block, pair, point) [1/m]."""
        signs = (-1.0 if gear.internal else 1.0 for gear in self.gears)
        each = zip(signs, self.gears, self.radius, strict=True)
        bent = [sign / (gear.base_radius * gear.roll_at(radius)) for sign, gear, radius in each]
        return jnp.maximum(bent[0] + bent[1], 0.0)

    def strips(self, width: Scalar) -> tuple[Float[Array, "block pair point"], Float[Array, " face"]]:
        """What each contact stands for of the flanks that face each other, along the profile and across the face: even
        parts, those at the ends half as long [m].

        Args:
            width: of the face [m].
        """
        along, across = (even_parts(number, self.face.dtype) for number in (self.radius[0].shape[-1], len(self.face)))
        return self.shared[..., None] * along[None, None], width * across


def even_parts(number: int, dtype: jnp.dtype) -> Float[Array, " number"]:
    """Parts of a length of one that evenly placed points stand for, from end to end: those at the ends for half as
    much; a single one for all."""
    if number == 1:
        return jnp.ones(1, dtype)
    parts = np.full(number, 1.0 / (number - 1))
    parts[[0, -1]] *= 0.5
    return jnp.asarray(parts, dtype)


class GearSize(NamedTuple):
    """What deviations of a gear are measured by.

    Args:
        teeth: tooth number.
        module: normal module [m].
        diameter: of the reference circle [m].
        width: of the face [m].
        pressure_angle: in a transverse section, at the reference circle [rad].
        roll: least and greatest length of roll of the part of the flank that may touch [m].
        internal: whether its teeth point inwards.
    """

    teeth: int
    module: Scalar
    diameter: Scalar
    width: Scalar
    pressure_angle: Scalar
    roll: tuple[Scalar, Scalar]
    internal: bool


class ProfilePlace(eqx.Module):
    """Where along their profile the contacts of a body are, and where across its face.

    Args:
        to_tip: length of roll from each contact to the tip of its tooth, along the path of contact, shape (contact,)
            [m].
        length: of the part of the flank that may touch, in the same measure [m].
        across: place of each contact from the middle of the face, shape (contact,) [m]; ``None`` of gears that do not
            tell.
        width: of the face [m].
        normal: change of gap per material that a transverse section shows, ``cos beta_b``; ``None`` of spur gears.
        roll: length of roll of each contact from the base circle, shape (contact,) [m]; ``None`` of gears that do not
            tell.
        side: of each contact, 1 on flanks that drive, -1 on their backs, shape (contact,); ``None`` as before.
        ahead: change of gap per length along the reference circle by which a flank is ahead, as its gear turns, shape
            (contact,) [-]; ``None`` as before.
    """

    to_tip: Float[Array, " contact"]
    length: Scalar
    across: Float[Array, " contact"] | None = None
    width: Scalar | None = None
    normal: Scalar | None = None
    roll: Float[Array, " contact"] | None = None
    side: Float[Array, " contact"] | None = None
    ahead: Float[Array, " contact"] | None = None

    def seen(self, removed: Array) -> Array:
        """Change of gap by material that is removed along the base tangent of a transverse section [m]."""
        return removed if self.normal is None else removed * self.normal


class Rim(eqx.Module):
    """How displacements of single teeth or pins of a body are seen, each in the axes of its own place on the body.

    Args:
        angle: of each contact's place around the body, counted on it, shape (contact,) [rad].
        outward: change of gap per outward displacement, shape (contact,) [-].
        around: change of gap per displacement along the circumference, shape (contact,) [-].
        elements: number of teeth or pins. ``None`` where the contacts go around the body, which no element stays with.
        element: which one each contact is of, counted from 0, shape (contact,); ``i % elements`` without.

    Attributes:
        sine, cosine: of that angle, shape (contact,).
    """

    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]
    outward: Float[Array, " contact"]
    around: Float[Array, " contact"]
    elements: int | None = eqx.field(static=True)
    element: Int[Array, " contact"] | None

    def __init__(
        self,
        angle: Float[Array, " contact"],
        outward: Float[Array, " contact"],
        around: Float[Array, " contact"],
        elements: int | None,
        element: Int[Array, " contact"] | None = None,
    ):
        self.sine, self.cosine = jnp.sin(angle), jnp.cos(angle)
        self.outward, self.around, self.elements, self.element = outward, around, elements, element

    def wave(self, number: int) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Sine and cosine of a multiple of the angle, by addition."""
        sine, cosine = self.sine, self.cosine
        for _ in range(number - 1):
            sine, cosine = sine * self.cosine + cosine * self.sine, cosine * self.cosine - sine * self.sine
        return sine, cosine


class BodyView(eqx.Module):
    """How a displacement fixed on one body is seen from the contacts' lines of action.

    A displacement of size ``e`` at the phase ``p`` changes the gaps by ``influence * e * sin(angle + p)``.

    Args:
        turn: angle that the body has turned by, seen from the lines of action [rad].
        place: angle of its reference direction from each line of action before, shape (contact,) [rad].
        influence: change of gap per displacement along the line, shape (contact,) [-].
        rim: how single teeth or pins of it are seen; ``None`` for a body without.
        flank: where along their profile its contacts are; ``None`` for a body without.
        of_place: sine and cosine of ``place``, shape (contact,), from a system that makes them of single numbers.

    Attributes:
        angle: of the reference direction from each line of action, shape (contact,) [rad].
        sine, cosine: of that angle, shape (contact,); the sines of ``turn`` are worked out once for all contacts.
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
    """How the errors of one body displace it: in each direction what a view along that direction sees.

    Args:
        x, y: displacement in two directions, which the system chooses [m].
        turn: rotation [rad].
    """

    x: BodyView | None = None
    y: BodyView | None = None
    turn: BodyView | None = None

    def of(self, errors: "Sequence[Error]") -> "Moved":
        """The displacements that errors make."""
        views = {name: view for name, view in (("x", self.x), ("y", self.y), ("turn", self.turn)) if view is not None}
        blind = _blind(next(iter(views.values())))

        def seen(view: BodyView) -> Float[Array, " contact"]:
            return jax.tree.reduce(jnp.add, [error.gap(view) for error in errors])

        alone = seen(blind)  # what opens the gaps whatever the direction, such as a smaller pin
        nothing = jnp.zeros_like(alone)
        return Moved(alone, **{name: seen(views[name]) - alone if name in views else nothing for name in _DIRECTIONS})


_DIRECTIONS = ("x", "y", "turn")


class Error(Protocol):
    """What adds to the gaps of a body that is seen in some way."""

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        """Change of the gaps, shape (contact,) [m]."""
        ...


class Moved(eqx.Module):
    """A displaced body, as each contact has it.

    Args:
        gap: by how much gaps open whatever the direction, shape (contact,) [m].
        x, y: displacement in the system's directions, shape (contact,) [m].
        turn: rotation, shape (contact,) [rad].
    """

    gap: Float[Array, " contact"]
    x: Float[Array, " contact"]
    y: Float[Array, " contact"]
    turn: Float[Array, " contact"]


def _blind(view: BodyView) -> BodyView:
    """The view that sees no displacement."""
    nothing = jnp.zeros_like(view.influence)
    rim = view.rim
    if rim is not None:
        rim = eqx.tree_at(lambda rim: (rim.outward, rim.around), rim, (nothing, nothing))
    return eqx.tree_at(lambda view: (view.influence, view.rim), view, (nothing, rim), is_leaf=lambda x: x is None)
