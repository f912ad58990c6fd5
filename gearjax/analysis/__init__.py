"""Analyses of a scene: quasi-static, dynamic, their metrics and order spectra."""

from gearjax.analysis.dynamics import simulate
from gearjax.analysis.fitted import ExponentialFit
from gearjax.analysis.follow import QuasiStatic
from gearjax.analysis.motion import Motion
from gearjax.analysis.quasi_static import Backlash, TransmissionError, backlash, transmission_error
from gearjax.analysis.solvers import AdaptiveStep, FixedStep, RungeKutta4, Windows
from gearjax.analysis.spectrum import Spectrum, order_spectrum

__all__ = [
    "AdaptiveStep",
    "Backlash",
    "ExponentialFit",
    "FixedStep",
    "Motion",
    "QuasiStatic",
    "RungeKutta4",
    "Spectrum",
    "TransmissionError",
    "Windows",
    "backlash",
    "order_spectrum",
    "simulate",
    "transmission_error",
]
