"""Objectives of a study: one number of a scene."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from gearjax.analysis import backlash, transmission_error
from gearjax.analysis.quasi_static import Backlash, TransmissionError
from gearjax.checks import ParameterError, nearest
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Float, Scalar

METRICS = ("amplitude", "peak_to_peak", "std")
SAMPLES = 8001  # of one cycle, where nothing else is said
ANALYSES = ("no_load", "static", "backlash")


class Objective(eqx.Module):
    """A metric of one analysis over a window of input angles, or a function of the scene.

    Args:
        name: ``no_load_amplitude``, ``static_peak_to_peak``, ``backlash_std`` and so on, or that of the function.
        theta: input angles, shape (n,) [rad].
        torque: load torque of a static objective [N m].
        function: in place of the named metric, ``function(scene) -> number``.
    """

    name: str = eqx.field(static=True)
    theta: Float[Array, " n"]
    torque: float | None = eqx.field(static=True, default=None)
    function: Callable[[Scene], Scalar] | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        names = [f"{analysis}_{metric}" for analysis in ANALYSES for metric in METRICS]
        if self.function is None and self.name not in names:
            raise ParameterError("objective", self.name, nearest(self.name, names))
        if self.function is None and self.name.startswith("static") and self.torque is None:
            raise ParameterError("objective", self.name, "needs a torque")

    @classmethod
    def of(
        cls,
        loss: "str | Callable[[Scene], Scalar] | Objective",
        scene: Scene,
        theta: ArrayLike | None,
        torque: float | None,
    ) -> "Objective":
        """An objective from its name or from a function, over the given angles, the scene's run, or one cycle."""
        if isinstance(loss, Objective):
            return loss
        if theta is None and scene.run is not None:
            theta = scene.system.input_speed * jnp.linspace(0.0, scene.run.duration, scene.run.samples)
        elif theta is None:
            theta = jnp.linspace(0.0, scene.system.cycle, SAMPLES)
        angles = jnp.asarray(theta, scene.dtype)
        if isinstance(loss, str):
            return cls(loss, angles, torque)
        return cls(getattr(loss, "__name__", "function"), angles, torque, loss)

    @property
    def metric(self) -> str:
        """Its metric."""
        return self.name.removeprefix("no_load_").removeprefix("static_").removeprefix("backlash_")

    def result(self, scene: Scene) -> TransmissionError | Backlash:
        """The analysis that it measures."""
        if self.name.startswith("backlash"):
            return backlash(scene, self.theta)
        return transmission_error(scene, self.theta, self.torque if self.name.startswith("static") else None)

    def hard(self, scene: Scene) -> Scalar:
        """The objective, extremes between samples included, by the scene's own contact law."""
        return self.function(scene) if self.function is not None else getattr(self.result(scene), self.metric)
