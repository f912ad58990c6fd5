"""Motion of bodies on supports, in all coordinates, by steps of constant modes."""

from gearjax.analysis.modes.equation import StructureEquation
from gearjax.analysis.modes.lines import Driving, Lines
from gearjax.analysis.modes.parabola import ExponentialParabola, ForcedTerm
from gearjax.analysis.modes.steps import Spacing, Steps, march

__all__ = ["Driving", "ExponentialParabola", "ForcedTerm", "Lines", "Spacing", "Steps", "StructureEquation", "march"]
