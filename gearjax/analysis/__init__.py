"""Analyses of a scene: quasi-static and dynamic analyses, their metrics and order spectra."""

from gearjax.analysis.bearings import BearingForces, bearing_forces
from gearjax.analysis.choice import ChosenSteps
from gearjax.analysis.dynamics import chosen_steps, growth_rate, simulate
from gearjax.analysis.face_load import FaceLoad, face_load
from gearjax.analysis.fast.fitted import ExponentialFit
from gearjax.analysis.follow import QuasiStatic
from gearjax.analysis.fourier_series import fourier_series
from gearjax.analysis.harmonic_balance import harmonic_balance
from gearjax.analysis.meshing_impact import MeshingImpacts, meshing_impact
from gearjax.analysis.metrics import FewAngles
from gearjax.analysis.modes import ExponentialParabola
from gearjax.analysis.motion import Motion
from gearjax.analysis.natural_modes import NaturalModes, natural_modes
from gearjax.analysis.one_contact import Reduction, one_contact
from gearjax.analysis.periodic import Periodic, Sweep, shooting, speed_sweep
from gearjax.analysis.quasi_static import (
    Backlash,
    TransmissionError,
    backlash,
    interference,
    transmission_error,
)
from gearjax.analysis.ratio_error import RatioError, ratio_error, separation_speed
from gearjax.analysis.repeats import periodic_motion
from gearjax.analysis.resting import Interference
from gearjax.analysis.solvers import AdaptiveStep, FixedStep, RungeKutta4, Windows
from gearjax.analysis.spectrum import Spectrum, order_spectrum
from gearjax.analysis.stiffness import MeshStiffness, mesh_stiffness
from gearjax.analysis.torque_sweep import TorqueSweep, UnclosedRecord, torque_sweep
from gearjax.analysis.torsion import LostMotion, Torsion, contact_pressure, lost_motion, torsion
from gearjax.analysis.waterfall import Waterfall, waterfall

__all__ = [
    "AdaptiveStep",
    "Backlash",
    "BearingForces",
    "ChosenSteps",
    "ExponentialFit",
    "ExponentialParabola",
    "FaceLoad",
    "FewAngles",
    "FixedStep",
    "Interference",
    "LostMotion",
    "MeshStiffness",
    "MeshingImpacts",
    "Motion",
    "NaturalModes",
    "Periodic",
    "QuasiStatic",
    "RatioError",
    "Reduction",
    "RungeKutta4",
    "Spectrum",
    "Sweep",
    "TorqueSweep",
    "Torsion",
    "TransmissionError",
    "UnclosedRecord",
    "Waterfall",
    "Windows",
    "backlash",
    "bearing_forces",
    "chosen_steps",
    "contact_pressure",
    "face_load",
    "fourier_series",
    "growth_rate",
    "harmonic_balance",
    "interference",
    "lost_motion",
    "mesh_stiffness",
    "meshing_impact",
    "natural_modes",
    "one_contact",
    "order_spectrum",
    "periodic_motion",
    "ratio_error",
    "separation_speed",
    "shooting",
    "simulate",
    "speed_sweep",
    "torque_sweep",
    "torsion",
    "transmission_error",
    "waterfall",
]
