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
    `jax.ensure_compile_time_eval`. The results of the last arguments are kept. Arguments are the same if their arrays,
    which JAX does not change, are the same objects.

    Args:
        function: a pure function, defined once: its program is kept.
        arguments: its arguments, arrays without tracers and anything static.
    """
    numbers, structure = jax.tree.flatten(arguments)
    if not all(isinstance(number, jax.Array) for number in numbers):
        return _result(function, arguments)
    key = function, structure, tuple(map(id, numbers))
    kept = _results.get(key)
    if kept is None:
        kept = numbers, _result(function, arguments)
        while len(_results) >= MOST_KEPT:
            _results.pop(next(iter(_results)), None)
        _results[key] = kept
    return kept[1]


def evaluated_or_traced(function: Callable[..., Any], *arguments: Any) -> Any:
    """As `evaluated`, but in the trace of something else, or of its derivative, a part of it."""
    return function(*arguments) if _traced(arguments) else evaluated(function, *arguments)


def _traced(arguments: tuple[Any, ...]) -> bool:
    """Whether arguments are traced, or this is inside the trace of something else: there a new zero is a tracer."""
    return not is_concrete((arguments, jnp.zeros(())))


def _result(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    program = _program(function)
    if _traced(arguments):  # a call would become part of the trace
        program = program.lower(*arguments).compile()
    return program(*arguments)


MOST_KEPT = 16
_results: dict[Any, tuple[list[Any], Any]] = {}  # with the arguments, so that no other array has the identity of one


@functools.cache
def _program(function: Callable[..., Any]) -> Any:
    options: dict[str, Any] = {"compiler_options": accepted(QUICK)}
    return eqx.filter_jit(function, **options)


def accepted(groups: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    """Those options of a single program that this version of XLA knows, of several groups."""
    known: dict[str, Any] = {}
    for options in groups:
        if _is_known(tuple(options.items())):
            known |= options
    return known


@functools.cache
def _is_known(options: tuple[tuple[str, Any], ...]) -> bool:
    try:
        jax.jit(lambda: 0.0, compiler_options=dict(options)).lower().compile()
    except Exception:  # which one depends on the version of jax: an option that XLA does not know
        return False
    return True
