"""Units as engineers write them, and what is said about those that measure something else."""

import math

import numpy as np
import pytest

import gearjax as gj
from gearjax import units
from gearjax.config import quantities
from gearjax.config.quantities import read_quantity, read_ratio
from gearjax.config.spelling import UnknownUnit, factors
from gearjax.units import (
    ANGLE,
    ANGULAR_SPEED,
    FREQUENCY,
    INERTIA,
    LENGTH,
    MASS,
    PRESSURE,
    STIFFNESS,
    TIME,
    TORQUE,
)

UNDERSTOOD = {
    TORQUE: {
        30.0: [
            "30 Nm",
            "30 N m",
            "30 N·m",
            "30 N⋅m",
            "30 N.m",
            "30 N-m",
            "30N*m",
            "0.03 kNm",
            "30e3 mNm",
            "3e4 Nmm",
            "3000 Ncm",
        ],
        9.80665: ["1 kgf*m", "100 kgf*cm", "1 kp m"],
        1.3558179483314: ["1 lbf*ft", "12 lbf-in", "1 ft·lbf"],
        -2.0: ["-2 kg*m^2/s^2", "\u22122 Nm", "-2\u00a0N\u2009m"],
    },
    LENGTH: {
        5e-6: ["5 um", "5 µm", "5 μm", "5 micron", "5e-3 mm", "0.005mm", "5000 nm"],
        0.0127: [".5 inch", "0.5 in", "500 thou"],
    },
    ANGLE: {
        math.pi / 10800: ["1 arcmin", "60 arcsec", "60 arcseconds", "1 arcminute"],
        math.pi / 2: ["90 deg", "90°", "0.25 turn", "0.25 rev", "100 gon", "90 degrees"],
        1e-3: ["1e-3 rad", "1 mrad", "1000 urad", "1000 µrad"],
    },
    ANGULAR_SPEED: {
        10 * math.pi: ["300 rpm", "300 RPM", "300 1/min", "300/min", "300 min^-1", "300 min-1", "300 min⁻¹"],
        5 * math.tau: ["300 U/min", "300 r/min", "300 rev/min", "5 turn/s", "5 r/s", "1800 deg/s", "1800 °/s"],
        math.pi / 60: ["3 deg/s"],
    },
    FREQUENCY: {5.0: ["5 Hz", "5 1/s", "5 s^-1", "300 1/min", "5e-3 kHz"]},
    STIFFNESS: {
        9e7: ["9e7 N/m", "90 N/um", "90 N/µm", "9e4 N/mm", "90 kN/mm", "90 MN/m", "9e7 kg/s^2"],
        175.126835246476: ["1 lbf/in"],
    },
    PRESSURE: {
        206e9: ["206 GPa", "206e3 MPa", "206 kN/mm^2", "206 kN/mm²", "206e3 N/mm2", "206e3 N/mm**2", "2.06e6 bar"],
        6894757.29316836: ["1 ksi", "1000 psi"],
    },
    INERTIA: {
        0.02: [
            "0.02 kg*m^2",
            "0.02 kgm^2",
            "0.02 kgm2",
            "0.02 kgm²",
            "0.02 kg m2",
            "200 kgcm^2",
            "2e5 gcm²",
            "0.02 Nm*s^2",
        ],
        0.0980665: ["1 kgf*cm*s^2"],
    },
    MASS: {3.0: ["3 kg", "3000 g", "0.003 t", "3e6 mg"], 0.45359237: ["1 lb"]},
    TIME: {180.0: ["180 s", "3 min", "0.05 h", "180 sec", "180e3 ms"]},
}


@pytest.mark.parametrize("dimension", UNDERSTOOD, ids=lambda dimension: dimension.name)
def test_units_as_they_are_written(dimension):
    for value, spellings in UNDERSTOOD[dimension].items():
        for text in spellings:
            assert read_quantity("x", text, dimension) == pytest.approx(value, rel=1e-12), text


REFUSED = {
    TORQUE: {
        "100 J": 'is an energy; needs a torque such as "30 N*m"',
        "1 eV": "is an energy",
        "1 cal": "is an energy",
        "1 kWh": "is an energy",
        "1 BTU": "is an energy",
        "100 nm": 'is a length, did you mean "Nm"?',
        "10 NM": 'unknown unit "NM", did you mean "Nm"?',
        "10 KNm": 'did you mean "kNm"?',
        "10 Kn*m": 'did you mean "kN*m"?',
        "10 N": "is a force",
        "100 kg*m": "is a mass times a length (kgf and lbf are forces)",
        "3 ft-lb": "lbf are forces",
        "100 Nm/rad": "is a torsional stiffness",
        "100 J/rad": "is not written as a torque",
        "10 Pa*m^3": "is not written as a torque",
        "100 Nms": 'unknown unit "Nms"',
        "10 dB*m": 'unknown unit "dB"',
        "1,000 Nm": "has a comma",
        "1_000 Nm": "separator",
        "10 W": "is a power",
    },
    LENGTH: {
        "2.5 MM": 'did you mean "mm"?',
        "2.5 Mm": '"Mm" is read as megameter, did you mean "mm"?',
        "2,5 mm": "has a comma",
        '5"': "may mean angles or lengths",
        "5 mm²": "is an area",
        "5 degC": 'unknown unit "degC"',
        "5 mil": "write thou, um or mrad",
        "5 m/kg": "is not written as a length",
    },
    ANGLE: {"10'": "write arcmin", "5 grad": "write deg or gon", "5 Gy": 'unknown unit "Gy"', "0.1 m/m": "is a ratio"},
    ANGULAR_SPEED: {
        "5 Hz": 'is a frequency; needs an angular speed such as "300 rpm", in rpm, 1/min, deg/s or rad/s',
        "5 1/s": "is a frequency",
        "5 Bq": 'unknown unit "Bq"',
        "300 Rpm": 'did you mean "rpm"?',
        "90 deg": "is an angle",
    },
    FREQUENCY: {"300 rpm": "is an angular speed", "5 Bq": 'unknown unit "Bq"', "5 HZ": 'did you mean "Hz"?'},
    STIFFNESS: {
        "9 Pa*m": "is not written as a stiffness",
        "9 N*m": "is a torque",
        "9 Nm/rad": "is a torsional stiffness",
        "9 KN/MM": 'did you mean "kN/mm"?',
        "14 N/mm*um": "is ambiguous: write a / before",
        "5 J/m^2": "is not written as a stiffness",
    },
    PRESSURE: {
        "206 mPa": 'read as millipascal, did you mean "MPa"?',
        "206 GPA": 'did you mean "GPa"?',
        "2 J/m^3": "not written",
    },
    INERTIA: {"2 Kgm^2": 'did you mean "kgm^2"?', "2 kg": "is a mass; needs a moment of inertia"},
    MASS: {"3 KG": 'did you mean "kg"?', "3 kgf": "is a force", "3 Mg": "is read as megagram"},
    TIME: {
        "3 S": 'did you mean "s"?',
        "3 Ms": 'did you mean "ms"?',
        "3 m": "is a length; needs a time",
        "3 Sv": "unknown",
    },
}
EVERY = [(dimension, text) for dimension, entries in REFUSED.items() for text in entries]


@pytest.mark.parametrize(("dimension", "text"), EVERY, ids=[text for _, text in EVERY])
def test_units_that_measure_something_else(dimension, text):
    with pytest.raises(gj.ParameterError) as caught:
        read_quantity("x.y", text, dimension)
    message = str(caught.value)
    assert REFUSED[dimension][text] in message
    assert message.startswith(f'x.y = "{text}": ')
    assert dimension.described in message
    assert dimension.example in message
    assert "[" not in message
    assert len(message) < 250


def test_the_units_that_messages_show_can_be_read():
    for dimension in vars(units).values():
        if isinstance(dimension, units.Dimension) and dimension.unit:
            assert read_quantity("x", f"1 {dimension.shown}", dimension) == pytest.approx(
                dimension.per_shown, rel=1e-12
            )
            assert math.isfinite(read_quantity("x", dimension.example, dimension))
            for form in (dimension.unit, *dimension.forms):
                assert read_quantity("x", f"1 {form}", dimension) == 1.0


def test_percent_is_a_ratio(config_text):
    assert read_ratio("x", "13 %") == pytest.approx(0.13)
    assert read_ratio("x", 0.13) == 0.13
    scene = gj.loads(config_text.replace("ratio = 0.1", 'ratio = "10 %"').replace("[0.13]", '["13%"]'))
    assert float(scene.damping.ratio) == pytest.approx(0.1)
    np.testing.assert_allclose(scene.compliance.relative_amplitudes, [0.13])
    for text in ("10 mm", "10", "10 % %", "%"):
        with pytest.raises(gj.ParameterError, match=r'without unit, such as 0\.1, or percent, such as "10 %"'):
            read_ratio("x", text)


@pytest.mark.parametrize(
    "text", ["", "*", "m*", "/", "m//s", "m^9", "m^", "m**", "(m)", "m " * 40, "m·", "1/", "\0", "m\n·"]
)
def test_what_is_no_product_of_units_is_refused(text):
    with pytest.raises(UnknownUnit):
        factors(text)


@pytest.mark.parametrize("unit", sorted(quantities._EVERYDAY))
def test_everyday_units_are_what_pint_says(unit, monkeypatch):
    dimension, size = quantities._EVERYDAY[unit]
    monkeypatch.setattr(quantities, "_EVERYDAY", {})
    assert quantities.unit_size("key", f"1 {unit}", unit, dimension) == size
