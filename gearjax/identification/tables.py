"""The transmission error of recordings as a function of the unknowns, with its derivatives.

If springs are linear and uncoupled, and gaps are linear in the unknowns (which is tested on the scene, whatever its
kind of gear set), tables of influence are computed once for each recording. A position then takes a few products, and
its derivative is a mean over the contacts that carry:

    dq/dx = sum_carrying(k J dg/dx) / sum_carrying(k J^2)

All other scenes are differentiated directly (`Plain`).
"""

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.resting import edge, edges, rest
from gearjax.batches import in_batches
from gearjax.contact import ContactSet, LinearSprings
from gearjax.contact.equilibrium import hard_rest
from gearjax.contact.search import closed_side, hard_balance
from gearjax.identification.unknowns import Unknown, scene_with
from gearjax.scene import Scene, Stiffness
from gearjax.typing import Array, Bool, Float, Int
from gearjax.units import arcmin

ROWS_AT_ONCE = 4096  # rows whose influences are computed at once
AT_ONCE = 256  # rows of `Plain` that are differentiated at once


class AbstractCurves(eqx.Module):
    """Positions of the output at the rows of recordings, as functions of the unknowns."""

    @abc.abstractmethod
    def positions(self, values: Float[Array, "s unknown"]) -> tuple[Float[Array, "s n"], Float[Array, "s n unknown"]]:
        """Positions of the output and their derivatives [rad]."""


class Tables(AbstractCurves):
    """Influence of the unknowns on the contacts of rows; lengths are divided by the root of the springs' flexibility.

    ``side`` is the side of each contact if contacts are few and keep their sides: their balance is then one expression.
    It is empty otherwise.
    """

    lever: Float[Array, "contact n"]
    nominal: Float[Array, "contact n"]
    influence: Float[Array, "unknown contact n"]
    torque: Float[Array, " n"]
    back: Bool[Array, " n"]
    side: tuple[int, ...] = eqx.field(static=True)
    softness: int | None = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)
    touching: bool = eqx.field(static=True)

    def positions(self, values: Float[Array, "s unknown"]) -> tuple[Float[Array, "s n"], Float[Array, "s n unknown"]]:
        """Positions of the output and their derivatives [rad]."""
        q, rate = jax.lax.map(self.at, values)
        return q, jnp.swapaxes(rate, 1, 2)

    def at(self, values: Float[Array, " unknown"]) -> tuple[Float[Array, " n"], Float[Array, "unknown n"]]:
        """Positions of the output at one point, and their derivatives [rad]."""
        gap = self.nominal + jnp.einsum("u,ucn->cn", values, self.influence)
        softness = jnp.ones_like(values[0]) if self.softness is None else values[self.softness]
        found = [self._carrying(gap, softness)] if self.loaded else []
        found += [self._touching(gap)] if self.touching else []
        q, active = found[0]
        if len(found) == 2:
            rigid = self.torque == 0
            q = jnp.where(rigid, found[1][0], q)
            active = jnp.where(rigid[None], found[1][1], active)
        slope = (active * self.lever).sum(axis=0)
        slope = jnp.where(slope > 0, slope, 1.0)
        shares = active / slope[None]
        if self.side:  # as one expression: a sum over an inner axis takes twice as long
            rate = functools.reduce(jnp.add, [shares[c][None] * self.influence[:, c] for c in range(len(self.side))])
        else:
            rate = (shares[None] * self.influence).sum(axis=1)
        if self.softness is not None:
            rate = rate.at[self.softness].set(jnp.where(self.torque == 0, 0.0, -self.torque) / slope)
        return q, rate

    def _carrying(self, gap: Float[Array, "contact n"], softness: Float[Array, ""]) -> tuple[Array, Array]:
        """Positions under the torque [rad], and the levers of the contacts that carry, zero for the others."""
        applied = -softness * self.torque
        if self.side:
            q = hard_rest(list(gap / self.lever), list(self.lever * self.lever), self.side, applied)
        else:
            q = hard_balance(self.lever, gap, applied, closed_side(self.lever, gap, applied))
        return q, jnp.where(self.lever * q[None] > gap, self.lever, 0.0)

    def _touching(self, gap: Float[Array, "contact n"]) -> tuple[Array, Array]:
        """Positions at which the first contact touches [rad], and its lever, zero for the others."""
        lever = self.lever
        place = gap / jnp.where(lever == 0, 1.0, lever)
        lower, upper = jnp.where(lever < 0, place, -jnp.inf), jnp.where(lever > 0, place, jnp.inf)
        which = jnp.where(self.back, jnp.argmin(upper, axis=0), jnp.argmax(lower, axis=0))
        q = jnp.where(self.back, upper.min(axis=0), lower.max(axis=0))
        return q, jnp.where(jnp.arange(gap.shape[0])[:, None] == which[None], lever, 0.0)


class Plain(AbstractCurves):
    """Rows of a scene whose gaps are not linear in the unknowns, such as one of exact geometry.

    If springs are linear and uncoupled, the derivatives of the gaps at the position found are summed with the weights
    of `Tables`. Unknowns of which no two change the same gap share one tangent (Curtis, Powell and Reid 1974).
    """

    scene: Scene
    theta: Float[Array, " n"]
    torque: Float[Array, " n"]
    back: Bool[Array, " n"]
    turn: Float[Array, "record unknown unknown"]
    record: Array
    opens: Float[Array, "unknown contact"] | None
    each: tuple[Unknown, ...] = eqx.field(static=True)
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)
    touching: bool = eqx.field(static=True)

    def positions(self, values: Float[Array, "s unknown"]) -> tuple[Float[Array, "s n"], Float[Array, "s n unknown"]]:
        """Positions of the output and their derivatives [rad]."""
        rows = self.theta, self.torque, self.back, self.record
        both = self._by_tangents if self.opens is None else self._by_contacts
        return jax.lax.map(lambda one: in_batches(lambda row: both(one, row), rows, AT_ONCE), values)

    def _at(self, values: Array, row: tuple) -> Array:
        """Position of the output at one row [rad]."""
        theta, torque, back, record = row
        scene = scene_with(self.each, self.turn[record] @ values, self.scene)
        found = []
        if self.loaded:
            found.append(rest(scene, theta, torque).position)
        if self.touching:
            found.append(jnp.where(back, *edges(scene, theta)[::-1]) if scene.has_back else edge(scene, theta))
        return found[0] if len(found) == 1 else jnp.where(torque == 0, found[1], found[0])

    def _by_tangents(self, values: Array, row: tuple) -> tuple[Array, Array]:
        position, push = jax.linearize(lambda v: self._at(v, row), values)
        return position, jax.vmap(push)(jnp.eye(values.shape[0], dtype=values.dtype))

    def _by_contacts(self, values: Array, row: tuple) -> tuple[Array, Array]:
        theta, torque, back, record = row
        position = self._at(values, row)
        way: Stiffness = "mean" if self.loaded else "rigid"

        def seen(values: Array) -> tuple[tuple[Array, Array], Array]:
            scene = scene_with(self.each, self.turn[record] @ values, self.scene)
            contacts = scene.contacts(theta, way, position)
            return (contacts.lever * position - contacts.gap, springs_of(contacts)), contacts.lever

        (overlap, stiffness), push, lever = jax.linearize(seen, values, has_aux=True)
        members = np.zeros((len(self.each), len(self.groups)))
        for group, own in enumerate(self.groups):
            members[list(own), group] = 1.0
        spread = jnp.asarray(members)
        closed, stiffer = jax.vmap(push)(spread.T)
        assert self.opens is not None
        closed, stiffer = self.opens * (spread @ closed), self.opens * (spread @ stiffer)
        active = jnp.where(overlap > 0, lever, 0.0)
        if self.touching:
            side = jnp.where(back, lever > 0, lever < 0)
            touch = jnp.arange(lever.shape[0]) == jnp.argmax(jnp.where(side, overlap / jnp.abs(lever), -jnp.inf))
            active = jnp.where(torque == 0, jnp.where(touch, lever, 0.0), active)
        slope = (active * stiffness * lever).sum()
        pull = closed @ (active * stiffness) + jnp.where(torque == 0, 0.0, 1.0) * (stiffer @ (active * overlap))
        return position, -pull / jnp.where(slope > 0, slope, 1.0)


@eqx.filter_jit
def sums(
    model: Tables, values: Array, number: Int[Array, ""], te: Array, weight: Array, basis: Array
) -> tuple[Array, Array, Array]:
    """Sums of a least-squares problem: cost, ``J^T W J`` and ``J^T W r``, as in `Normal`.

    Only the first ``number`` points are computed, so that a search whose starts end one by one has one program.
    """
    size = values.shape[1] - basis.shape[1]
    further, root = basis.T, jnp.sqrt(weight)

    def one(point: Array) -> Array:
        q, rate = model.at(point[:size])
        residual = te - q / arcmin - point[size:] @ further
        residual = jnp.where(weight > 0, residual, 0.0)
        columns = root[None] * jnp.concatenate([rate / arcmin, further, residual[None]])
        return columns @ columns.T

    nothing = jnp.zeros((len(values), values.shape[1] + 1, values.shape[1] + 1), values.dtype)
    all_sums = jax.lax.fori_loop(0, number, lambda i, so_far: so_far.at[i].set(one(values[i])), nothing)
    return all_sums[:, -1, -1], all_sums[:, :-1, :-1], all_sums[:, :-1, -1]


@eqx.filter_jit
def positions_at(model: AbstractCurves, values: Array) -> tuple[Array, Array]:
    """Positions of the output [rad] and their derivatives, at several points."""
    return model.positions(values)


@eqx.filter_jit
def curves_at(model: AbstractCurves, values: Array) -> Array:
    """Positions of the output at several points, without derivatives [rad]."""
    return model.positions(values)[0]


@eqx.filter_jit
def looked(
    each: tuple[Unknown, ...], scene: Scene, way: Stiffness, theta: Array, values: Array
) -> tuple[Array, Array, Array]:
    """Gaps, levers and stiffness at some angles and values, shape (value, angle, contact)."""

    def at(values: Array, angle: Array) -> tuple[Array, Array, Array]:
        contacts = scene_with(each, values, scene).contacts(angle, way)
        return contacts.gap, contacts.lever, springs_of(contacts)

    return jax.vmap(jax.vmap(at, in_axes=(None, 0)), in_axes=(0, None))(values, theta)


@eqx.filter_jit
def tabulated(
    each: tuple[Unknown, ...], scene: Scene, way: Stiffness, theta: Array, start: Array
) -> tuple[Array, Array, Array, Array]:
    """Gaps at the start, their derivatives, levers and stiffness; the first axis is the row."""

    def at(angle: Array) -> tuple[Array, Array, Array, Array]:
        pose = scene.pose(angle, way)

        def gap(values: Array) -> Array:
            return scene_with(each, values, scene).contacts(pose, way).gap

        contacts = scene_with(each, start, scene).contacts(pose, way)
        return contacts.gap, jax.jacfwd(gap)(start), contacts.lever, springs_of(contacts)

    return in_batches(at, theta, ROWS_AT_ONCE)


def springs_of(contacts: ContactSet) -> Array:
    """Stiffness of linear springs, 1 for rigid teeth, shape (contact,) [N/m]."""
    if contacts.springs is None:
        return jnp.ones_like(contacts.gap)
    assert isinstance(contacts.springs, LinearSprings)
    return contacts.springs.stiffness
