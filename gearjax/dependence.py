"""Which results of a program depend on its argument, found in the program itself (its jaxpr)."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.extend.core import Jaxpr, Literal

CALLS = "jit", "pjit"  # the name of the primitive depends on the version of jax


def depends(function: Callable[[Any], Any], argument: Any) -> list[bool]:
    """For each result of a function, a leaf of its output tree, whether it depends on the argument."""
    program = jax.make_jaxpr(function)(argument).jaxpr
    return _touched(program, [True] * len(program.invars))


def _touched(program: Jaxpr, given: Sequence[bool]) -> list[bool]:
    """For each result of a program, whether it depends on one of the arguments that ``given`` marks."""
    touched = {variable for variable, own in zip(program.invars, given, strict=True) if own}

    def depending(atoms: Sequence[Any]) -> list[bool]:
        return [not isinstance(atom, Literal) and atom in touched for atom in atoms]

    for equation in program.eqns:
        own = depending(equation.invars)
        inner = equation.params.get("jaxpr") if equation.primitive.name in CALLS else None
        out = [any(own)] * len(equation.outvars) if inner is None else _touched(inner.jaxpr, own)
        touched |= {variable for variable, moved in zip(equation.outvars, out, strict=True) if moved}
    return depending(program.outvars)
