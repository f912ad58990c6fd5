"""Samples of all numbers that explain the recordings: they show where the intervals of least squares are wrong.

Least squares gives a normal distribution of the numbers, called the ellipse below.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import GearjaxError, MissingExtraError
from gearjax.identification.found import Identification
from gearjax.identification.moving import MovingModel
from gearjax.identification.tables import AbstractCurves
from gearjax.progress import Progress, silent
from gearjax.typing import Array, Float
from gearjax.units import arcmin

CHAINS, DRAWS, WARM_UP = 4, 1000, 200
STEP = 0.7  # first step size of the sampler, in standard deviations of the ellipse
TARGET = 0.7  # acceptance rate that the step size is adapted to
TOLD_BY = 0.5  # standard deviations of the ellipse by which means may differ before it is reported
WIDER = 1.3  # ratio of the standard deviations above which it is reported


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of the numbers that explain recordings.

    Args:
        names: names of the numbers, as in `Identification.estimates`.
        units: units of the numbers.
        draws: drawn numbers, shape (chain, draw, number).
        ellipse: means and standard deviations of the same numbers by least squares, shape (number,) each.
        scale_reduction: potential scale reduction of each number, near 1 if the chains agree (Gelman and Rubin 1992),
            shape (number,).
        effective: number of independent draws that would be as good, shape (number,).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Float[np.ndarray, "chain draw number"]
    ellipse: tuple[np.ndarray, np.ndarray]
    scale_reduction: np.ndarray
    effective: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean of each number, shape (number,)."""
        return self.draws.mean(axis=(0, 1))

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each number, shape (number,)."""
        return self.draws.std(axis=(0, 1))

    @property
    def interval(self) -> np.ndarray:
        """95 % interval of each number, shape (2, number)."""
        return np.quantile(self.draws, [0.025, 0.975], axis=(0, 1))

    @property
    def differs(self) -> list[str]:
        """Numbers whose draws differ from the ellipse of least squares, in words."""
        mean, spread = self.ellipse
        words = []
        for i, name in enumerate(self.names):
            away, wider = abs(self.mean[i] - mean[i]) / spread[i], self.std[i] / spread[i]
            if away > TOLD_BY or not 1 / WIDER < wider < WIDER:
                words.append(
                    f"{name}: {wider:.2f} times the width of least squares, mean shifted by {away:.2f} standard errors"
                )
        return words


@arguments.checked(
    found=arguments.an(Identification, "must be a result of gj.identify(...)"),
    chains=arguments.whole(1),
    draws=arguments.whole(2),
    warm_up=arguments.whole(10),
    key=arguments.whole(0),
)
def posterior(
    found: Identification,
    *,
    chains: int = CHAINS,
    draws: int = DRAWS,
    warm_up: int = WARM_UP,
    key: int = 0,
    progress: Progress = silent,
) -> Posterior:
    """Draw numbers that explain recordings, by the no-U-turn sampler (Hoffman and Gelman 2014) of blackjax.

    The noise is that of the fit, its variance increased for the correlation from row to row. Numbers that the
    recordings hide are limited by their priors (``priors`` of `identify`), or else to vectors as large as those found.
    The chains stay near the solution that is shown; `Identification.alternatives` lists other solutions.

    Args:
        found: result of `identify`.
        chains, draws, warm_up: number of chains, of draws per chain, and of earlier draws that are not kept.
        key: seed of the draws.
        progress: called with a line of text now and then.

    Raises:
        GearjaxError: the recordings were identified in motion.
        MissingExtraError: blackjax is not installed (``pip install gearjax[bayes]``).

    Example:
        >>> import gearjax as gj, dataclasses
        >>> scene = dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml"), reference=None)
        >>> run = gj.synthetic_measurement(scene, 40.0, rows=300)
        >>> found = gj.identify(scene, run, ["errors.output_wheel"], starts=4, suggest=False)
        >>> gj.posterior(found, chains=2, draws=20, warm_up=20).draws.shape
        (2, 20, 3)
    """
    if isinstance(found.model, MovingModel):
        raise GearjaxError(
            "posterior: draws of recordings in motion would take hours: use the intervals of gj.identify"
        )
    try:
        import blackjax
        from blackjax.diagnostics import effective_sample_size, potential_scale_reduction
    except ImportError as fault:
        raise MissingExtraError("a posterior needs blackjax: python -m pip install gearjax[bayes]") from fault
    centre, root = found.gaussian(found.visible.inflation)
    problem = found.fit.problem
    rows = problem.padded
    weight = np.concatenate([found.fit.weight, np.zeros(rows.theta.size - found.fit.weight.size)])
    mean, extra = found.held()
    own = found.fit.known.precision / found.fit.sigma**2
    precision = own + extra
    known = precision > 0
    pulled = own * found.fit.known.mean + extra * mean
    mean = np.where(known, pulled / np.where(known, precision, 1.0), 0.0)
    variance = found.fit.sigma**2 * found.visible.inflation
    density = _Density(
        problem.model, *map(jnp.asarray, (rows.te, weight / variance, rows.basis, mean, precision, centre, root))
    )
    progress(f"sampling {chains} chains of {warm_up} + {draws} draws")
    keys = jax.random.split(jax.random.key(key), chains)
    starts = 0.5 * jax.random.normal(jax.random.key(key + 1), (chains, centre.size))
    whitened = _sampled(blackjax, density, keys, starts, warm_up, draws)
    values = centre + np.asarray(whitened) @ root.T
    shown = found.shown(values)
    spread = np.sqrt(np.diag(root @ root.T))
    off = np.abs(found.shown(centre + spread) - found.shown(centre - spread)) / 2
    reduction = np.asarray(potential_scale_reduction(shown)) if chains > 1 else np.ones(centre.size)
    effective = np.asarray(effective_sample_size(shown)) if chains > 1 else np.full(centre.size, float(draws))
    units = tuple(each.unit for each in found.estimates)
    return Posterior(found.names, units, shown, (found.shown(centre), off), reduction, effective)


class _Density(eqx.Module):
    """Logarithm of the probability density of the numbers, by their position in the ellipse of least squares."""

    model: AbstractCurves
    te: Array
    weight: Array  # divided by the variance of a row
    basis: Array
    mean: Array
    precision: Array
    centre: Array
    root: Array

    def parts(self, place: Array) -> tuple[Array, Array]:
        """The logarithm and its gradient."""
        values = self.centre + self.root @ place
        size = values.shape[0] - self.basis.shape[1]
        q, rate = self.model.positions(values[None, :size])
        left = self.te - q[0] / arcmin - self.basis @ values[size:]
        left = jnp.where(self.weight > 0, left, 0.0)
        away = self.mean - values
        slope = jnp.concatenate([(self.weight * left) @ rate[0] / arcmin, (self.weight * left) @ self.basis])
        value = -0.5 * ((self.weight * left * left).sum() + (self.precision * away * away).sum())
        return value, self.root.T @ (slope + self.precision * away)


@eqx.filter_jit
def _sampled(blackjax: Any, density: _Density, keys: Array, starts: Array, warm_up: int, draws: int) -> Array:
    """Positions of the draws in the ellipse, shape (chain, draw, number)."""

    @jax.custom_jvp
    def logarithm(place: Array) -> Array:
        return density.parts(place)[0]

    @logarithm.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:  # the model computes its own derivatives
        value, slope = density.parts(primals[0])
        return value, slope @ tangents[0]

    identity = jnp.ones(starts.shape[1], starts.dtype)

    def chain(key: Array, start: Array) -> Array:
        kernel = blackjax.nuts.build_kernel()

        def advance(carry: tuple, key: Array) -> tuple[tuple, Array]:
            state, step, number = carry
            state, told = kernel(key, state, logarithm, jnp.exp(step), identity)
            # the step size is adapted during warm-up (Robbins and Monro 1951)
            gain = jnp.where(number < warm_up, 2.0 / (number + 10.0) ** 0.75, 0.0)
            step = step + gain * (told.acceptance_rate - TARGET)
            return (state, step, number + 1), state.position

        step, number = jnp.log(jnp.asarray(STEP, start.dtype)), jnp.asarray(0.0, start.dtype)
        first = blackjax.nuts.init(start, logarithm), step, number
        _, places = jax.lax.scan(advance, first, jax.random.split(key, warm_up + draws))
        return places[warm_up:]

    return jax.vmap(chain)(keys, starts)
