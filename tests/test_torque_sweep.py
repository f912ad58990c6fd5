"""Static TE against the torque: exact lines of force, tip relief, gradients, and the figure of a run."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.plot import torque_sweep_figure
from gearjax.results import against_torque, run_cases
from gearjax.units import arcmin, mm, um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, TEETH, meshes_of, scene_of

TORQUES = np.array([60.0, 120.0, 240.0])


def relieved(amount: float) -> gj.Scene:
    """A spur pair whose pinion has tip relief, and whose wheel too."""
    scene = gj.load(ROOT / "configs" / "helical" / "blankenship_1995.toml")
    tips = {f"{body}_tip": gj.TipRelief(body, [amount], 5 * mm) for body in ("pinion", "wheel")}
    return dataclasses.replace(scene, errors=tips)


@pytest.mark.slow
def test_without_modification_all_is_in_proportion_to_the_torque():
    """Springs along contact lines of given length: TE = -T / (r^2 sum k), so swing and harmonics grow with T."""
    scene = scene_of(GUO_1, compliance=gj.LineStiffness(1.4e10))
    sweep = gj.torque_sweep(scene, meshes_of(scene.system, 48), TORQUES)
    for values in (sweep.mean, sweep.peak_to_peak, sweep.harmonics):
        each = np.asarray(values).T / TORQUES
        np.testing.assert_allclose(each, np.broadcast_to(each[..., :1], each.shape), rtol=1e-9, atol=1e-22)
    springs = [
        float(
            gj.LineStiffness(1.4e10)
            .of_meshes(scene.system.pose(jnp.asarray(angle), gj.Request(slices=True)).slices)
            .stiffness.sum()
        )
        for angle in meshes_of(scene.system, 48)
    ]
    lever = float(scene.system.pair.gears[1].base_radius * jnp.cos(scene.system.pair.base_helix_angle))
    own = -120.0 / (lever**2 * np.array(springs))
    np.testing.assert_allclose(sweep.mean[1], own.mean(), rtol=1e-12)
    np.testing.assert_allclose(sweep.peak_to_peak[1], np.ptp(own), rtol=1e-9)
    waves = 2 * np.abs(np.fft.rfft(own))[1:4] / 48
    np.testing.assert_allclose(sweep.harmonics[1], waves, rtol=1e-8, atol=1e-20)


@pytest.mark.slow
def test_tip_relief_is_smoothest_near_the_torque_that_it_is_made_for():
    """Harris' curves: twice the relief, twice the torque of the smallest swing, as all gaps scale (Harris 1958)."""
    torques = np.linspace(10.0, 400.0, 40)
    best = []
    for amount in (10 * um, 20 * um):
        scene = relieved(amount)
        sweep = gj.torque_sweep(scene, meshes_of(scene.system, 48), torques)
        place = int(np.argmin(np.asarray(sweep.peak_to_peak)))
        assert 0 < place < len(torques) - 1
        assert sweep.peak_to_peak[place] < 0.2 * sweep.peak_to_peak[0]
        best.append(torques[place])
    assert best[1] == pytest.approx(2 * best[0], abs=15.0)


@pytest.mark.slow
def test_each_torque_is_that_of_a_single_analysis():
    scene = scene_of(GUO_1, {"tip": gj.TipRelief("pinion", [8 * um], 6 * mm)}, TEETH)
    theta = meshes_of(scene.system, 32)
    sweep = gj.torque_sweep(scene, theta, TORQUES[::-1], harmonics=2)
    for place, torque in enumerate(TORQUES[::-1]):
        te = gj.transmission_error(scene, theta, torque, extremes="samples")
        np.testing.assert_allclose(sweep.peak_to_peak[place], te.peak_to_peak, rtol=1e-12)
        np.testing.assert_allclose(sweep.mean[place], te.mean, rtol=1e-12)
        lines = gj.order_spectrum(te.te, theta, turn=2 * np.pi / 19, window="none").amplitude
        np.testing.assert_allclose(sweep.harmonics[place], lines[1:3], rtol=1e-9)
    assert (sweep.result == 0).all()


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap():
    scene = relieved(8 * um)
    theta = meshes_of(scene.system, 24)

    def sum_of(numbers):
        tips = {name: dataclasses.replace(e, amount=e.amount + numbers[0]) for name, e in scene.errors.items()}
        sweep = gj.torque_sweep(dataclasses.replace(scene, errors=tips), theta, TORQUES * (1 + numbers[1]))
        return (sweep.harmonics[:, 0].sum() + 0.3 * sweep.mean.sum()) / arcmin

    slopes = jax.jit(jax.vmap(jax.grad(sum_of)))(jnp.zeros((1, 2)))[0]
    steps = np.array([1e-9, 1e-5])
    ends = jax.jit(jax.vmap(sum_of))(jnp.asarray(np.concatenate([np.diag(steps), -np.diag(steps)])))
    np.testing.assert_allclose(slopes, (ends[:2] - ends[2:]) / (2 * steps), rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "fault", "words"),
    [
        ({"theta": np.linspace(0.0, 2 * np.pi / 50, 64)}, SceneError, 'whole periods of the order "mesh", evenly'),
        ({"theta": np.linspace(0.0, 2 * np.pi / 50, 6, endpoint=False)}, SceneError, "6 angles per period; for 3 harm"),
        ({"torques": 100.0}, ParameterError, "give load torques of shape (m,)"),
        ({"order": "pin"}, ParameterError, "order = "),
        ({"extremes": "all"}, ParameterError, "extremes = "),
        ({"harmonics": 0}, ParameterError, "harmonics = "),
        ({"scene": "no compliance"}, SceneError, "[compliance]"),
    ],
)
def test_wrong_input_is_refused_in_one_line(change, fault, words):
    scene = relieved(8 * um)
    given = {"theta": meshes_of(scene.system, 24), "torques": TORQUES} | change
    if given.pop("scene", None):
        scene = dataclasses.replace(scene, compliance=None)
    with pytest.raises(fault, match=re.escape(words)) as refused:
        gj.torque_sweep(scene, given.pop("theta"), given.pop("torques"), **given)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_a_run_with_three_torques_shows_them_in_a_curve():
    scene = gj.load(ROOT / "configs" / "helical" / "blankenship_1995.toml")
    cases = list(run_cases(scene))
    sweep = against_torque(scene, cases)
    assert sweep is not None
    own = gj.torque_sweep(scene, scene.run.times[:-1] * float(scene.system.input_speed), np.array(scene.run.torques))
    np.testing.assert_allclose(sweep.harmonics, own.harmonics, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(sweep.mean, own.mean, rtol=1e-9)
    figure = torque_sweep_figure(sweep)
    labels = [ax.get_xlabel() for ax in figure.axes] + [ax.get_ylabel() for ax in figure.axes]
    assert all("[" in label for label in labels)
    assert len(figure.axes[0].lines) == 4
    assert against_torque(scene, cases[:2]) is None
    shorter = dataclasses.replace(scene, run=dataclasses.replace(scene.run, duration=0.7 * scene.run.duration))
    assert against_torque(shorter, list(run_cases(shorter))) is None


def test_a_record_after_which_run_outs_differ_warns():
    """After one mesh a run-out leaves a jump, whose harmonics are not those of the mesh; a whole cycle closes."""
    scene = relieved(8 * um)
    scene = dataclasses.replace(scene, errors=scene.errors | {"run_out": gj.Eccentricity("wheel", 20 * um, 0.3)})
    mesh = meshes_of(scene.system, 16)
    with pytest.warns(gj.UnclosedRecord, match="gaps differ by .* um: the harmonics contain the jump"):
        one = gj.torque_sweep(scene, mesh, TORQUES)
    turn = np.linspace(0.0, scene.system.cycle, 50 * 16, endpoint=False)
    whole, alone = gj.torque_sweep(scene, turn, TORQUES), gj.torque_sweep(relieved(8 * um), mesh, TORQUES)
    np.testing.assert_allclose(whole.harmonics[:, 0], alone.harmonics[:, 0], rtol=2e-2)
    assert (np.abs(one.harmonics[:, 0] / alone.harmonics[:, 0] - 1) > 0.1).any()


def test_without_an_equilibrium_there_are_no_harmonics():
    """A torque that pulls the teeth apart: nan, as its mean is."""
    pulled = relieved(8 * um)
    sweep = gj.torque_sweep(pulled, meshes_of(pulled.system, 12), jnp.array([100.0, -2.0]))
    assert np.isfinite(sweep.harmonics[0]).all()
    assert np.isnan(sweep.harmonics[1]).all()
