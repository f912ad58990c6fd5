"""gearjax: differentiable gear dynamics in JAX. Transmission error without load, under load and in motion."""

from gearjax import units
from gearjax.analysis import (
    AdaptiveStep,
    ExponentialFit,
    ExponentialFitMany,
    FixedStep,
    Motion,
    Periodic,
    QuasiStatic,
    RungeKutta4,
    Sweep,
    Windows,
    backlash,
    growth_rate,
    harmonic_balance,
    order_spectrum,
    shooting,
    simulate,
    speed_sweep,
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
    "ExponentialFitMany",
    "FixedStep",
    "GearjaxError",
    "GridSearch",
    "HardContact",
    "HarmonicStiffness",
    "InitialBacklash",
    "LocalSensitivity",
    "Minimisation",
    "Motion",
    "Objective",
    "ParameterError",
    "Periodic",
    "QuadraticContact",
    "QuasiStatic",
    "Run",
    "RungeKutta4",
    "Scene",
    "SceneError",
    "SinusoidalLoad",
    "SoftplusContact",
    "Sweep",
    "Term",
    "TwoKV",
    "Windows",
    "ZeroAtStart",
    "backlash",
    "grid_search",
    "growth_rate",
    "harmonic_balance",
    "load",
    "loads",
    "local_sensitivity",
    "minimise",
    "order_spectrum",
    "shooting",
    "simulate",
    "speed_sweep",
    "transmission_error",
    "units",
]
