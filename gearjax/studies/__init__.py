"""Studies of a scene: searches over its numbers, and sensitivity at an optimum."""

from gearjax.studies.compensate import compensate
from gearjax.studies.compensation import Compensation
from gearjax.studies.grid import GridSearch, grid_search
from gearjax.studies.minimise import Minimisation, minimise
from gearjax.studies.objective import Objective
from gearjax.studies.scatter import Scatter
from gearjax.studies.sensitivity import LocalSensitivity, local_sensitivity
from gearjax.studies.terms import Term

__all__ = [
    "Compensation",
    "GridSearch",
    "LocalSensitivity",
    "Minimisation",
    "Objective",
    "Scatter",
    "Term",
    "compensate",
    "grid_search",
    "local_sensitivity",
    "minimise",
]
