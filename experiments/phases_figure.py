"""The README's picture of the assembly phases: the no-load TE before and after, and where the starts ended.

python experiments/phases_figure.py
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import dataclasses

import numpy as np

from gearjax.config import loads_optimise, read_file
from gearjax.plot import draw_curve, finish, new_figure, save_figure
from gearjax.results import optimise
from gearjax.units import arcmin

HERE = Path(__file__).parent


def main() -> None:
    scene, section = loads_optimise(read_file(HERE.parent / "configs" / "two_kv" / "wang_2020_phases.toml"))
    assert scene.run is not None
    scene = dataclasses.replace(scene, run=dataclasses.replace(scene.run, analyses=("no_load",), torques=()))
    found = optimise(section, scene, print)
    figure, (curves, ends) = new_figure(1, 2, width=12.0, height=3.4)
    time = scene.run.times
    labels = {"before": "before", "grid": "10-degree grid", "after": "gradients"}
    colours = {"before": "0.6", "grid": "tab:blue", "after": "tab:red"}
    for stage, label in labels.items():
        case = found.cases[stage][0]
        amplitude = case.metrics["amplitude"] / arcmin
        draw_curve(curves, time, case.record, f"{label}: {amplitude:.4f}", color=colours[stage], linewidth=0.9)
    finish(curves, "No-load transmission error, with its largest absolute value [arcmin]")
    curves.legend(fontsize="small", loc="lower right", ncols=3, framealpha=0.85)
    curves.set_ylim(-1.65, 1.3)
    heights = np.sort(found.gradient.objectives) / arcmin
    ends.plot(
        np.arange(1, heights.size + 1), heights, ".", color=colours["after"], markersize=4, label="one start each"
    )
    assert found.grid is not None
    ends.axhline(found.before / arcmin, color=colours["before"], linestyle="--", label="before")
    ends.axhline(found.grid.objective / arcmin, color=colours["grid"], label="best of all 36^4 combinations")
    finish(ends, "Where 300 starts ended, best first", x="start [-]", y="max abs TE [arcmin]")
    ends.legend(fontsize="small", loc="center", framealpha=0.85)
    save_figure(figure, HERE / "phases.png")


if __name__ == "__main__":
    main()
