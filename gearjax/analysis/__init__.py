"""Analyses of a scene: quasi-static, dynamic, their metrics and order spectra."""

from gearjax.analysis.dynamics import simulate
from gearjax.analysis.motion import Motion
from gearjax.analysis.quasi_static import Backlash, TransmissionError, backlash, transmission_error
from gearjax.analysis.solvers import AdaptiveStep, FixedStep
from gearjax.analysis.spectrum import Spectrum, order_spectrum

__all__ = [
    "AdaptiveStep",
    "Backlash",
    "FixedStep",
    "Motion",
    "Spectrum",
    "TransmissionError",
    "backlash",
    "order_spectrum",
    "simulate",
    "transmission_error",
]
