"""Programs that run once on known numbers, such as checks of a gear set: quick to compile, and possible in a trace."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.checks import is_concrete

QUICK = (
    {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True},
    {"xla_cpu_use_fusion_emitters": False},
)
"""Options of a program that compiles longer than it runs, each group as far as this version of XLA knows it: it leaves
out the dearest optimisations, and uses the older kernel compiler (`gearjax.xla.QUICK_COMPILER`). With both, compiling
takes a fifth to a third of the time."""


def evaluated(function: Callable[..., Any], *arguments: Any) -> Any:
    """Result of a function on known numbers, by one program, as numbers also inside the trace of something else.

    Without a program each single operation would be compiled, and so would be each operation on constants under
    `jax.ensure_compile_time_eval`.

    Args:
        function: a pure function, defined once: its program is kept.
        arguments: its arguments, arrays without tracers and anything static.
    """
    return _program(function).lower(*arguments).compile()(*arguments)


def evaluated_once(function: Callable[..., Any], *arguments: Any) -> Any:
    """As `evaluated`, but the results of the last arguments are kept; in the trace of something else a part of it.

    Arguments are the same if their arrays, which JAX does not change, are the same objects.
    """
    numbers, structure = jax.tree.flatten(arguments)
    if not is_concrete((numbers, jnp.zeros(()))):  # in a trace a new zero is a tracer
        return function(*arguments)
    if not all(isinstance(number, jax.Array) for number in numbers):
        return _program(function)(*arguments)
    key = function, structure, tuple(map(id, numbers))
    kept = _results.get(key)
    if kept is None:
        kept = numbers, _program(function)(*arguments)
        while len(_results) >= MOST_KEPT:
            _results.pop(next(iter(_results)), None)
        _results[key] = kept
    return kept[1]


MOST_KEPT = 16
_results: dict[Any, tuple[list[Any], Any]] = {}  # with the arguments, so that no other array has the identity of one


@functools.cache
def _program(function: Callable[..., Any]) -> Any:
    options: dict[str, Any] = {"compiler_options": _known_options()}
    return eqx.filter_jit(function, **options)


@functools.cache
def _known_options() -> dict[str, Any]:
    known: dict[str, Any] = {}
    for options in QUICK:
        try:
            jax.jit(lambda: 0.0, compiler_options=known | options).lower().compile()
        except Exception:  # which one depends on the version of jax: an option that XLA does not know
            continue
        known |= options
    return known
