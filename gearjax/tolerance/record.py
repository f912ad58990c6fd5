"""Metrics of one curve of one gear set, each computed only if it is asked for."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from gearjax.analysis.metrics import deviation
from gearjax.typing import Array, Float, Int, Scalar


class Record(NamedTuple):
    """The metrics of one analysis of one gear set."""

    metrics: dict[str, Callable[[], Scalar]]
    code: Int[Array, ""]


def of_curve(
    values: Float[Array, " n"], high: Callable[[], Scalar], low: Callable[[], Scalar]
) -> dict[str, Callable[[], Scalar]]:
    """Metrics from the samples of a curve, and its extremes."""
    return {
        "maximum": high,
        "minimum": low,
        "peak_to_peak": lambda: high() - low(),
        "amplitude": lambda: jnp.maximum(high(), -low()),
        "mean": lambda: values.mean(),
        "std": lambda: deviation(values),
    }


def lost(values: Float[Array, " n"], analysis: str) -> Array:
    """Whether no flank can carry the torque; all values are nan then."""
    return jnp.isnan(values[0]) if analysis == "static" else jnp.zeros((), bool)


def coded(measured: Sequence[Scalar], codes: Sequence[Array]) -> tuple[Float[Array, " measure"], Int[Array, ""]]:
    """Measures, nan where they failed, and the result code of the gear set (`gearjax.tolerance.measures.CODES`)."""
    values, code = jnp.stack(list(measured)), jnp.stack(list(codes))
    code = jnp.where((code == 0) & ~jnp.isfinite(values), 2, code)
    return jnp.where(code == 0, values, jnp.nan), code.max()
