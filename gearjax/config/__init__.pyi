from .build import load, loads, read_file, read_tables
from .commented import template
from .identify import IdentifySection
from .measured import read_flank, read_pitch
from .optimise import OptimiseSection
from .recording import read_measurement
from .studies import loads_identify, loads_optimise, loads_tolerance
from .tolerance import ToleranceSection
from .write import self_contained, with_numbers

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
