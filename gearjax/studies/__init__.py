"""Studies of a scene: searches over its numbers."""

from gearjax.studies.grid import GridSearch, grid_search
from gearjax.studies.objective import Objective

__all__ = ["GridSearch", "Objective", "grid_search"]
