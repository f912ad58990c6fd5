"""What a stepper cannot be is said when it is made, in one line."""

import subprocess
import sys

import diffrax
import numpy as np
import pytest

import gearjax as gj
from tests.conftest import ROOT

RIGHT = [
    lambda: gj.FixedStep(per_sample=3, windows=gj.Windows(2, 0.0)),
    lambda: gj.AdaptiveStep(rtol=0.0, atol=1e-6, solver=diffrax.Tsit5()),
]
WRONG = {
    "step = nan s: must be above 0": lambda: gj.FixedStep(float("nan")),
    "number = 0: must be a whole number": lambda: gj.FixedStep(windows=gj.Windows(0, 0.0)),
    "number = 2.5: must be a whole number": lambda: gj.FixedStep(windows=gj.Windows(2.5, 0.01)),
    "warm_up = -0.1 s: must be a time": lambda: gj.FixedStep(windows=gj.Windows(2, -0.1)),
    "warm_up = nan s: must be a time": lambda: gj.FixedStep(windows=gj.Windows(2, float("nan"))),
    "rtol = -1.0: must be a tolerance": lambda: gj.AdaptiveStep(rtol=-1.0, atol=1.0),
    "atol = nan: must be a tolerance": lambda: gj.AdaptiveStep(atol=float("nan")),
    "rtol = atol = 0": lambda: gj.AdaptiveStep(rtol=0.0, atol=0.0),
    "max_steps = 0: must be a whole number": lambda: gj.AdaptiveStep(max_steps=0),
    "asks for 1e+12 steps between samples": lambda: gj.FixedStep(1e-15).steps(np.array([0.0, 1e-3])),
}


@pytest.mark.parametrize("make", RIGHT)
def test_right_steppers(make):
    assert make() is not None


@pytest.mark.parametrize("words", WRONG)
def test_wrong_steppers(words):
    with pytest.raises(gj.SceneError) as fault:
        WRONG[words]()
    assert words in str(fault.value)
    assert "\n" not in str(fault.value)


def test_wrong_kinds(told_outside):
    """As users meet them: the annotations that tests check would refuse these first."""
    for call, words in {
        "FixedStep(per_sample=1.5)": "per_sample = 1.5: must be a whole number",
        "FixedStep(1e-6, solver='rk4')": "solver = 'rk4': must be a solver",
        "AdaptiveStep(solver='x')": "solver = 'x': must be a solver",
    }.items():
        assert words in told_outside[call]


@pytest.fixture(scope="module")
def told_outside():
    calls = ["FixedStep(per_sample=1.5)", "FixedStep(1e-6, solver='rk4')", "AdaptiveStep(solver='x')"]
    program = f"""
import gearjax as gj
for call in {calls!r}:
    try:
        eval("gj." + call)
    except gj.SceneError as fault:
        print(call, fault, sep=" | ")
"""
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    return dict(line.split(" | ", 1) for line in printed.stdout.splitlines())
