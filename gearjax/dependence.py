"""What a program depends on, from the program itself."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.extend.core import Jaxpr, Literal

CALLS = "jit", "pjit"  # by the version of jax


def depends(function: Callable[[Any], Any], argument: Any) -> list[bool]:
    """Which results of a function, the leaves of a tree, depend on its argument."""
    program = jax.make_jaxpr(function)(argument).jaxpr
    return _touched(program, [True] * len(program.invars))


def _touched(program: Jaxpr, given: Sequence[bool]) -> list[bool]:
    """Which results of a program depend on the arguments that are marked."""
    touched = {variable for variable, own in zip(program.invars, given, strict=True) if own}

    def depending(atoms: Sequence[Any]) -> list[bool]:
        return [not isinstance(atom, Literal) and atom in touched for atom in atoms]

    for equation in program.eqns:
        own = depending(equation.invars)
        inner = equation.params.get("jaxpr") if equation.primitive.name in CALLS else None
        out = [any(own)] * len(equation.outvars) if inner is None else _touched(inner.jaxpr, own)
        touched |= {variable for variable, moved in zip(equation.outvars, out, strict=True) if moved}
    return depending(program.outvars)
