"""Which results of a program depend on its argument, found in the program itself (its jaxpr), and how they change."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
from jax.extend.core import Jaxpr, Literal

CALLS = "jit", "pjit"  # the name of the primitive depends on the version of jax


def depends(function: Callable[[Any], Any], argument: Any) -> list[bool]:
    """For each result of a function, a leaf of its output tree, whether it depends on the argument."""
    program = jax.make_jaxpr(function)(argument).jaxpr
    return _touched(program, [True] * len(program.invars))


def changes(function: Callable[[Any], Any], argument: Any, moves: Any) -> tuple[Any, Any]:
    """Results of a function of a tree, and their changes as its leaves move.

    Args:
        function: the function.
        argument: its argument.
        moves: tangent of each leaf; ``None`` for leaves that do not move, as in a rule of `equinox.filter_custom_jvp`.
    """
    is_moved = jax.tree.map(lambda move: move is not None, moves, is_leaf=lambda move: move is None)
    moving, still = eqx.partition(argument, is_moved)
    return jax.jvp(lambda moving: function(eqx.combine(moving, still)), (moving,), (moves,))


def moved(function: Callable[[Any], Any], argument: Any, moves: Any) -> tuple[Any, Any]:
    """As `changes`, with ``None`` for the change of each result that no moving leaf touches."""
    is_moved = jax.tree.map(lambda move: move is not None, moves, is_leaf=lambda move: move is None)
    moving, still = eqx.partition(argument, is_moved)
    results, along = changes(function, argument, moves)
    touched = depends(lambda moving: function(eqx.combine(moving, still)), moving)
    leaves, tree = jax.tree.flatten(along)
    return results, jax.tree.unflatten(tree, [leaf if own else None for leaf, own in zip(leaves, touched, strict=True)])


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
