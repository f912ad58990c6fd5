"""A gear set that gearjax has never heard of runs through every analysis, unchanged."""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import gearjax as gj
from gearjax import plot, registry, results, units
from gearjax.contact import BodyView, Layout, Pose, Request
from gearjax.parameters import check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar


class SpurPair(AbstractSystem):
    """Two spur wheels with run-out: one contact per flank."""

    kind: ClassVar[str] = "spur_pair"
    pinion_teeth: int = count()
    wheel_teeth: int = count()
    wheel_base_radius: Number = length(above=0.0)
    pressure_angle: Number = number(units.ANGLE, above=0.0)
    input_speed: Number = number(units.ANGULAR_SPEED, above=0.0)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("pinion", "wheel")

    @property
    def orders(self) -> Mapping[str, float]:
        return {"output": self.pinion_teeth / self.wheel_teeth, "mesh": float(self.pinion_teeth)}

    @property
    def cycle(self) -> float:
        return 2 * math.pi * self.wheel_teeth / math.gcd(self.pinion_teeth, self.wheel_teeth)

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        side = jnp.asarray(self.layout(request).side, theta.dtype)
        views = {body: self.view(body, theta, side) for body in request.bodies}
        mesh = jnp.reshape(self.pinion_teeth * theta, (1,)) if request.mesh else None
        return Pose(theta, -side[:, None] * self.wheel_base_radius, jnp.zeros_like(side), views, mesh)

    def view(self, body: str, theta: Scalar, side: Float[Array, " contact"]) -> BodyView:
        order = 1.0 if body == "pinion" else -self.pinion_teeth / self.wheel_teeth
        return BodyView(order * theta, side * self.pressure_angle, -side if body == "pinion" else side)


CONFIG = """
[system]
kind = "spur_pair"
pinion_teeth = 20
wheel_teeth = 31
wheel_base_radius = "30 mm"
pressure_angle = "20 deg"
input_speed = "600 rpm"
[errors.pinion_runout]
kind = "eccentricity"
body = "pinion"
amplitude = "8 um"
phase = "10 deg"
[errors.wheel_runout]
kind = "eccentricity"
body = "wheel"
amplitude = "15 um"
phase = "70 deg"
[backlash]
initial = "0.1 mm"
[compliance]
kind = "harmonic_stiffness"
mean = "2e8 N/m"
relative_amplitudes = [0.1, 0.03]
phases = ["0 deg", "40 deg"]
[inertia]
mass = "2 kg"
[damping]
ratio = 0.08
[load]
kind = "constant"
[run]
duration = "0.31 s"
samples = 311
settle = "0.05 s"
analyses = ["no_load", "backlash", "static", "dynamic"]
torques = ["20 N*m"]
"""


@pytest.fixture
def spur(monkeypatch) -> gj.Scene:
    """The pair, read from a configuration while it is registered."""
    known = {group: dict(kinds) for group, kinds in registry._kinds.items()}
    monkeypatch.setattr(registry, "_kinds", known)  # other tests, of this process too, know nothing of it
    gj.register(SpurPair)
    return gj.loads(CONFIG)


def run_out(theta, flank=1.0):
    """The same by hand: rise of the ideal output along the line of action [m]."""
    angle = flank * math.radians(20)
    pinion = 8e-6 * np.sin(theta + angle + math.radians(10))
    wheel = -15e-6 * np.sin(-20 / 31 * theta + angle + math.radians(70))
    return pinion + wheel


@pytest.mark.slow
def test_quasi_static(spur):
    theta = jnp.linspace(0.0, spur.system.cycle, 2001)
    te = gj.transmission_error(spur, theta)
    np.testing.assert_allclose(te.te, run_out(np.asarray(theta)) / 0.03, rtol=0, atol=1e-15)
    static = gj.transmission_error(spur, theta, torque=20.0)
    np.testing.assert_allclose(static.te, te.te - 20.0 / (2e8 * 0.03**2), rtol=0, atol=1e-15)
    np.testing.assert_allclose(static.forces[:, 0], 20.0 / 0.03, rtol=1e-9)
    play = gj.backlash(spur, theta)
    expected = (1e-4 + run_out(np.asarray(theta), -1.0) - run_out(np.asarray(theta))) / 0.03
    np.testing.assert_allclose(play.backlash, expected, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_every_case_and_figure(spur, tmp_path):
    cases = list(results.run_cases(spur))
    assert [case.analysis for case in cases] == ["no_load", "backlash", "static", "dynamic"]
    results.save(spur, cases, CONFIG, tmp_path)
    assert [path.name for path in plot.save_figures(spur, cases, tmp_path)] == [
        "transmission_error.png",
        "contact_forces.png",
        "order_spectrum.png",
    ]
    assert cases[-1].metrics["mean"] == pytest.approx(cases[2].record[50:].mean(), rel=0.03)


@pytest.mark.slow
def test_a_colour_is_one_case_and_the_input_angle_stands_above_time(spur):
    cases = list(results.run_cases(spur))
    figures = plot.error_figure(spur, cases), plot.spectrum_figure(spur, cases)
    lines = [line for figure in figures if figure for ax in figure.axes for line in ax.lines]
    titles = {case.title for case in cases}
    drawn = {(line.get_label(), line.get_color(), line.get_linestyle()) for line in lines if line.get_label() in titles}
    assert len(drawn) == len(titles) == len({look[1:] for look in drawn})
    above = figures[0].axes[0].child_axes[0]
    assert above.get_xlabel() == "input angle [deg]"
    FigureCanvasAgg(figures[0]).draw()
    low, high = above.get_xlim()
    time = figures[0].axes[0].get_xlim()
    speed = np.degrees(float(spur.system.input_speed))
    np.testing.assert_allclose((low, high), speed * np.array(time), rtol=1e-12)


def test_many_cases_differ_by_style_too():
    styles = plot.axes.styles_of([f"case {number}" for number in range(30)])
    assert len({tuple(style.values()) for style in styles.values()}) == 30


def test_it_is_not_drawn_without_a_sketch(spur):
    with pytest.raises(gj.SceneError, match="a spur_pair gives no sketch"):
        plot.schematic_figure(spur)


@pytest.mark.slow
def test_gradients_and_batches(spur):
    theta = jnp.linspace(0.0, spur.system.cycle, 501)

    def amplitude(size):
        where = eqx.tree_at(lambda s: s.errors["wheel_runout"].amplitude, spur, size)
        return gj.transmission_error(where, theta).amplitude

    sizes = jnp.array([5e-6, 15e-6, 40e-6])
    slopes = jax.jit(jax.vmap(jax.grad(amplitude)))(sizes)
    step = 1e-9
    central = [(amplitude(size + step) - amplitude(size - step)) / (2 * step) for size in sizes]
    np.testing.assert_allclose(slopes, central, rtol=1e-6)


@pytest.mark.slow
def test_simulate_without_damping_and_back_flanks(spur):
    bare = dataclasses.replace(spur, damping=None, backlash=None, run=None)
    motion = gj.simulate(bare, jnp.linspace(0.0, 0.05, 51), torque=20.0)
    assert motion.forces.shape == (51, 1)
    assert bool((motion.forces > 0).all())
