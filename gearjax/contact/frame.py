"""The hand-over types between a gear set and its analyses.

A contact is a one-sided spring. The displacement ``q`` of the output from its ideal position [rad] closes it by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque, so their ``J`` is negative (the overlap grows when the
output falls back); the ``J`` of a back flank is positive. Driving contacts come first, back contacts follow in
the same order, so that contact ``i`` and contact ``pairs + i`` are the two flanks of pair ``i``.
"""

import enum

import equinox as eqx
import jax.numpy as jnp

from gearjax.typing import Array, Float, Scalar


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


class BodyView(eqx.Module):
    """How a displacement fixed on one body is seen from the lines of action of one flank.

    A displacement of size ``e`` at the phase ``p`` changes the gaps by ``influence * e * sin(angle + p)``.

    Args:
        turn: angle that the body has turned by, seen from the lines of action [rad].
        place: angle of its reference direction from each line of action before, shape (contact,) [rad].
        influence: change of gap per displacement along the line, shape (contact,) [-].

    Attributes:
        angle: of the reference direction from each line of action, shape (contact,) [rad].
        sine, cosine: of that angle, shape (contact,); the sines of ``turn`` are worked out once for all contacts.
    """

    angle: Float[Array, " contact"]
    influence: Float[Array, " contact"]
    sine: Float[Array, " contact"]
    cosine: Float[Array, " contact"]

    def __init__(self, turn: Scalar, place: Float[Array, " contact"], influence: Float[Array, " contact"]):
        sine, cosine = jnp.sin(turn), jnp.cos(turn)
        self.angle, self.influence = turn + place, influence
        self.sine = sine * jnp.cos(place) + cosine * jnp.sin(place)
        self.cosine = cosine * jnp.cos(place) - sine * jnp.sin(place)


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
        stiffness: shape (contact,) [N/m], ``None`` for rigid teeth.
        pairs: number of driving contacts; they come first.
    """

    jacobian: Float[Array, "contact dof"]
    gap: Float[Array, " contact"]
    stiffness: Float[Array, " contact"] | None
    pairs: int = eqx.field(static=True)

    @property
    def lever(self) -> Float[Array, " contact"]:
        """The single column of the Jacobian [m/rad]."""
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def has_back(self) -> bool:
        """Whether back flanks are modelled."""
        return self.gap.shape[0] > self.pairs


def join(drive: ContactFrame, back: ContactFrame | None, stiffness: Float[Array, " pair"] | None) -> ContactSet:
    """Contacts of both flanks as one set; the two flanks of a pair are equally stiff."""
    pairs = drive.gap.shape[0]
    if back is None:
        return ContactSet(drive.jacobian, drive.gap, stiffness, pairs)
    return ContactSet(
        jnp.concatenate([drive.jacobian, back.jacobian]),
        jnp.concatenate([drive.gap, back.gap]),
        None if stiffness is None else jnp.concatenate([stiffness, stiffness]),
        pairs,
    )
