"""What a program depends on, from the program itself."""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import Literal


def depends(function: Callable[[Any], Any], argument: Any) -> list[bool]:
    """Which results of a function, the leaves of a tree, depend on its argument."""
    program = jax.make_jaxpr(function)(argument).jaxpr
    touched = set(program.invars)
    for equation in program.eqns:
        if any(not isinstance(atom, Literal) and atom in touched for atom in equation.invars):
            touched |= set(equation.outvars)
    return [not isinstance(atom, Literal) and atom in touched for atom in program.outvars]
