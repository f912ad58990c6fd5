"""Radii of curvature in the line contact of a pin and a flank."""

from typing import NamedTuple

from gearjax.typing import Array, Float


class Radii(NamedTuple):
    """Radii of curvature of pins and flanks at their contacts.

    Args:
        pin: radius of the pins, shape (contact,) [m].
        curvature: curvature of the flanks, positive on convex flanks, shape (contact,) [1/m].
    """

    pin: Float[Array, " contact"]
    curvature: Float[Array, " contact"]

    @property
    def relative(self) -> Float[Array, " contact"]:
        """Relative radius of curvature R, ``1 / R = 1 / r + curvature`` [m]."""
        return self.pin / (1 + self.pin * self.curvature)

    @property
    def centre_curvature(self) -> Float[Array, " contact"]:
        """Curvature of the curve that the pin's centre follows, ``1 / (rho + r)`` [1/m]."""
        return self.curvature / (1 + self.pin * self.curvature)
