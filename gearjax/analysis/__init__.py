"""Analyses of a scene: quasi-static, dynamic, their metrics and order spectra."""

from gearjax.analysis.dynamics import growth_rate, simulate
from gearjax.analysis.fitted import ExponentialFit
from gearjax.analysis.fitted_many import ExponentialFitMany
from gearjax.analysis.follow import QuasiStatic
from gearjax.analysis.motion import Motion
from gearjax.analysis.periodic import Periodic, Sweep, harmonic_balance, shooting, speed_sweep
from gearjax.analysis.quasi_static import Backlash, TransmissionError, backlash, transmission_error
from gearjax.analysis.solvers import AdaptiveStep, FixedStep, RungeKutta4, Windows
from gearjax.analysis.spectrum import Spectrum, order_spectrum

__all__ = [
    "AdaptiveStep",
    "Backlash",
    "ExponentialFit",
    "ExponentialFitMany",
    "FixedStep",
    "Motion",
    "Periodic",
    "QuasiStatic",
    "RungeKutta4",
    "Spectrum",
    "Sweep",
    "TransmissionError",
    "Windows",
    "backlash",
    "growth_rate",
    "harmonic_balance",
    "order_spectrum",
    "shooting",
    "simulate",
    "speed_sweep",
    "transmission_error",
]
