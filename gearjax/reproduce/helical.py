"""Guo and Fang (2018): vibration of a helical pair with run-outs and measured errors, at 50.8 and at 2104 rpm."""

import math

import jax.numpy as jnp
import numpy as np

from gearjax.analysis.quasi_static import transmission_error
from gearjax.compliance import ToothSlices
from gearjax.errors import Eccentricity
from gearjax.progress import Progress, silent
from gearjax.reproduce.rows import Row
from gearjax.scene import Scene
from gearjax.systems import HelicalPair
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
    "sidebands. The series of the paper (eq. 28) gives 1 to 1.5 um, as its stiffness varies under run-outs that its "
    "deflection neglects"
)


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
    te = transmission_error(gears, theta, TORQUE).te
    lines = np.fft.rfft(np.asarray(te)) * 2 / number
    return np.abs(lines) * float(gears.system.pair.gears[1].base_radius) / um


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
    return report + _heights(high)


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


def _heights(high: np.ndarray) -> list[Row]:
    """Heights of the sidebands that run-outs alone cause."""
    aside = {"- f_p": -47, "- f_g": -19, "+ f_g": 19, "+ f_p": 47}
    return [
        Row(f"Table 5, static, height of f_m {name}", "", float(high[893 + shift]), "um", 0.0, why=BANDS)
        for name, shift in aside.items()
    ]
