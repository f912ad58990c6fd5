"""The side and the pair of each contact stand in its layout: any order of contacts gives the same results."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.typing import Array, Scalar
from tests.test_matrix import KINDS, Case


class Shuffled(gj.AbstractSystem):
    """A gear set whose contacts stand in another order: the last one first, then the first, and so on."""

    kind: ClassVar[str] = "shuffled"
    system: gj.TwoKV
    input_speed: Array

    @property
    def bodies(self) -> tuple[str, ...]:
        return self.system.bodies

    @property
    def orders(self) -> Mapping[str, float]:
        return self.system.orders

    @property
    def cycle(self) -> float:
        return self.system.cycle

    def order(self, request: gj.Request) -> np.ndarray:
        number = len(self.system.layout(request).side)
        return np.argsort([(3 * place + 2) % 5 for place in range(number)])

    def layout(self, request: gj.Request) -> gj.Layout:
        inner, order = self.system.layout(request), self.order(request)
        return gj.Layout(tuple(inner.side[i] for i in order), tuple(inner.pair[i] for i in order))

    def pose(self, theta: Scalar, request: gj.Request) -> gj.Pose:
        order = self.order(request)
        seen = self.system.pose(theta, request)
        views = jax.tree.map(lambda leaf: leaf[order], seen.views)
        return gj.Pose(theta, seen.jacobian[order], seen.gap[order], views, seen.mesh_angle)


def shuffled(scene: gj.Scene) -> gj.Scene:
    return dataclasses.replace(scene, system=Shuffled(scene.system, scene.system.input_speed))


def back_in_order(scene: gj.Scene, forces: Array) -> Array:
    """Forces of the shuffled gear set in the order of its own."""
    order = scene.system.order(gj.Request(back=scene.backlash is not None))
    return forces[:, np.argsort(order)]


def test_the_shuffled_order_is_another_one(scene):
    sides = shuffled(scene).layout.side
    assert sides not in {(1, 1, -1, -1), (-1, -1, 1, 1)}
    assert sorted(sides) == [-1, -1, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("law", [gj.HardContact(), gj.QuadraticContact(1e-7)])
def test_quasi_static_results_do_not_depend_on_the_order(scene, law):
    scene = dataclasses.replace(scene, contact=law)
    other, theta = shuffled(scene), np.linspace(0.0, 59.7, 61)
    for torque in (None, 100.0, -40.0):
        one, same = (gj.transmission_error(each, theta, torque) for each in (scene, other))
        np.testing.assert_allclose(same.te, one.te, rtol=1e-12, atol=1e-17)
        if torque is not None:
            np.testing.assert_allclose(back_in_order(other, same.forces), one.forces, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(same.load_sharing, one.load_sharing, rtol=1e-9)
    one, same = (gj.backlash(each, theta) for each in (scene, other))
    np.testing.assert_allclose(same.upper - same.lower, one.upper - one.lower, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("stepper", [None, gj.FixedStep(1e-5, solver=gj.RungeKutta4())], ids=["fitted", "Runge-Kutta"])
def test_motions_do_not_depend_on_the_order(scene, stepper):
    """Across the backlash and back, with dampers that act while either flank of a pair is closed."""
    scene = dataclasses.replace(scene, load=gj.SinusoidalLoad("crank"))
    other, ts = shuffled(scene), np.linspace(0.0, 0.02, 41)
    one, same = (gj.simulate(each, ts, 100.0, stepper=stepper) for each in (scene, other))
    np.testing.assert_allclose(same.te, one.te, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(back_in_order(other, same.forces), one.forces, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_populations_do_not_depend_on_the_order(scene):
    other, theta = shuffled(scene), np.linspace(0.0, scene.system.cycle, 201)
    spread = {"errors.planet_1.phase": gj.UniformPhase(), "errors.planet_2.amplitude": gj.Uniform(2e-6, 9e-6)}
    measures = ["no_load.peak_to_peak", "backlash.minimum", "static.mean@100Nm"]
    one, same = (
        gj.monte_carlo(gj.Tolerances(each, spread), measures, n=16, theta=theta, extremes="samples").values
        for each in (scene, other)
    )
    np.testing.assert_allclose(same, one, rtol=1e-12)


def test_a_layout_says_what_it_is_given():
    flanks, pins = gj.Layout.of_flanks(2, back=True), gj.Layout.either(3)
    assert (flanks.side, flanks.pair) == ((1, 1, -1, -1), (0, 1, 0, 1))
    assert (flanks.teeth, flanks.members) == (2, ((0, 2), (1, 3)))
    assert (flanks.has_back, flanks.sides_turn, pins.has_back, pins.sides_turn) == (True, False, True, True)
    assert not gj.Layout.of_flanks(2, back=False).has_back
    mixed = gj.Layout((-1, 1, 1, -1), (1, 0, 1, 0))
    np.testing.assert_array_equal(mixed.per_contact(jnp.asarray([5.0, 7.0])), [7.0, 5.0, 7.0, 5.0])
    np.testing.assert_array_equal(mixed.per_pair(jnp.asarray([1.0, 2.0, 3.0, 4.0])), [6.0, 4.0])
    np.testing.assert_array_equal(np.arange(4)[mixed.on(-1)], [0, 3])


@pytest.mark.parametrize(
    ("side", "pair", "words"),
    [
        ((1,), (0, 1), "1 sides and 2 pairs"),
        ((), (), "0 sides"),
        ((1, 0), (0, 1), "or 0 for all"),
        ((1, 1, -1), (0, 1, 0), "1 to 2 contacts"),
    ],
)
def test_layouts_that_cannot_be(side, pair, words):
    with pytest.raises(ValueError, match=words):
        gj.Layout(side, pair)


def test_contacts_across_a_face_share_the_stiffness_of_their_pair():
    whole = gj.Layout((1, 1, 1, 1), (0, 0, 1, 1), across=2)
    np.testing.assert_array_equal(whole.per_contact(whole.apiece(jnp.asarray([6.0, 8.0]))), [3.0, 3.0, 4.0, 4.0])
    with pytest.raises(ValueError, match="across = 3: must divide the 2 contacts"):
        gj.Layout((1, 1, 1, 1), (0, 0, 1, 1), across=3)


@pytest.mark.slow
def test_points_across_the_face_of_an_involute_reducer_change_no_stiffness():
    """At rest and in motion, as they all touch at once."""
    scene = Case("involute_rv", *KINDS).moved
    one, three = (
        dataclasses.replace(scene, system=dataclasses.replace(scene.system, face_points=points), run=None)
        for points in (1, 3)
    )
    theta, ts = np.linspace(0.0, 0.1, 11), np.linspace(0.0, 0.01, 21)
    rest = [np.asarray(gj.transmission_error(each, theta, 20.0).te) for each in (one, three)]
    np.testing.assert_allclose(rest[1], rest[0], rtol=1e-9)
    motion = [np.asarray(gj.simulate(each, ts, 20.0).te) for each in (one, three)]
    np.testing.assert_allclose(motion[1], motion[0], rtol=1e-9)
