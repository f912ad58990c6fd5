"""Results of a run or of a study, and the files that hold them."""

from gearjax.results.cases import (
    METRICS,
    Case,
    highest_load_sharing,
    remarks,
    required_run,
    run_cases,
    save,
    stored_config,
)
from gearjax.results.optimisation import Optimisation, optimise

__all__ = [
    "METRICS",
    "Case",
    "Optimisation",
    "highest_load_sharing",
    "optimise",
    "remarks",
    "required_run",
    "run_cases",
    "save",
    "stored_config",
]
