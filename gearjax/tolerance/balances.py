"""Quasi-static curves of many gear sets whose contacts change sides, such as the pins of cycloidal discs.

The contacts that carry, and their levers, change with the input angle. Curves are therefore not interpolated: each gear
set is evaluated at all angles, one angle after the other, with several gear sets side by side as the last axis. Gaps
are then sums of few products that stay in the processor's cache (`gearjax.tolerance.affine`), and the search for a
balance starts at the balance of the previous angle.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from gearjax.analysis.metrics import top
from gearjax.contact.equilibrium import facing
from gearjax.contact.search import closed_side, hard_balance
from gearjax.errors import AbstractError
from gearjax.scene import Scene
from gearjax.tolerance.affine import AffineGaps, summed
from gearjax.tolerance.closer import ends, is_followed
from gearjax.typing import Array, Float, Scalar

EXAMPLES = 4  # gear sets whose gaps are compared with the sums
Key = tuple[str, float | None]
"""An analysis and its torque."""


class Balances(eqx.Module):
    """Data for curves that are common to all gear sets of a population.

    Args:
        lever: levers of the contacts, shape (n, contact) [m/rad].
        gaps: gaps of the contacts, as sums.
        varied: keys of the errors that differ between gear sets.
    """

    lever: Float[Array, "n contact"]
    gaps: AffineGaps
    varied: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, examples: Scene, theta: Float[Array, " n"], varied: Sequence[str]) -> "Balances | None":
        """From examples of the population, every number with a leading axis; ``None`` if gaps are no sums of products.

        No number of the system may vary.
        """
        varied = tuple(sorted(set(varied)))
        first = jax.tree.map(lambda leaf: leaf[0], examples)
        poses = jax.jit(jax.vmap(first.pose))(theta)
        _, unravel = ravel_pytree(_numbers(first, varied))

        def gap(numbers: Array, pose) -> Array:
            errors = {**first.errors, **unravel(numbers)}
            return eqx.tree_at(lambda scene: scene.errors, first, errors).contacts(pose).gap

        few = jax.tree.map(lambda leaf: leaf[:EXAMPLES], examples)
        gaps = AffineGaps.of(gap, poses, jax.vmap(lambda scene: _flat(scene, varied))(few))
        return None if gaps is None else cls(poses.jacobian[..., 0], gaps, varied)

    def curve(self, scene: Scene, analysis: str, torque: float | None) -> Float[Array, " n"]:
        """The curve of an analysis of one gear set [rad], computed at all angles at once."""
        lever, gap = self.lever.T, self.gaps.everywhere(_flat(scene, self.varied))
        if torque is None:
            return _edges(lever, gap, analysis)
        applied = jnp.broadcast_to(_applied(scene, torque), gap.shape[1:])
        return hard_balance(lever, gap, applied, closed_side(*jax.lax.stop_gradient((lever, gap, applied))))

    def curves(self, scenes: Scene, keys: Sequence[Key]) -> list[Float[Array, "n row"]]:
        """The curves of analyses [rad] of several gear sets, whose numbers have a leading axis."""
        numbers = jax.vmap(lambda scene: _flat(scene, self.varied), out_axes=-1)(scenes)
        terms = jax.lax.optimization_barrier(self.gaps.once(numbers))
        applied_each = [
            jax.vmap(_applied, in_axes=(0, None))(scenes, torque) for _, torque in keys if torque is not None
        ]
        tables = self.lever[..., None], self.gaps.nominal[..., None], self.gaps.influence[..., None]
        lever, nominal, influence = (table[0] for table in tables)
        gap = summed(nominal, influence, terms, numbers.shape[-1])
        starts = [closed_side(*jax.lax.stop_gradient((lever, gap, applied))) for applied in applied_each]

        def step(last: list[Array], at: tuple[Array, Array, Array]) -> tuple[list[Array], list[Array]]:
            lever, gap = at[0], summed(*at[1:], terms, numbers.shape[-1])
            rests = [hard_balance(lever, gap, applied, near) for applied, near in zip(applied_each, last, strict=True)]
            near = [jnp.where(jnp.isnan(rest), start, rest) for rest, start in zip(rests, last, strict=True)]
            waiting = iter(rests)
            curves = [_edges(lever, gap, analysis) if torque is None else next(waiting) for analysis, torque in keys]
            return jax.lax.stop_gradient(near), curves

        return jax.lax.scan(step, starts, tables)[1]

    @property
    def is_followed(self) -> bool:
        """Whether levers and gaps are smooth enough to be interpolated between the angles (`tops`)."""
        return all(is_followed(table) for table in (self.lever, self.gaps.nominal, self.gaps.influence))

    def tops(self, scenes: Scene, key: Key, curve: Float[Array, "n row"]) -> tuple[Array, Array]:
        """Highest and lowest value of a curve of several gear sets, also between the angles, shape (row,) each [rad].

        Args:
            scenes: the gear sets, whose numbers have a leading axis.
            key: the analysis and its torque.
            curve: the curve at the angles, as from `curves`.
        """
        analysis, torque = key
        numbers = jax.vmap(lambda scene: _flat(scene, self.varied), out_axes=-1)(scenes)
        terms = self.gaps.terms(numbers)
        rows = curve.shape[1]

        def tables(nodes: Array) -> tuple[Array, Array]:
            opened = (self.gaps.influence[nodes] * jnp.moveaxis(terms, -1, 0)[None, None]).sum(axis=3)
            return jnp.moveaxis(self.lever[nodes], -1, 1), jnp.moveaxis(self.gaps.nominal[nodes] + opened, -1, 1)

        def of_lanes(lever: Array, gap: Array, near: Array) -> Array:
            if torque is None:
                return _edges(lever, gap, analysis)
            applied = jnp.tile(jax.vmap(_applied, in_axes=(0, None))(scenes, torque), gap.shape[1] // rows)
            return hard_balance(lever, gap, applied, near)

        return ends(of_lanes, tables, curve)


def _numbers(scene: Scene, varied: Sequence[str]) -> dict[str, AbstractError]:
    """The errors that vary, in the form of numbers to which their gaps are proportional."""
    return {key: scene.errors[key].proportional() for key in varied}


def _flat(scene: Scene, varied: Sequence[str]) -> Float[Array, " number"]:
    return ravel_pytree(_numbers(scene, varied))[0].astype(scene.dtype)  # an empty tree has another dtype


def _applied(scene: Scene, torque: float) -> Scalar:
    """Generalised force on the output over the stiffness of one contact, the same for all contacts [m^2/rad]."""
    return -torque / scene.layout.apiece(scene.linear_compliance.mean_stiffness(1))[0]


def _edges(lever: Float[Array, "contact _"], gap: Float[Array, "contact lane"], analysis: str) -> Float[Array, " lane"]:
    """The lower edge of the backlash (the no-load TE), or the backlash [rad]."""
    per_lever = 1 / jnp.abs(lever).mean(axis=0, keepdims=True)

    def edge(sign: float) -> Array:
        return top(facing(lever, gap, sign, per_lever).T)

    return edge(1.0) if analysis == "no_load" else -edge(-1.0) - edge(1.0)
