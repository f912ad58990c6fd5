"""Searches and populations of involute RV reducers whose teeth share the load: derivatives, evenness, quick curves."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.studies.objective import Objective
from gearjax.studies.select import pick
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.measures import Measures
from gearjax.units import mm, um
from tests.involute import STEEL, angle_of, system

TEETH = gj.ElasticTeeth(**STEEL, rim=0.8 * mm)


def designed(numbers) -> gj.Scene:
    """A reducer of a profile shift, an amount of relief and a tooth's place."""
    shift, relief, tooth = numbers
    own = system(pairs=9, profile_points=3, external_shift=shift)
    places = jnp.zeros(236).at[16].set(tooth)
    errors = {
        "tip": gj.TipRelief(body="gear_1", amount=relief[None], length=0.3 * mm),
        "pitch": gj.Positions(body="gear_1", outward=jnp.zeros(0), around=places),
    }
    return gj.Scene(own, errors, compliance=TEETH)


@pytest.mark.slow
def test_gradients_of_load_peaks_and_error_are_those_of_differences():
    """With respect to shift, relief, a tooth's place and torque, in one program; away from where contacts open."""
    theta = jnp.sort(jnp.asarray([angle_of(system(), share) for share in (0.7, 0.2)]))

    def told(numbers):
        found = gj.transmission_error(designed(numbers[:3]), theta, torque=numbers[3])
        pairs = found.layout.per_pair(found.forces)
        return jnp.append(found.te * 1e6, jnp.sort(pairs.ravel())[-1])  # the peak of the loads

    at = jnp.asarray([-0.4, 0.5 * um, 0.5 * um, 100.0])
    value, slopes = jax.jit(told), jax.jit(jax.jacrev(told))(at)
    for column, step in enumerate([1e-7, 1e-9, 1e-9, 1e-2]):
        way = np.zeros(4)
        way[column] = step
        near, far = ((value(at + size * way) - value(at - size * way)) / (2 * size * step) for size in (1, 2))
        difference = (4 * near - far) / 3
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-6, atol=1e-6 * np.abs(difference).max())


@pytest.mark.slow
def test_the_slope_is_one_sided_where_a_contact_opens():
    """At the torque at which one more point begins to carry: between changes the error is a straight line of it."""
    own = system(pairs=9, profile_points=3)
    scene = gj.Scene(own, compliance=TEETH)
    theta = jnp.asarray([angle_of(own, 0.4)])

    def error(torque):
        return gj.transmission_error(scene, theta, torque=torque).te[0] * 1e6

    value, slope = jax.jit(error), jax.jit(jax.grad(error))
    carry = jax.jit(lambda torque: (gj.transmission_error(scene, theta, torque=torque).forces > 0).sum())
    low, high = 60.0, 100.0
    before = int(carry(low))
    assert int(carry(high)) > before
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if int(carry(middle)) == before else (low, middle)
    step = 1e-3
    sides = float(value(low) - value(low - step)) / step, float(value(high + step) - value(high)) / step
    assert abs(sides[1] / sides[0] - 1) > 1e-4  # there is a kink
    assert float(slope(low - step)) == pytest.approx(sides[0], rel=1e-6)
    assert float(slope(high + step)) == pytest.approx(sides[1], rel=1e-6)
    at_kink = float(slope(high))
    assert min(abs(at_kink / side - 1) for side in sides) < 1e-6  # one of them, and nothing between


@pytest.mark.slow
@pytest.mark.parametrize(
    ("springs", "shares"),
    [(TEETH, (1e-3, 0.1)), (gj.HarmonicStiffness(2e8, [], []), (0.1, 1.0))],
    ids=["coupled", "linear"],
)
def test_load_sharing_is_an_objective(springs, shares):
    """Largest load of a pair over the mean of those that could carry: what the analysis tells, and no angle; of linear
    springs too smoothing does not spread the load."""
    scene = dataclasses.replace(designed(jnp.asarray([-0.4, 0.5 * um, 0.0])), compliance=springs)
    theta = jnp.linspace(0.0, 0.02, 5)
    objective = Objective.of("static_load_sharing", scene, theta, 100.0)
    known = float(gj.transmission_error(scene, theta, torque=100.0).load_sharing.max())
    physics = scene.physics("compliance")
    assert float(jax.jit(lambda scene: objective.hard(scene))(physics)) == pytest.approx(known, rel=1e-12)
    for share in shares:
        near = float(jax.jit(lambda scene, share: objective.smooth(scene, share))(physics, share))
        assert known < near < known + share * np.log(5 * 9)
    with pytest.raises(gj.GearjaxError, match="needs a torque"):
        Objective.of("static_load_sharing", scene, theta)


@pytest.mark.slow
def test_flanks_are_modified_for_even_loads():
    """Relief and slope by gradients from four designs: a more even load than as given, judged by the analysis."""
    scene = designed(jnp.asarray([-0.4, 0.5 * um, 0.0]))
    scene = dataclasses.replace(
        scene, errors=scene.errors | {"slope": gj.ProfileSlope(body="gear_1", slope=jnp.asarray([0.0]))}
    )
    bounds = {"errors.tip.amount[0]": (0.0, 3 * um), "errors.slope.slope[0]": (-2 * um, 2 * um)}
    theta = np.linspace(0.0, 2 * np.pi / scene.system.orders["mesh"], 8, endpoint=False)
    found = gj.minimise(
        "static_load_sharing", scene, where=list(bounds), bounds=bounds, starts=4, theta=theta, torque=100.0, steps=15,
        polish_steps=6,
    )  # fmt: skip
    best = pick(scene, list(bounds)).set(scene, jnp.asarray(found.best))
    known = [gj.transmission_error(each, theta, torque=100.0).load_sharing.max() for each in (scene, best)]
    assert found.objective == pytest.approx(float(known[1]), rel=1e-9)
    assert known[1] < 0.98 * known[0]


@pytest.mark.slow
def test_a_population_of_coupled_teeth_is_measured_as_its_analyses_do():
    """Random run-outs and a backlash: each member's loaded error is that of the public function."""
    errors = {"ring": gj.Eccentricity(body="ring", amplitude=3 * um, phase=1.0)}
    backlash = gj.InitialBacklash(initial=30 * um)
    scene = gj.Scene(system(pairs=9, profile_points=3), errors, backlash=backlash, compliance=TEETH)
    varied = {
        "errors.ring.amplitude": gj.Uniform(1 * um, 6 * um),
        "errors.ring.phase": gj.UniformPhase(),
        "backlash.initial": gj.Uniform(10 * um, 40 * um),
    }
    theta = np.linspace(0.0, 0.05, 7)
    named = [Measure.named(name) for name in ("static.peak_to_peak@100Nm", "static.mean@-40Nm")]
    measures = Measures(named, gj.Tolerances(scene, varied), theta, "samples")
    assert measures.pressed is not None  # the quick way is what is tested
    rows = jnp.asarray([[2 * um, 0.3, 15 * um], [5 * um, 4.0, 35 * um]])
    found, codes = jax.jit(measures.rows)(rows)
    assert not np.asarray(codes).any()
    for row, mine in zip(rows, found, strict=True):
        member = pick(scene, list(varied)).set(scene, row)
        te = [gj.transmission_error(member, theta, torque=torque) for torque in (100.0, -40.0)]
        np.testing.assert_allclose(mine, [te[0].extremes.maximum - te[0].extremes.minimum, te[1].mean], rtol=1e-10)
