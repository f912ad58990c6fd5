"""An external gear in an internal one, against their curves written out apart from the package, as complex numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.geometry.internal_checks import faults, radial_assembly, tip_overlap
from gearjax.geometry.internal_pair import InternalPair, candidate_rolls
from gearjax.geometry.involute import inverse_involute, involute
from gearjax.units import deg, mm, um
from tests.internal_gears import Curves, pair_of, random_pair

FULL = {"shifts": (0.0, 0.0), "heights": (1.0, 1.0)}


@pytest.mark.slow
def test_gaps_are_those_of_the_curves(rng):
    """At points all over the flanks that face each other, far from the line of action too, within 0.01 nm."""
    seen = 0
    for pair in [pair_of(), *(random_pair(rng) for _ in range(6))]:
        curves = Curves(pair)
        middle = float(pair.space_of_roll(0.5 * (pair.path[0] + pair.path[1])))
        for step in range(-7, 8):
            space = middle + (step + rng.uniform()) * 2 * np.pi / pair.internal.teeth
            roll = pair.roll_of_space(jnp.asarray([space]))
            begin, end = pair.ends(roll)
            if not float(begin[0]) < float(end[0]):
                continue
            beyond = candidate_rolls(begin, end, 5)[0]
            points = pair.points(jnp.broadcast_to(roll, beyond.shape), beyond)
            tooth = curves.tooth_that_touches(space)
            for index in range(5):
                radius = float(pair.external.radius_at(points.roll[0][index]))
                gap = curves.gap(tooth, space, radius)
                assert float(points.gap[index]) == pytest.approx(gap, rel=1e-7, abs=1e-14)
                at_ring = float(pair.internal.radius_at(points.roll[1][index]))
                assert abs(curves.ring_point(space, at_ring) - curves.centre) == pytest.approx(radius, rel=1e-13)
                seen += 1
    assert seen > 300


def test_flanks_face_each_other_from_tip_to_tip(rng):
    for pair in (pair_of(), random_pair(rng)):
        curves = Curves(pair)
        space = float(pair.space_of_roll(0.5 * (pair.path[0] + pair.path[1]))) + rng.uniform(-0.05, 0.05)
        roll = pair.roll_of_space(jnp.asarray(space))
        begin, end = pair.ends(roll)
        tip = curves.ring_point(space, float(pair.internal.tip_radius))
        assert float(pair.external.radius_at(roll + begin)) == pytest.approx(abs(tip - curves.centre), rel=1e-13)
        assert float(pair.external.radius_at(roll + end)) == pytest.approx(float(pair.external.tip_radius), rel=1e-13)


@pytest.mark.slow
def test_the_published_pair():
    """Operating angle, contact ratio and gaps of nine teeth as the reference lists them."""
    pair = pair_of()
    assert float(pair.external.base_radius) == pytest.approx(64.3126 * mm, abs=5e-8)
    assert float(pair.operating_pressure_angle / deg) == pytest.approx(43.390, abs=5e-4)
    assert float(pair.tight_pressure_angle / deg) == pytest.approx(43.378, abs=5e-4)
    assert float(pair.tight_centre_distance / mm) == pytest.approx(1.49971, abs=5e-6)
    assert float(pair.contact_ratio) == pytest.approx(1.051, abs=5e-4)
    begin, end = pair.path
    roll = begin + 0.3417 * (end - begin) - jnp.arange(-4.0, 5.0) * (2 * jnp.pi / 236)
    points = pair.points(roll, candidate_rolls(*pair.ends(roll), 1)[:, 0])
    listed = [3.724, 1.829, 0.593, 0.033, 0.0, 0.153, 1.012, 2.646, 5.076]
    np.testing.assert_allclose(points.gap / um, listed, atol=6e-4)
    assert list(faults(pair)) == []
    assert tip_overlap(pair) == 0.0


def test_backlash_closes_at_the_tight_centre_distance(rng):
    """By both flanks of the curves: the tooth in its space touches on either side."""
    for _ in range(5):
        pair = random_pair(rng)
        assert float(pair.backlash) == pytest.approx(0.0, abs=1e-15)
        nearer = InternalPair(pair.external, pair.internal, pair.centre_distance - 5 * um)
        curves = Curves(nearer)
        space = float(rng.uniform(-0.1, 0.1))
        ahead, behind = curves.tooth_that_touches(space), -curves.tooth_that_touches(-space)
        assert float(nearer.backlash) == pytest.approx(curves.base[0] * (ahead - behind), rel=1e-6)
        assert float(nearer.backlash) > 0


@pytest.mark.parametrize("value", [1e-6, 1e-3, 0.02, 0.9, 1.79, 1.81, 6.0, 50.0])
def test_the_involute_function_is_turned_around(value):
    angle = inverse_involute(jnp.asarray(value))
    assert float(involute(angle)) == pytest.approx(value, rel=1e-12 + 1e-17 / value)
    slope = jax.grad(inverse_involute)(jnp.asarray(value))
    assert float(slope) == pytest.approx(1 / np.tan(float(angle)) ** 2, rel=1e-9)


@pytest.mark.slow
def test_gradients_of_gaps_are_those_of_differences():
    """With respect to centre distance, shifts, module and roll, away from and on the line of action."""

    def gaps(numbers):
        distance, own, other, module, roll = numbers
        pair = pair_of(shifts=(own, other), module=module, distance=distance)
        rolls = roll + jnp.arange(-3.0, 4.0) * (2 * jnp.pi / 236)
        return pair.points(rolls, candidate_rolls(*pair.ends(rolls), 1)[:, 0]).gap

    at = jnp.asarray([1.5 * mm, -0.4, 0.55028, 0.58 * mm, 0.352])
    slopes = jax.jit(jax.jacfwd(gaps))(at)
    back = jax.jit(jax.jacrev(gaps))(at)
    np.testing.assert_allclose(back, slopes, rtol=1e-9, atol=1e-16)
    value = jax.jit(gaps)
    for column, step in enumerate([1e-7, 1e-5, 1e-5, 1e-9, 1e-5]):  # long ones: gaps are small beside what they are of
        moved = np.zeros(5)
        moved[column] = step
        near, far = ((value(at + n * moved) - value(at - n * moved)) / (2 * n * step) for n in (1, 2))
        difference = (4 * near - far) / 3
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-6, atol=1e-9 * abs(difference).max())


@pytest.mark.slow
def test_single_precision_keeps_the_digits_of_gaps():
    """Gaps of micrometres beside radii of 64 mm."""
    pair = pair_of()
    roll = pair.path[0] + 0.4 * (pair.path[1] - pair.path[0]) + jnp.arange(-4.0, 5.0) * (2 * jnp.pi / 236)
    beyond = candidate_rolls(*pair.ends(roll), 1)[:, 0]
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (pair, roll, beyond))
    short = single[0].points(single[1], single[2]).gap
    assert short.dtype == jnp.float32
    np.testing.assert_allclose(short, pair.points(roll, beyond).gap, atol=2e-9)


@pytest.mark.parametrize(
    ("changed", "key", "words"),
    [
        ({"heights": (0.6328, 3.0)}, "internal_addendum", "tips of the ring"),
        ({"heights": (3.0, 1.0)}, "external_addendum", "pointed teeth"),
        ({"distance": 1.0 * mm}, "centre_distance", "must be above the difference of the base radii"),
        ({"heights": (0.05, 0.05)}, "centre_distance", "no path of contact"),
        # full teeth without shift cut each other where the difference is below some eight (books on internal gears)
        (FULL | {"teeth": (76, 80), "distance": 4 * 0.29 * mm}, "external_addendum", "tips cut into each other"),
    ],
)
def test_gears_that_do_not_fit_are_named(changed, key, words):
    found = list(faults(pair_of(**changed)))
    assert found
    assert any(key == name and words in text for name, _, text in found), found


def test_room_for_assembly_along_the_radius():
    """Short teeth of many teeth difference go in, long ones of few do not."""
    assert radial_assembly(pair_of((40, 80), heights=(0.6, 0.6), distance=11.6 * mm)) > 0
    assert radial_assembly(pair_of((77, 80), shifts=(0.0, 0.3), heights=(1.0, 1.0), distance=0.95 * mm)) < 0


def test_full_teeth_of_ten_teeth_difference_clear_each_other():
    assert tip_overlap(pair_of((70, 80), shifts=(0.0, 0.0), heights=(1.0, 1.0), distance=10 * 0.29 * mm)) == 0.0
