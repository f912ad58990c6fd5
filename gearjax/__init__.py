"""gearjax: differentiable gear dynamics in JAX. Transmission error without load, under load and in motion."""

from gearjax import units
from gearjax.analysis import (
    AdaptiveStep,
    ExponentialFit,
    FixedStep,
    QuasiStatic,
    RungeKutta4,
    Windows,
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
    "ExponentialFit",
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
    "QuasiStatic",
    "Run",
    "RungeKutta4",
    "Scene",
    "SceneError",
    "SinusoidalLoad",
    "SoftplusContact",
    "Term",
    "TwoKV",
    "Windows",
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
