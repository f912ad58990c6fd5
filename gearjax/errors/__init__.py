"""Errors of the bodies. Each error adds to the gaps of the contacts."""

from gearjax.errors.base import AbstractError
from gearjax.errors.eccentricity import Eccentricity
from gearjax.errors.helix import Crowning, EndRelief, HelixSlope
from gearjax.errors.measured import AbstractMeasured, MeasuredFlank, MeasuredPitch
from gearjax.errors.profile import AbstractRelief, ProfileForm, ProfileSlope, RootRelief, TipRelief
from gearjax.errors.rim import CumulativePitch, Positions, Sizes

ERRORS: tuple[type[AbstractError], ...] = (
    Eccentricity,
    Positions,
    Sizes,
    CumulativePitch,
    TipRelief,
    ProfileSlope,
    ProfileForm,
    RootRelief,
    HelixSlope,
    Crowning,
    EndRelief,
    MeasuredFlank,
    MeasuredPitch,
)

__all__ = [
    "ERRORS",
    "AbstractError",
    "AbstractMeasured",
    "AbstractRelief",
    "Crowning",
    "CumulativePitch",
    "Eccentricity",
    "EndRelief",
    "HelixSlope",
    "MeasuredFlank",
    "MeasuredPitch",
    "Positions",
    "ProfileForm",
    "ProfileSlope",
    "RootRelief",
    "Sizes",
    "TipRelief",
]
