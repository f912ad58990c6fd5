"""Torsional stiffness of gear sets: hand springs, differences of two loads, supports in series, gradients, limits."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.plot import stiffness_figure
from gearjax.units import mm, um
from tests import rv
from tests.involute import system
from tests.test_supports import Bearings, pair, planets, reducer
from tests.trains import on_bearings, train

TORQUE = 40.0
THETA = np.linspace(0.3, 6.0, 5)
ELASTIC = gj.ElasticTeeth(206e9, 0.3, 6.5 * mm, 14 * mm, rim=0.8 * mm)
LINEAR = gj.HarmonicStiffness(2e8, [0.1], [0.0])


def involute(compliance=ELASTIC, **changes) -> gj.Scene:
    """The pair of Yang, Tang and Liang (2019) with seven candidates, on driving flanks alone."""
    errors = {"run_out": gj.Eccentricity("gear_1", 2 * um, 0.4)}
    return gj.Scene(system(pairs=9), errors, compliance=compliance, **changes)


def by_hand(scene: gj.Scene, te: gj.TransmissionError, stiffness: float) -> np.ndarray:
    """Sum of k r^2 over the contacts that carry, shape (n,) [N m/rad]."""
    levers = jax.vmap(lambda angle: scene.contacts(angle).lever)(te.theta)
    return (stiffness * np.asarray(levers) ** 2 * np.asarray(te.forces > 0)).sum(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["two_kv", "involute_rv"])
def test_the_tangent_of_linear_springs_is_the_sum_of_those_that_carry(kind):
    scene = gj.load("configs/two_kv/wang_2020.toml") if kind == "two_kv" else involute(LINEAR)
    theta = np.linspace(0.0, scene.system.cycle / 7, 40)
    found = gj.mesh_stiffness(scene, theta, TORQUE)
    te = gj.transmission_error(scene, theta, TORQUE, extremes="samples")
    free = gj.transmission_error(scene, theta, extremes="samples")
    assert len(set(np.asarray(te.engaged).tolist())) > 1
    expected = by_hand(scene, te, float(scene.linear_compliance.mean_stiffness(1)[0]))
    np.testing.assert_allclose(found.tangent, expected, rtol=1e-12)
    np.testing.assert_allclose(found.lag, free.te - te.te, rtol=1e-12)
    np.testing.assert_allclose(found.secant, TORQUE / (free.te - te.te), rtol=1e-9)
    assert bool((found.secant <= found.tangent * (1 + 1e-9)).all())
    assert (np.asarray(found.result) == 0).all()
    lowest, highest = expected.min(), expected.max()
    assert float(found.ripple) == pytest.approx((highest - lowest) / expected.mean(), rel=1e-12)


SCENES = {
    "involute": involute,
    "planets on supports": planets,
    "train": train,
    "coupled on supports": pair,
    "line contacts": lambda: rv.scene(discs=1, compliance=rv.HERTZ, with_errors=True),
    "line contacts on supports": lambda: reducer(compliance=rv.HERTZ),
    "train on bearings": on_bearings,
    "displaced discs": lambda: rv.scene(discs=1, with_errors=True, clearance="exact"),
}
QUICK = ("involute", "planets on supports", "train")
STEP = {"line contacts on supports": 0.02, "displaced discs": 1.0}  # N m, of the difference; where lines bend, small


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_the_tangent_is_the_difference_of_two_loads(name):
    scene, step = SCENES[name](), STEP.get(name, 0.1)
    found = gj.mesh_stiffness(scene, THETA, TORQUE)
    above, below = (gj.transmission_error(scene, THETA, TORQUE + way, extremes="samples") for way in (step, -step))
    same = ((above.forces > 0) == (below.forces > 0)).all(axis=1)
    assert int(same.sum()) >= 3
    expected = 2 * step / (below.te - above.te)
    np.testing.assert_allclose(found.tangent[same], expected[same], rtol=1e-6)


@pytest.mark.slow
def test_supports_are_springs_in_series():
    """Of one pair of teeth: 1 / k and the parts of both directions of both wheels."""
    stiffness, compliance = {"x": 1e8, "y": 3e8, "wheel": 2e8}, gj.HarmonicStiffness(1.5e8, [], [])
    scene = pair(pairs=1, compliance=compliance)
    assert isinstance(scene.system, Bearings)
    sine, cosine = np.sin(scene.system.pressure_angle), np.cos(scene.system.pressure_angle)
    soft = 1 / 1.5e8 + sine**2 / stiffness["x"] + cosine**2 / stiffness["y"] + cosine**2 / stiffness["wheel"]
    for torque in (TORQUE, -TORQUE):
        found = gj.mesh_stiffness(scene, THETA, torque)
        np.testing.assert_allclose(found.tangent, (30 * mm) ** 2 / soft, rtol=1e-12)
        np.testing.assert_allclose(found.secant, found.tangent, rtol=1e-9)
        assert (np.sign(found.lag) == np.sign(torque)).all()
    nothing = gj.mesh_stiffness(scene, THETA, 0.0)
    np.testing.assert_allclose(nothing.tangent, (30 * mm) ** 2 / soft, rtol=1e-9)


@pytest.mark.slow
def test_a_torque_of_zero_is_the_first_contact_alone():
    scene = involute()
    nothing = gj.mesh_stiffness(scene, THETA, 0.0)
    slight = gj.mesh_stiffness(scene, THETA, 1e-6)
    np.testing.assert_allclose(nothing.tangent, slight.tangent, rtol=1e-12)
    np.testing.assert_array_equal(nothing.secant, nothing.tangent)
    np.testing.assert_array_equal(nothing.lag, 0.0)
    np.testing.assert_allclose(slight.secant, slight.tangent, rtol=1e-5)  # the lag is some 1e-14 of 1e-5 rad
    mixed = gj.mesh_stiffness(scene, THETA[:2], np.array([0.0, TORQUE]))
    assert float(mixed.secant[0]) == pytest.approx(float(nothing.secant[0]), rel=1e-12)
    assert float(mixed.secant[1]) > 2 * float(mixed.secant[0])
    np.testing.assert_array_equal(mixed.torque, [0.0, TORQUE])


@pytest.mark.slow
def test_a_torque_reversed_loads_the_mirror_image():
    """At the start the throw points at a space of the ring: driving and back flanks are each other's mirror image."""
    scene = dataclasses.replace(involute(LINEAR, backlash=gj.InitialBacklash(10 * um)), errors={})
    ahead, behind = (gj.mesh_stiffness(scene, np.zeros(1), torque) for torque in (TORQUE, -TORQUE))
    assert float(behind.tangent[0]) == pytest.approx(float(ahead.tangent[0]), rel=1e-12)
    assert float(behind.secant[0]) == pytest.approx(float(ahead.secant[0]), rel=1e-9)
    assert float(behind.lag[0]) == pytest.approx(-float(ahead.lag[0]), rel=1e-9)


@pytest.mark.slow
def test_jammed_bodies_give_way_about_where_they_rest():
    """Of pins that overlap whatever the position, all of them are springs without torque already."""
    scene = rv.scene("modified", discs=1, with_errors=True)
    theta = THETA[:2]
    assert bool(gj.interference(scene, theta).interferes.all())
    found = gj.mesh_stiffness(scene, theta, 1e-3)
    rest, under = (gj.transmission_error(scene, theta, torque, extremes="samples").te for torque in (0.0, 1e-3))
    np.testing.assert_allclose(found.lag, rest - under, rtol=1e-6)
    np.testing.assert_allclose(found.secant, found.tangent, rtol=1e-6)


def loss(scene: gj.Scene, values: jax.Array) -> jax.Array:
    """Secant and tangent of numbers of the gears, the material and the torque."""
    own = eqx.tree_at(
        lambda s: (s.compliance.youngs_modulus, s.errors["run_out"].amplitude, s.system.external_shift),
        scene,
        (values[0] * 206e9, values[1] * 2 * um, -0.4 * values[2]),
    )
    found = gj.mesh_stiffness(own, THETA, TORQUE * values[3])
    return jnp.concatenate([found.secant, found.tangent]) / 1e6


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap():
    scene, ones, step = involute(), jnp.ones(4), 1e-5
    many = jnp.stack([ones, ones.at[1].set(2.0)])

    @jax.jit
    @jax.vmap
    def both(values):
        """Values and slopes, by one program."""
        found, back = jax.vjp(lambda values: loss(scene, values), values)
        return found, jax.vmap(back)(jnp.eye(len(found)))[0]

    values, slopes = both(many)
    for number in range(4):
        way = step * jnp.eye(4)[number][None]
        expected = (both(many + way)[0] - both(many - way)[0]) / (2 * step)
        np.testing.assert_allclose(
            slopes[:, :, number], expected, rtol=1e-6, atol=1e-6 * float(jnp.abs(expected).max())
        )
    np.testing.assert_allclose(values[1], loss(scene, many[1]), rtol=1e-9)


@pytest.mark.parametrize("name", ["two_kv", pytest.param("exact", marks=pytest.mark.slow)])
def test_gradients_in_the_torque_and_in_an_error(name):
    """Of exact geometry levers turn with the output: the tangent changes with the torque, contacts or not."""
    scene = gj.load("configs/two_kv/wang_2020.toml") if name == "two_kv" else SCENES["displaced discs"]()
    error = "planet_1" if name == "two_kv" else "run_out_1"

    def values(numbers):
        own = eqx.tree_at(lambda s: s.errors[error].amplitude, scene, numbers[1] * um)
        found = gj.mesh_stiffness(own, THETA[1:2], numbers[0])
        return jnp.stack([found.secant[0], found.tangent[0]])

    at, ways = jnp.array([TORQUE, 2.0]), (jnp.array([1e-2, 0.0]), jnp.array([0.0, 1e-3]))
    along = jax.jit(lambda at, way: jax.jvp(values, (at,), (way,)))  # one program of values and slopes
    for way in ways:
        slope = along(at, way)[1]
        difference = (along(at + way, way)[0] - along(at - way, way)[0]) / 2
        rounding = 1e-11 * float(along(at, way)[0].max())  # of lines that are laid anew twice
        np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=rounding)
    if name == "exact":
        assert abs(float(slope[1])) > 100 * rounding


def test_what_is_lacking_is_refused_in_one_line(scene):
    bare = dataclasses.replace(scene, compliance=None)
    for own, torque, words in (
        (bare, TORQUE, r'"mesh stiffness" needs \[compliance\], which this scene does not list'),
        (dataclasses.replace(scene, backlash=None), -TORQUE, r"loads the back flanks, which this scene lacks"),
        (scene, np.ones(3), "torque has shape"),
    ):
        with pytest.raises(gj.SceneError, match=words) as caught:
            gj.mesh_stiffness(own, THETA, torque)
        assert "\n" not in str(caught.value)


def test_no_equilibrium_is_told_where_nothing_can_be_raised(scene):
    one = dataclasses.replace(scene, backlash=None)
    found = jax.jit(lambda torque: gj.mesh_stiffness(one, THETA, torque))(-TORQUE)
    assert (np.asarray(found.result) == 1).all()
    assert np.isnan(found.tangent).all()
    assert np.isnan(found.secant).all()


def test_the_figure_has_units(scene):
    found = gj.mesh_stiffness(scene, THETA, TORQUE)
    (ax,) = stiffness_figure(found).axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("input angle [deg]", "stiffness [N m/arcmin]")
    assert "40 N m" in ax.get_title()
    drawn = {line.get_label().partition(":")[0]: line.get_ydata() for line in ax.get_lines()}
    np.testing.assert_allclose(drawn["tangent"], found.tangent * gj.units.arcmin)
    np.testing.assert_allclose(drawn["secant"], found.secant * gj.units.arcmin)
