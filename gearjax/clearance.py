"""Reference of the gaps: initial backlash, and the zero of the errors."""

import equinox as eqx

from gearjax.parameters import check_parameters, length
from gearjax.typing import Array, Float, Number


class InitialBacklash(eqx.Module):
    """Backlash of each pair before the errors change it, ``B_i(0)`` of Wang et al. (2020), eq. 7.

    If the reference counts errors from input angle zero, it is the backlash of each pair at that angle. Otherwise it is
    the backlash of a pair without errors.

    Args:
        initial: backlash along the line of action, for helical teeth along the normal of the flanks [m].
    """

    initial: Number = length(at_least=0.0, at_most=1.0, example="0.15 mm")

    def __check_init__(self):
        check_parameters(self)


class ZeroAtStart(eqx.Module):
    """Errors count from their values at input angle zero, as if every pair just touched at that angle
    (the t0 terms of Wang et al. 2020, eqs. 1-4)."""


class Anchor(eqx.Module):
    """`ZeroAtStart` whose values at input angle zero are stored, so that they are computed only once.

    Args:
        gap: contribution of the errors to the gaps at input angle zero, shape (contact,) [m].
    """

    gap: Float[Array, " contact"]
