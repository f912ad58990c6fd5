"""Guo and Fang (2018): vibration of a helical pair with run-outs and measured errors, at 50.8 and at 2104 rpm."""

import dataclasses
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gearjax.analysis.fourier_series import fourier_series
from gearjax.analysis.quasi_static import transmission_error
from gearjax.compliance import ToothSlices
from gearjax.errors import Eccentricity
from gearjax.inertia import DampingRatio, MomentOfInertia
from gearjax.load_torque import ConstantLoad
from gearjax.progress import Progress, silent
from gearjax.reproduce.rows import Row
from gearjax.scene import Scene
from gearjax.systems import HelicalPair
from gearjax.typing import Array
from gearjax.units import deg, mm, rpm, um

PAPER = (
    "Guo, Fang (2018), Experimental and Theoretical Study of Gear Dynamical Transmission Characteristic Considering "
    "Measured Manufacturing Errors"
)
TORQUE = 830.0  # N m, on the wheel
SPEEDS = {"50.8": 50.8 * rpm, "2104": 2104 * rpm}  # speeds of the pinion
PER_MESH = 16  # angles per mesh
RUN_OUTS = {"pinion": 15 * um, "wheel": 20 * um}  # amplitudes of simulation 2

FREQUENCIES = {  # Tables 4 and 6: frequencies of the wheel, the pinion and the mesh [Hz]
    "50.8": ("0.344", "0.848", "16.1"),
    "2104": ("14.23", "35.08", "666.2"),
}
SIDEBANDS = {  # Tables 5 and 7: sidebands at -f_p, -f_g, +f_g, +f_p of the mesh frequency and of twice it [Hz]
    "50.8": (("15.26", "15.76", "16.45", "16.95"), ("31.35", "31.85", "32.54", "33.06")),
    "2104": (("630.8", "652.2", "680.7", "701.5"), ("1297", "1318", "1347", "1368")),
}
AMPLITUDES = {  # Tables 4 and 6: amplitudes of each simulation at these frequencies [um]
    "50.8": {1: ("24.91", "16.12", "2.42"), 2: ("20", "15.2", "0.90"), 3: ("49.63", "37.77", "12.86")},
    "2104": {1: ("24.66", "15.93", "5.28"), 2: ("20", "15.21", "1.57"), 3: ("49.63", "37.78", "14.47")},
}
TABLES = {"50.8": ("Table 4", "Table 5"), "2104": ("Table 6", "Table 7")}

READ = "the printed frequencies were read off a spectrum in the paper; limit 0.6 %"
STILL = (
    "static TE, as the run-outs turn far below every natural frequency; limit 2 %, as 15.2 may be 15 divided by the "
    "cosine of the base helix angle"
)
CURVE = "the modification of the pinion is a curve without numbers, so this pair has none; "
TWICE = "the paper uses both its loaded TE and a varying stiffness, so the deflection at mesh order counts twice"
MISSING = {
    1: "the measured pitch errors and deviations are curves without numbers",
    3: "the phases of the run-outs against the pitch errors of eq. (33) are not printed: 16 to 57 um (wheel) and 13 to "
    "44 um (pinion) are possible",
}
MOVING = "the modification of the pinion, which determines this value, is a curve without numbers"
BANDS = (
    "the paper prints the frequencies of the sidebands, not their heights. To first order, run-outs alone cause no "
    "sidebands"
)
SERIES = (
    "the series of the paper (eqs. 28 to 31, `gj.fourier_series`) causes these sidebands: its stiffness varies under "
    "run-outs that its deflection neglects. With the deflection of the whole pair they are gone"
)
MOMENT = 0.66  # kg m2, of a solid wheel; any serves, as 50.8 rpm is slow
ASIDE = {"- f_p": -47, "- f_g": -19, "+ f_g": 19, "+ f_p": 47}  # cycles in the period beside those of the mesh


def scene(speed: float = SPEEDS["50.8"]) -> Scene:
    """The pair of Table 1 with the run-outs of simulation 2 and unmodified flanks; the bores are fitted values."""
    errors = {
        body: Eccentricity(body=body, amplitude=amplitude, phase=phase * deg)
        for (body, amplitude), phase in zip(RUN_OUTS.items(), (0.0, 90.0), strict=True)
    }
    pair = HelicalPair(
        pinion_teeth=19,
        wheel_teeth=47,
        normal_module=6 * mm,
        normal_pressure_angle=20 * deg,
        helix_angle=9.911 * deg,
        face_width=75 * mm,
        centre_distance=201 * mm,
        input_speed=speed,
        slices=20,
    )
    teeth = ToothSlices(youngs_modulus=206e9, poissons_ratio=0.3, pinion_bore=40 * mm, wheel_bore=80 * mm)
    return Scene(pair, errors, compliance=teeth)


def amplitudes() -> np.ndarray:
    """Amplitudes of the static TE over the whole period of 893 meshes, along the base tangent, shape (n,) [um].

    The index is the number of cycles in the period: 19 for the wheel, 47 for the pinion, and 893 for the mesh.
    """
    gears = scene()
    assert isinstance(gears.system, HelicalPair)
    number = round(gears.system.cycle * gears.system.pinion_teeth / (2 * math.pi)) * PER_MESH
    theta = jnp.asarray(gears.system.cycle / number * np.arange(number))
    return _lines(gears, transmission_error(gears, theta, TORQUE).te)


def _lines(gears: Scene, te: Array) -> np.ndarray:
    """Amplitudes along the base tangent, shape (n,) [um]."""
    assert isinstance(gears.system, HelicalPair)
    lines = np.fft.rfft(np.asarray(te)) * 2 / te.size
    return np.abs(lines) * float(gears.system.pair.gears[1].base_radius) / um


def series_amplitudes() -> np.ndarray:
    """The same of the motion at 50.8 rpm by the paper's series, which takes the deflection without run-outs."""
    gears = scene()
    gears = dataclasses.replace(gears, load=ConstantLoad(), inertia=MomentOfInertia(MOMENT), damping=DampingRatio(0.07))
    meshes = round(gears.system.cycle * gears.system.orders["mesh"] / (2 * math.pi))
    period = gears.system.cycle / gears.system.input_speed
    found = fourier_series(
        gears,
        TORQUE,
        period,
        harmonics=4 * meshes,
        samples=PER_MESH * meshes,
        static=dataclasses.replace(gears, errors={}),
    )
    return _lines(gears, found.te)


def rows(say: Progress = silent) -> list[Row]:
    """Frequencies and amplitudes of the paper next to ours, and why some cannot be computed.

    Args:
        say: function that is called with what is being computed.
    """
    say("static TE over 893 meshes")
    high = amplitudes()
    report = []
    for speed in SPEEDS:
        report += [*_frequencies(speed), *_amplitudes(speed, high), *_sidebands(speed)]
    say("the paper's series over 893 meshes")
    return report + _heights("static", high, BANDS) + _heights("series of the paper", series_amplitudes(), SERIES)


def _of(speed: str) -> tuple[float, float, float]:
    """Frequencies of rotation of the wheel and the pinion, and mesh frequency [Hz]."""
    system = scene(SPEEDS[speed]).system
    turns = float(system.input_speed) / (2 * math.pi)
    wheel, pinion, mesh = (system.orders[name] * turns for name in ("output", "pinion", "mesh"))
    return wheel, pinion, mesh


def _frequency(item: str, published: str, computed: float) -> Row:
    return Row(item, published, computed, "Hz", 0.006 * float(published), why=READ)


def _frequencies(speed: str) -> list[Row]:
    named = zip(("f_g", "f_p", "f_m"), FREQUENCIES[speed], _of(speed), strict=True)
    return [_frequency(f"{TABLES[speed][0]}, {speed} rpm, {name}", text, own) for name, text, own in named]


def _sidebands(speed: str) -> list[Row]:
    wheel, pinion, mesh = _of(speed)
    report = []
    for times, printed in zip((1, 2), SIDEBANDS[speed], strict=True):
        aside = zip(("- f_p", "- f_g", "+ f_g", "+ f_p"), printed, (-pinion, -wheel, wheel, pinion), strict=True)
        for name, text, shift in aside:
            item = f"{TABLES[speed][1]}, {speed} rpm, {'2 ' if times == 2 else ''}f_m {name}"
            report.append(_frequency(item, text, times * mesh + shift))
    return report


def _amplitudes(speed: str, high: np.ndarray) -> list[Row]:
    report = []
    for simulation, printed in AMPLITUDES[speed].items():
        for name, text, line in zip(("f_g", "f_p", "f_m"), printed, (19, 47, 893), strict=True):
            item = f"{TABLES[speed][0]}, {speed} rpm, simulation {simulation}, {name}"
            computed, why = math.nan, MISSING.get(simulation, "")
            if simulation == 2 and name != "f_m":
                computed, why = float(high[line]), STILL
            elif simulation == 2:
                still = speed == "50.8"
                computed, why = (float(high[line]), CURVE + TWICE) if still else (math.nan, MOVING)
            report.append(Row(item, text, computed, "um", 0.02 * float(text), why=why))
    return report


def _heights(way: str, high: np.ndarray, why: str) -> list[Row]:
    """Heights of the sidebands that run-outs alone cause."""
    return [
        Row(f"Table 5, {way}, height of f_m {name}", "", float(high[893 + shift]), "um", 0.0, why=why)
        for name, shift in ASIDE.items()
    ]


def save_sidebands_figure(rows: list[Row], folder: Path) -> list[Path]:
    """Draw the sidebands that the paper's series makes of run-outs, and those that they cause.

    Args:
        rows: rows of the paper.
        folder: folder of the file ``helical_sidebands.png``.

    Raises:
        GearjaxError: the file cannot be written.
    """
    from gearjax.plot import finish, new_figure, save_figure  # the import of matplotlib takes a second

    by_item = {row.item: row.computed for row in rows}
    figure, (ax,) = new_figure(1)
    for place, (way, label) in enumerate((("series of the paper", "paper's series"), ("static", "equilibrium"))):
        heights = [by_item[f"Table 5, {way}, height of f_m {name}"] for name in ASIDE]
        told = f"{label}, up to {max(heights):.1g} um"
        ax.bar(np.arange(len(ASIDE)) + 0.36 * (place - 0.5), heights, width=0.34, label=told, color=f"C{place}")
    ax.set_xticks(np.arange(len(ASIDE)), [f"f_m {name}" for name in ASIDE])
    title = "Guo, Fang (2018), 50.8 rpm: sidebands of run-outs"
    finish(ax, title, x="frequency", y="amplitude of the TE [um]")
    return [save_figure(figure, folder / "helical_sidebands.png")]
