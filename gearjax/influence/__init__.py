"""Influence of the teeth of a gear on each other: tables from finite elements, their files and their interpolation."""

from gearjax.influence.files import read_influence, save_influence
from gearjax.influence.interpolate import influence_between, influence_of, influence_on_grid
from gearjax.influence.table import InfluenceTable, gear_hash
from gearjax.influence.teeth import tooth_influence

__all__ = [
    "InfluenceTable",
    "gear_hash",
    "influence_between",
    "influence_of",
    "influence_on_grid",
    "read_influence",
    "save_influence",
    "tooth_influence",
]
