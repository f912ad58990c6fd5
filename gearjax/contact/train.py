"""Trains: meshes in series, with shafts between them that turn freely.

Motion is transmitted from the input. The touching flanks of the first mesh determine the position of the first shaft,
the touching flanks of the next mesh the position of the next shaft, and finally the position of the output. The sign of
the torque decides which flanks touch.
"""

import jax.numpy as jnp
import numpy as np

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import AbstractContact
from gearjax.typing import Array, Float, Scalar


def touching(contacts: ContactSet, law: AbstractContact, side: int) -> Float[Array, " free"]:
    """Positions of the output and of shafts that turn freely, at which the flanks of one side just touch.

    Args:
        contacts: contacts of a train whose sides are known.
        law: contact law.
        side: 1 for the driving flanks, -1 for the back flanks.
    """
    place = jnp.zeros((contacts.free,), contacts.gap.dtype)
    for column, own, touch in _each(contacts, side):
        scale = jnp.mean(jnp.abs(contacts.jacobian[own, column]))
        at = touch(place)
        place = place.at[column].set(side * law.maximum(side * at * scale) / scale)
    return place


def closed_first(contacts: ContactSet, applied: Scalar) -> tuple[Float[Array, " free"], Float[Array, " contact"]]:
    """Positions at which a load closes the first contact of each mesh, and the gaps counted from these positions.

    The gaps of these first contacts are exactly zero, so that the forces of a tiny torque are not lost in rounding.
    """

    def first(side: int) -> tuple[Array, Array]:
        place, zero = jnp.zeros((contacts.free,), contacts.gap.dtype), jnp.zeros(contacts.gap.shape, bool)
        for column, own, touch in _each(contacts, side):
            at = touch(place)
            one = jnp.argmax(side * at)
            place, zero = place.at[column].set(at[one]), zero.at[jnp.asarray(own)[one]].set(True)
        return place, zero

    place, zero = first(1)
    if contacts.layout.has_back:
        back = first(-1)
        place, zero = (jnp.where(applied > 0, other, one) for one, other in zip((place, zero), back, strict=True))
    apart = contacts.gap - contacts.jacobian[:, : contacts.free] @ place
    return place, jnp.where(zero, 0.0, apart)


def _each(contacts: ContactSet, side: int):
    """Each coordinate of a train in turn, its contacts on one side, and a function for the positions at which they
    touch.

    The function takes the positions of the other coordinates as given.
    """
    sides = np.asarray(contacts.layout.side)
    for column, members in contacts.stages:
        own = members[sides[members] == side]
        arms = contacts.jacobian[own, : contacts.free]

        def touch(place: Array, own: np.ndarray = own, arms: Array = arms, column: int = column) -> Array:
            return (contacts.gap[own] - arms @ place) / arms[:, column]

        yield column, own, touch
