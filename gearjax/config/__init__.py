"""Configurations: TOML files that list what a scene models and what to compute."""

from gearjax.config.build import load, loads, loads_identify, loads_optimise, loads_tolerance, read_file, read_tables
from gearjax.config.commented import template
from gearjax.config.identify import IdentifySection
from gearjax.config.measured import read_flank, read_pitch
from gearjax.config.optimise import OptimiseSection
from gearjax.config.recording import read_measurement
from gearjax.config.tolerance import ToleranceSection
from gearjax.config.write import self_contained, with_numbers

__all__ = [
    "IdentifySection",
    "OptimiseSection",
    "ToleranceSection",
    "load",
    "loads",
    "loads_identify",
    "loads_optimise",
    "loads_tolerance",
    "read_file",
    "read_flank",
    "read_measurement",
    "read_pitch",
    "read_tables",
    "self_contained",
    "template",
    "with_numbers",
]
