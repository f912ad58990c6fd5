"""Errors of the bodies: each adds to the gaps of the contacts."""

from gearjax.errors.base import AbstractError
from gearjax.errors.eccentricity import Eccentricity

ERRORS: tuple[type[AbstractError], ...] = (Eccentricity,)

__all__ = ["ERRORS", "AbstractError", "Eccentricity"]
