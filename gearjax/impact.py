"""Impacts of teeth as they come into mesh: a part of a scene, and the force that it stands for."""

import dataclasses
import math
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.batches import in_batches
from gearjax.checks import SceneError, is_concrete
from gearjax.evaluate import evaluated_or_traced
from gearjax.parameters import check_parameters, count, number
from gearjax.typing import Array, Float, Int, Number, Scalar

if TYPE_CHECKING:
    from gearjax.scene import Scene  # that module imports this one

MOST_PAIRS, AT_ONCE = 20_000, 16  # pairs of teeth in all, and those computed side by side
ALIKE = 1.0  # largest difference of the gaps of teeth that are alike, in spacings of the dtype at 1 m
LONGEST = 4  # pitches that a pulse may last; faster gears have no time for an impact


class MeshingImpact(eqx.Module):
    """Impact of each pair of teeth as it comes into mesh, as a force in motion (Guo and Fang 2018, eqs. 10 to 18).

    Under load the teeth that are in mesh deflect, so that the next pair touches too early or, if its flanks are
    relieved, while its flanks still approach each other. The impact is a half-sine pulse along the normal of the
    flanks, `gearjax.meshing_impact`, under the size of the load torque. It is for gear sets whose contact ends with the
    path of contact; with ``tip_contact = "corner"`` the teeth themselves strike each other.

    Args:
        stiffness: stiffness K_s of the pair that strikes [N/m]; without it, that of the pair's own springs if it
            touches across the face.
        pairs: number of successive pairs of teeth whose impacts are computed one by one; without it one if all are
            alike, otherwise those of a cycle.
    """

    stiffness: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e15, default=None, example="5e8 N/m")
    pairs: int | None = count(default=None, at_most=MOST_PAIRS, example=1)

    def __check_init__(self):
        check_parameters(self)

    def counted(self, scene: "Scene") -> "MeshingImpact":
        """The impact with the number of pairs of teeth of a scene that may differ.

        Raises:
            SceneError: there are more than `MOST_PAIRS`.
        """
        return self if self.pairs is not None else dataclasses.replace(self, pairs=_pairs_that_differ(scene))


class Pulses(eqx.Module):
    """Half-sine pulses, one for each pair of teeth that comes into mesh: the force of its impact over time.

    Args:
        theta: input angles at which the pulses begin, in the order of meshing, shape (pair,) [rad].
        force: largest force of each pulse, along the normal of the flanks, shape (pair,) [N].
        duration: duration of each pulse, shape (pair,) [s].
        pitch: input angle from one pair to the next; after the last pair the first pulse returns [rad].
    """

    theta: Float[Array, " pair"]
    force: Float[Array, " pair"]
    duration: Float[Array, " pair"]
    pitch: float = eqx.field(static=True)

    def at(self, theta: Scalar, speed: Scalar) -> Scalar:
        """Force at an input angle [rad] and an input speed [rad/s] [N]."""
        number = len(self.theta)
        last = jnp.floor((theta - self.theta[0]) / self.pitch)
        # a pair may begin a little earlier or later than the first one, and a pulse may last longer than a pitch
        counted = last + jnp.arange(-LONGEST, 2).astype(theta.dtype)
        turns = jnp.floor(counted / number)
        own = (counted - number * turns).astype(int)
        begun = self.theta[own] + self.pitch * number * turns
        share = jnp.clip((theta - begun) / (speed * self.duration[own]), 0.0, 1.0)
        return (self.force[own] * jnp.sin(jnp.pi * share)).sum()

    def rate(self) -> Scalar:
        """Angular frequency of the shortest pulse [rad/s]."""
        return jnp.pi / self.duration.min()


def pitch_of(scene: "Scene") -> float:
    """Input angle from one pair of teeth to the next [rad]."""
    return 2 * math.pi / scene.system.orders["mesh"]


def of_pair(scene: "Scene", pair: Scalar) -> Int[Array, " slice"]:
    """The contacts on the driving flanks of a pair, counted in the order of meshing."""
    layout = scene.layout
    driving = np.array([own for own in layout.members if layout.side[own[0]] > 0])
    return jnp.asarray(driving)[jnp.mod(pair.astype(int), len(driving))]


def _pairs_that_differ(scene: "Scene") -> int:
    number = round(scene.system.cycle / pitch_of(scene))
    if not scene.errors or (is_concrete(scene) and bool(evaluated_or_traced(_alike, scene.physics("backlash")))):
        return 1
    if number > MOST_PAIRS:
        raise SceneError(f"[impact]: {number} pairs of teeth differ, more than {MOST_PAIRS}: give impact.pairs")
    return number


def _alike(scene: "Scene") -> Array:
    """Whether the gaps of all pairs of a cycle are the same in the middle of their path of contact."""
    number = min(round(scene.system.cycle / pitch_of(scene)), MOST_PAIRS)

    def at(pair: Scalar) -> Array:
        return scene.contacts(pair * pitch_of(scene)).gap[of_pair(scene, pair)]

    gaps = in_batches(at, jnp.arange(number).astype(scene.dtype), AT_ONCE)
    return (gaps.max(axis=0) - gaps.min(axis=0)).max() < ALIKE * float(jnp.finfo(scene.dtype).eps)
