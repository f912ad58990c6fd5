from .accuracy import GradedGear, graded_gears
from .cases import (
    Case,
    clash_of,
    highest_load_sharing,
    required_run,
    run_cases,
    save,
    stored_config,
)
from .loads_on_parts import face_load_factors, forces_on_bearings, impacts_as_json, impacts_of
from .optimisation import Optimisation, optimise, save_optimisation
from .run_remarks import displacement_remark, growth_remark, remarks, separation_remark
from .spectra import OrderLines, order_lines
from .torques import against_torque
from .tradeoff import save_tradeoff, tradeoff_as_json

__all__ = [
    "Case",
    "GradedGear",
    "Optimisation",
    "OrderLines",
    "against_torque",
    "clash_of",
    "displacement_remark",
    "face_load_factors",
    "forces_on_bearings",
    "graded_gears",
    "growth_remark",
    "highest_load_sharing",
    "impacts_as_json",
    "impacts_of",
    "optimise",
    "order_lines",
    "remarks",
    "required_run",
    "run_cases",
    "save",
    "save_optimisation",
    "save_tradeoff",
    "separation_remark",
    "stored_config",
    "tradeoff_as_json",
]
