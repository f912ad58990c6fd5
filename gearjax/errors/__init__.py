"""Errors of the bodies: each adds to the gaps of the contacts."""

from gearjax.errors.base import AbstractError
from gearjax.errors.eccentricity import Eccentricity
from gearjax.errors.rim import CumulativePitch, Positions, Sizes

ERRORS: tuple[type[AbstractError], ...] = (Eccentricity, Positions, Sizes, CumulativePitch)

__all__ = ["ERRORS", "AbstractError", "CumulativePitch", "Eccentricity", "Positions", "Sizes"]
