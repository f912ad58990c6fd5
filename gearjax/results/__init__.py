"""Results of a run or of a study, and the files that hold them."""

from gearjax.results.accuracy import GradedGear, graded_gears
from gearjax.results.cases import (
    Case,
    clash_of,
    growth_remark,
    highest_load_sharing,
    remarks,
    required_run,
    run_cases,
    save,
    stored_config,
)
from gearjax.results.loads_on_parts import face_load_factors, forces_on_bearings, impacts_as_json, impacts_of
from gearjax.results.optimisation import Optimisation, optimise, save_optimisation
from gearjax.results.spectra import OrderLines, order_lines
from gearjax.results.torques import against_torque
from gearjax.results.tradeoff import as_json as tradeoff_as_json
from gearjax.results.tradeoff import save_tradeoff

__all__ = [
    "Case",
    "GradedGear",
    "Optimisation",
    "OrderLines",
    "against_torque",
    "clash_of",
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
    "stored_config",
    "tradeoff_as_json",
]
