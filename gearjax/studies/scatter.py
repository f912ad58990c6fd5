"""Gear sets as they are made: deviations of numbers under which a study takes the mean of its objective."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.scene import Scene
from gearjax.studies.select import Free
from gearjax.typing import Array, Float, Scalar


class Scatter(eqx.Module):
    """Numbers of gear sets that were drawn from a population; `gearjax.Tolerances.scatter` draws them.

    Args:
        free: the toleranced numbers.
        values: the number of each gear set, shape (gear set, number), SI; for numbers in ``around`` their deviation.
        around: of each number, whether its deviation is added to that of the scene, instead of replacing it.
    """

    free: Free
    values: Float[Array, "drawn number"]
    around: tuple[bool, ...] = eqx.field(static=True)

    def mean(self, of: Callable[[Scene], Scalar], scene: Scene) -> Scalar:
        """Mean of a function of the scene over the gear sets."""
        own = jnp.where(jnp.array(self.around), self.free.get(scene), 0.0)
        each = jax.vmap(lambda values: of(self.free.set(scene, own + values.astype(own.dtype))))(self.values)
        return each.mean()
