"""gearjax: differentiable gear dynamics in JAX. Transmission error without load, under load and in motion."""

from gearjax import units
from gearjax.analysis import (
    AdaptiveStep,
    FixedStep,
    backlash,
    order_spectrum,
    simulate,
    transmission_error,
)
from gearjax.checks import GearjaxError, ParameterError, SceneError
from gearjax.clearance import InitialBacklash, ZeroAtStart
from gearjax.compliance import HarmonicStiffness
from gearjax.config import load, loads
from gearjax.contact import HardContact, QuadraticContact, SoftplusContact
from gearjax.errors import Eccentricity
from gearjax.inertia import DampingRatio, EquivalentMass
from gearjax.load import ConstantLoad, SinusoidalLoad
from gearjax.scene import Run, Scene
from gearjax.studies import (
    GridSearch,
    LocalSensitivity,
    Minimisation,
    Objective,
    Term,
    grid_search,
    local_sensitivity,
    minimise,
)
from gearjax.systems import TwoKV

__version__ = "0.1.0"

__all__ = [
    "AdaptiveStep",
    "ConstantLoad",
    "DampingRatio",
    "Eccentricity",
    "EquivalentMass",
    "FixedStep",
    "GearjaxError",
    "GridSearch",
    "HardContact",
    "HarmonicStiffness",
    "InitialBacklash",
    "LocalSensitivity",
    "Minimisation",
    "Objective",
    "ParameterError",
    "QuadraticContact",
    "Run",
    "Scene",
    "SceneError",
    "SinusoidalLoad",
    "SoftplusContact",
    "Term",
    "TwoKV",
    "ZeroAtStart",
    "backlash",
    "grid_search",
    "load",
    "loads",
    "local_sensitivity",
    "minimise",
    "order_spectrum",
    "simulate",
    "transmission_error",
    "units",
]
