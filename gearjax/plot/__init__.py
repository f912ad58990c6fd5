"""Figures of a run and of studies."""

from gearjax.plot.axes import draw_curve, figures_kept, finish, new_figure, save_figure, thin
from gearjax.plot.cycloid import save_stage_figure, stage_figure
from gearjax.plot.involute import pair_figure, save_pair_figure
from gearjax.plot.noncircular import noncircular_figure, save_noncircular_animation
from gearjax.plot.optimisation import save_optimisation_figures
from gearjax.plot.report import report_page
from gearjax.plot.run import bearing_figure, error_figure, force_figure, mark_multiples, save_figures, spectrum_figure
from gearjax.plot.schematic import schematic_figure
from gearjax.plot.stiffness import stiffness_figure
from gearjax.plot.tolerance import save_tolerance_figures
from gearjax.plot.torque_sweep import torque_sweep_figure
from gearjax.plot.tradeoff import save_tradeoff_figure
from gearjax.plot.waterfall import waterfall_figure

__all__ = [
    "bearing_figure",
    "draw_curve",
    "error_figure",
    "figures_kept",
    "finish",
    "force_figure",
    "mark_multiples",
    "new_figure",
    "noncircular_figure",
    "pair_figure",
    "report_page",
    "save_figure",
    "save_figures",
    "save_noncircular_animation",
    "save_optimisation_figures",
    "save_pair_figure",
    "save_stage_figure",
    "save_tolerance_figures",
    "save_tradeoff_figure",
    "schematic_figure",
    "spectrum_figure",
    "stage_figure",
    "stiffness_figure",
    "thin",
    "torque_sweep_figure",
    "waterfall_figure",
]
