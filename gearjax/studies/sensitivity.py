"""Local sensitivity of an optimum: slopes, flat directions, and the rise of the objective by assembly errors."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError
from gearjax.scene import Scene
from gearjax.studies.minimax import least_slope
from gearjax.studies.objective import Objective
from gearjax.studies.select import Bounds, Free, Where, pick
from gearjax.studies.terms import Term
from gearjax.studies.values import values
from gearjax.typing import Array, ArrayLike, Float, Scalar
from gearjax.units import deg

SAMPLES = 24  # per turn of the fastest error
TEMPERATURE = 0.01  # share of the objective at which slopes and curvatures are taken
SMALLEST = 1e-300  # objective that rises are divided by
FLAT = 0.01  # share by which the objective rises at most in a step along a flat direction
FLAT_STEP = 10 * deg
MOST_CORNERS = 1024


class LocalSensitivity(eqx.Module):
    """Change of an objective around a point. Angles count in radians, other numbers in spans of their bounds.

    Args:
        paths: the free numbers.
        angles: whether each number is an angle.
        point: values of the numbers at the point, shape (free,), SI.
        objective: the objective at the point.
        gradient: gradient of the hard objective; at a kink its shortest subgradient, which is zero at an optimum, shape
            (free,).
        temperature: temperature of the smoothed objective whose Hessian is given [rad].
        eigenvalues: eigenvalues of the Hessian, smallest first, shape (free,).
        directions: eigenvectors of the Hessian, one row each, shape (free, free).
        rises: share by which the hard objective rises over 10 degrees (or 0.17 spans) along each direction, the larger
            rise of both senses, shape (free,).
        deviations: assembly errors, shape (m,) [rad or spans].
        single: objective with each number off by plus and minus each deviation, shape (m, free, 2).
        worst: highest objective over all combinations of plus, minus and no deviation, shape (m,).
        mean: mean objective over these combinations, shape (m,).
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    angles: tuple[bool, ...] = eqx.field(static=True)
    point: np.ndarray
    objective: float
    gradient: np.ndarray
    temperature: float
    eigenvalues: np.ndarray
    directions: np.ndarray
    rises: np.ndarray
    deviations: np.ndarray
    single: np.ndarray
    worst: np.ndarray
    mean: np.ndarray

    @property
    def flat(self) -> np.ndarray:
        """Whether each direction is flat: the objective rises by less than 1 % along it, shape (free,)."""
        return self.rises < FLAT

    def told(self, deviation: float) -> str:
        """A deviation [rad or spans] in words, such as ``5 deg``, or ``8.7 % of the span between the bounds``."""
        angle, share = f"{deviation / deg:g} deg", f"{100 * deviation:.2g} % of the span between the bounds"
        if all(self.angles):
            return angle
        return f"{angle}, or {share}" if any(self.angles) else share


@arguments.checked()
def local_sensitivity(
    loss: str | Callable[[Scene], Any] | Term | Sequence[Term] | Objective,
    scene: Scene,
    *,
    where: Where,
    at: ArrayLike | Sequence[float] | None = None,
    theta: ArrayLike | None = None,
    torque: float | None = None,
    bounds: Bounds | None = None,
    deviations: Sequence[float] = (5 * deg, 10 * deg),
) -> LocalSensitivity:
    """Gradient, curvature and flat directions of an objective at a point, and its rise by deviations from the point.

    The Hessian is that of the smoothed objective (`gearjax.studies.objective`) at a temperature of 1 % of the
    objective; everything else is evaluated with the hard contact law.

    Args:
        loss, scene, where, theta, torque, bounds: as in `gearjax.minimise`.
        at: the point, shape (free,), SI; by default the scene's own numbers.
        deviations: assembly errors of angles [rad]; of other numbers, in spans of their bounds.

    Raises:
        ParameterError: a path, a bound or the point is wrong.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> paths = ["errors.planet_1.phase", "errors.planet_2.phase"]
        >>> around = gj.local_sensitivity("no_load_std", scene, where=paths)
        >>> around.worst.shape, bool((around.worst >= around.objective).all())
        ((2,), True)
    """
    objective = Objective.of(loss, scene, theta, torque)
    free = pick(scene, where, bounds)
    free.require_bounds()
    point = np.asarray(free.get(scene) if at is None else at, dtype=float)
    if point.shape != (len(free.paths),) or not np.isfinite(point).all():
        raise ParameterError("at", point.shape, f"must be {len(free.paths)} finite numbers")
    coarse = objective.coarse(scene, SAMPLES).tabulated(scene, free)
    evaluate = values(coarse, scene, free, "refined")
    here = float(evaluate(point[None])[0])
    temperature = max(TEMPERATURE * abs(here), 1e-12)
    gradient, hessian = _curvature(
        coarse,
        objective.physics(scene, free),
        free,
        jnp.asarray(point, objective.theta.dtype),
        jnp.asarray(temperature, objective.theta.dtype),
    )
    eigenvalues, vectors = np.linalg.eigh(np.asarray(hessian))
    directions = vectors.T
    steps = [FLAT_STEP * np.stack([directions, -directions]).reshape(-1, len(point))]
    size, signs = len(point), _signs(len(point))
    for deviation in deviations:
        steps += [deviation * np.concatenate([np.eye(size), -np.eye(size)]), deviation * signs]
    objectives = evaluate(free.wrapped(point + np.concatenate(steps) * free.scales))
    along, rest = objectives[: 2 * size], objectives[2 * size :].reshape(len(deviations), -1)
    single = rest[:, : 2 * size].reshape(-1, 2, size).swapaxes(1, 2)
    all_of_them = np.concatenate([rest, np.full((len(deviations), 1), here)], axis=1)
    return LocalSensitivity(
        paths=free.paths,
        angles=tuple(free.periodic.tolist()),
        point=point,
        objective=here,
        temperature=temperature,
        gradient=np.asarray(gradient),
        eigenvalues=eigenvalues,
        directions=directions,
        rises=(along.reshape(2, -1).max(axis=0) - here) / max(abs(here), SMALLEST),
        deviations=np.asarray(deviations, dtype=float),
        single=single,
        worst=all_of_them.max(axis=1),
        mean=np.concatenate([rest[:, 2 * size :], np.full((len(deviations), 1), here)], axis=1).mean(axis=1),
    )


def _signs(size: int) -> np.ndarray:
    """Combinations of plus, minus and zero, without that of zeros only; random signs if there are too many."""
    if 3**size <= MOST_CORNERS:
        signs = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=size)))
        return signs[np.abs(signs).sum(axis=1) > 0]
    return np.random.default_rng(0).choice([-1.0, 1.0], (MOST_CORNERS, size))


@eqx.filter_jit
def _curvature(
    objective: Objective, physics: Scene, free: Free, point: Float[Array, " free"], temperature: Scalar
) -> tuple[Float[Array, " free"], Float[Array, "free free"]]:
    """Shortest subgradient of the objective, and Hessian of the smoothed objective, in scaled numbers."""
    scales = jnp.asarray(free.scales, point.dtype)

    def smooth(step: Float[Array, " free"]) -> Scalar:
        return objective.smooth(free.set(physics, point + scales * step), temperature)

    zero = jnp.zeros_like(point)
    slope = least_slope(lambda step: objective.pieces(free.set(physics, point + scales * step)), zero)
    # forward over forward, motions compile in two thirds of the time
    return slope, (jax.jacfwd(jax.jacfwd(smooth)) if objective.is_dynamic else jax.hessian(smooth))(zero)
