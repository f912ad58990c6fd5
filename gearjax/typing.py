"""Array types used in signatures: shapes are written by name, e.g. ``Float[Array, " contact"]``."""

from typing import TYPE_CHECKING, Any

from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float, Int

Scalar = Float[Array, ""]

if TYPE_CHECKING:  # for a type checker, a constructor accepts anything that the field's converter accepts
    Number = Any
else:
    Number = Float[Array, "..."]

__all__ = ["Array", "ArrayLike", "Bool", "Complex", "Float", "Int", "Number", "Scalar"]
