"""Terms of an objective: one metric of one analysis each, by name."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

from gearjax import units
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.quasi_static import no_load, play, static
from gearjax.arguments import numbers, one_positive, torque
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.parameters import as_leaf
from gearjax.run import ANALYSES
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Float, Scalar
from gearjax.units import Dimension, arcmin

ANGLE, SHARE = units.ANGLE._replace(shown="arcmin", per_shown=arcmin), units.RATIO._replace(shown="-")
METRICS = ("amplitude", "peak_to_peak", "std", "order")
NAMES = (*(f"{analysis}_{metric}" for analysis in ANALYSES for metric in METRICS), "backlash_range")
SHARES = ("static_load_sharing",)
"""Terms without dimension; those of `NAMES` are angles."""
SLOTS = {
    "no_load": (),
    "static": ("backlash", "compliance"),
    "backlash": ("backlash",),
    "dynamic": MODELLED,
}


class Term(eqx.Module):
    """One metric of one analysis.

    Args:
        name: analysis and metric: ``no_load``, ``static``, ``backlash`` or ``dynamic``, then ``_amplitude`` (largest
            absolute value; Wang et al. 2020, eq. 21), ``_peak_to_peak``, ``_std`` or ``_order`` (amplitude of one
            order). ``static_load_sharing`` is the largest load of a pair over all angles, divided by the mean load of
            the pairs that could carry [-].
        torque: load torque of a static or dynamic term [N m].
        weight: weight of the term in a sum.
        order: order of an ``_order`` term: a name of ``system.orders`` such as ``"crank"``, or cycles per turn of the
            output.

    Raises:
        ParameterError: a name is unknown, or a torque or an order is missing.
    """

    name: str = eqx.field(static=True)
    torque: Float[Array, ""] | None = eqx.field(default=None, converter=lambda x: None if x is None else as_leaf(x))
    weight: Float[Array, ""] = eqx.field(default=1.0, converter=as_leaf)
    order: str | float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.name not in (*NAMES, *SHARES):
            raise ParameterError("objective", self.name, nearest(self.name, (*NAMES, *SHARES)))
        if self.analysis in ("static", "dynamic") and self.torque is None:
            raise ParameterError("objective", self.name, "needs a torque")
        if self.analysis in ("no_load", "backlash") and self.torque is not None:
            raise ParameterError("objective", self.name, "takes no torque")
        if is_concrete(self.weight) and not (self.weight.ndim or float(self.weight) > 0):
            raise ParameterError("weight", float(self.weight), "must be above 0")
        if self.metric != "order" and self.order is not None:
            raise ParameterError("objective", self.name, f"takes no order; {self.analysis}_order has one")
        if self.metric == "order" and self.order is None:
            raise ParameterError("objective", self.name, 'needs an order, such as order = "crank"')
        for name, check in (("torque", torque), ("weight", numbers)):
            if getattr(self, name) is not None:
                check(name, getattr(self, name))
        if self.order is not None and not isinstance(self.order, str):
            one_positive("order", self.order)

    @property
    def analysis(self) -> str:
        """Name of the analysis."""
        return next(analysis for analysis in ANALYSES if self.name.startswith(analysis))

    @property
    def metric(self) -> str:
        """Name of the metric; the range of the backlash is its peak-to-peak."""
        return self.name.removeprefix(f"{self.analysis}_").replace("range", "peak_to_peak")

    @property
    def dimension(self) -> Dimension:
        """Dimension of the metric, with the unit in which it is shown."""
        return SHARE if self.name in SHARES else ANGLE

    def per_turn(self, scene: Scene) -> float:
        """The order in cycles per turn of the input."""
        orders = scene.system.orders
        if isinstance(self.order, str) and self.order not in orders:
            raise ParameterError("order", self.order, nearest(self.order, orders))
        assert self.order is not None
        return orders[self.order] if isinstance(self.order, str) else self.order * orders["output"]

    def require_resolved(self, scene: Scene, theta: ArrayLike) -> None:
        """Refuse an order that the input angles do not resolve: fewer than two angles in one of its cycles.

        Raises:
            ParameterError: names the highest order that is resolved.
        """
        order = self.per_turn(scene)
        if not is_concrete(theta):
            return
        widest = float(np.diff(np.asarray(theta, dtype=float)).max(initial=0.0))
        if order * widest > np.pi:
            highest = np.pi / widest / scene.system.orders["output"]
            words = f"there are too few input angles: they resolve at most {highest:.6g} cycles per turn of the output"
            raise ParameterError("order", self.order, words)

    def curve(self, scene: Scene) -> tuple[Callable[[Any, Any], Scalar], Any]:
        """The curve as a function of its arguments and the input angle or pose, and these arguments; not if dynamic."""
        if self.analysis == "no_load":
            return no_load, scene
        return (play, scene) if self.analysis == "backlash" else (static, (scene, self.torque))
