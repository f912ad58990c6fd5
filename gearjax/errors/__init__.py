"""Errors of the bodies: each adds to the gaps of the contacts."""

from gearjax.errors.base import AbstractError
from gearjax.errors.eccentricity import Eccentricity
from gearjax.errors.profile import ProfileForm, ProfileSlope, TipRelief
from gearjax.errors.rim import CumulativePitch, Positions, Sizes

ERRORS: tuple[type[AbstractError], ...] = (
    Eccentricity,
    Positions,
    Sizes,
    CumulativePitch,
    TipRelief,
    ProfileSlope,
    ProfileForm,
)

__all__ = [
    "ERRORS",
    "AbstractError",
    "CumulativePitch",
    "Eccentricity",
    "Positions",
    "ProfileForm",
    "ProfileSlope",
    "Sizes",
    "TipRelief",
]
