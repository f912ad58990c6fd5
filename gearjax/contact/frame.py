"""The hand-over types between a gear set and its analyses.

A contact is a one-sided spring. The displacement ``q`` of the output from its ideal position [rad] closes it by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque, so their ``J`` is negative (the overlap grows when the
output falls back); the ``J`` of a back flank is positive. Driving contacts come first, back contacts follow in
the same order, so that contact ``i`` and contact ``pairs + i`` are the two flanks of pair ``i``.

Pins of a cycloidal disc touch one flank after the other as the disc goes around: their contacts are two-sided, the
sign of ``J`` tells which flank it is, and there are no others.
"""

import enum
from collections.abc import Sequence
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact.line import LineSprings
from gearjax.typing import Array, Float, Int, Scalar


class Flank(enum.IntEnum):
    """Side of a tooth; the value is the sign of the torque that loads it."""

    DRIVE = 1
    BACK = -1


class ContactFrame(eqx.Module):
    """Where the contacts of one flank are at one input angle, for ideal bodies.

    Args:
        jacobian: change of overlap per change of the output's position, shape (contact, dof) [m/rad].
        gap: ideal gap, shape (contact,) [m].
    """

    jacobian: Float[Array, "contact dof"]
    gap: Float[Array, " contact"]


class Rim(eqx.Module):
    """How displacements of single teeth or pins of a body are seen, each in the axes of its own place on the body.

    Args:
        angle: of each contact's place around the body, counted on it, shape (contact,) [rad].
        outward: change of gap per outward displacement, shape (contact,) [-].
        around: change of gap per displacement along the circumference, shape (contact,) [-].
        elements: number of teeth or pins; contact ``i`` is of element ``i % elements``. ``None`` where the contacts go
            around the body, which no element stays with.

    Attributes:
        sine, cosine: of that angle, shape (contact,).
    """

    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]
    outward: Float[Array, " contact"]
    around: Float[Array, " contact"]
    elements: int | None = eqx.field(static=True)

    def __init__(
        self,
        angle: Float[Array, " contact"],
        outward: Float[Array, " contact"],
        around: Float[Array, " contact"],
        elements: int | None,
    ):
        self.sine, self.cosine = jnp.sin(angle), jnp.cos(angle)
        self.outward, self.around, self.elements = outward, around, elements

    def wave(self, number: int) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Sine and cosine of a multiple of the angle, by addition."""
        sine, cosine = self.sine, self.cosine
        for _ in range(number - 1):
            sine, cosine = sine * self.cosine + cosine * self.sine, cosine * self.cosine - sine * self.sine
        return sine, cosine


class BodyView(eqx.Module):
    """How a displacement fixed on one body is seen from the lines of action of one flank.

    A displacement of size ``e`` at the phase ``p`` changes the gaps by ``influence * e * sin(angle + p)``.

    Args:
        turn: angle that the body has turned by, seen from the lines of action [rad].
        place: angle of its reference direction from each line of action before, shape (contact,) [rad].
        influence: change of gap per displacement along the line, shape (contact,) [-].
        rim: how single teeth or pins of it are seen; ``None`` for a body without.

    Attributes:
        angle: of the reference direction from each line of action, shape (contact,) [rad].
        sine, cosine: of that angle, shape (contact,); the sines of ``turn`` are worked out once for all contacts.
    """

    angle: Float[Array, " contact"]
    influence: Float[Array, " contact"]
    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]
    rim: Rim | None

    def __init__(
        self,
        turn: Scalar,
        place: Float[Array, " contact"],
        influence: Float[Array, " contact"],
        rim: Rim | None = None,
    ):
        sine, cosine = jnp.sin(turn), jnp.cos(turn)
        self.angle, self.influence, self.rim = turn + place, influence, rim
        self.sine = sine * jnp.cos(place) + cosine * jnp.sin(place)
        self.cosine = cosine * jnp.cos(place) - sine * jnp.sin(place)


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


class Side(eqx.Module):
    """What a system shows of one flank: contacts of ideal bodies, and the views of the bodies that carry errors."""

    frame: ContactFrame
    views: dict[str, BodyView]


class Pose(eqx.Module):
    """What a system shows at one input angle. It does not depend on the errors: many assemblies share it.

    Args:
        theta: input angle [rad].
        drive, back: both flanks; ``back`` is ``None`` where no back flanks are modelled.
    """

    theta: Scalar
    drive: Side
    back: Side | None


class ContactSet(eqx.Module):
    """All candidate contacts of a scene at one input angle, errors included.

    Args:
        jacobian: shape (contact, dof) [m/rad].
        gap: shape (contact,) [m].
        stiffness: shape (contact,) [N/m], or the law of elastic line contacts; ``None`` for rigid teeth.
        pairs: number of driving contacts; they come first. All contacts where they are two-sided.
        two_sided: whether the sign of its lever tells which flank a contact is.
    """

    jacobian: Float[Array, "contact dof"]
    gap: Float[Array, " contact"]
    stiffness: Float[Array, " contact"] | LineSprings | None
    pairs: int = eqx.field(static=True)
    two_sided: bool = eqx.field(static=True, default=False)

    @property
    def lever(self) -> Float[Array, " contact"]:
        """The single column of the Jacobian [m/rad]."""
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def linear(self) -> Float[Array, " contact"] | None:
        """Stiffness of linear springs, shape (contact,) [N/m]; ``None`` for rigid teeth."""
        if isinstance(self.stiffness, LineSprings):
            raise ValueError("this solver is for linear springs, the contacts are line contacts")
        return self.stiffness

    @property
    def has_back(self) -> bool:
        """Whether back flanks are modelled."""
        return self.two_sided or self.gap.shape[0] > self.pairs

    def carriers(self, load: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry a generalised force [N m]; two-sided contacts: those on its side."""
        if not self.two_sided:
            return jnp.asarray(self.pairs)
        return jnp.where(load > 0, self.lever > 0, self.lever < 0).sum()


def join(
    drive: ContactFrame,
    back: ContactFrame | None,
    stiffness: Float[Array, " pair"] | LineSprings | None,
    two_sided: bool = False,
) -> ContactSet:
    """Contacts of both flanks as one set; the two flanks of a pair are equally stiff."""
    pairs = drive.gap.shape[0]
    if back is None:
        return ContactSet(drive.jacobian, drive.gap, stiffness, pairs, two_sided)
    return ContactSet(
        jnp.concatenate([drive.jacobian, back.jacobian]),
        jnp.concatenate([drive.gap, back.gap]),
        jax.tree.map(lambda each: jnp.concatenate([each, each]), stiffness),
        pairs,
    )
