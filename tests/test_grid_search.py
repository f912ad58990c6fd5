"""Grid searches: the structured one against every combination, and the paper's own grid."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.studies import separable
from gearjax.studies.select import numbers, pick
from gearjax.units import arcmin, deg, mm, um
from tests import rv
from tests.conftest import ROOT

PHASES = [f"errors.{body}.phase" for body in ("planet_1", "planet_2", "revolution", "output_wheel")]


def window(scene, duration, spacing=1e-3):
    return scene.system.input_speed * jnp.linspace(0.0, duration, round(duration / spacing) + 1)


def three_planets(scene):
    errors = {**scene.errors, "planet_3": gj.Eccentricity("planet_3", 15 * um, 0.5)}
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, planets=3), errors=errors)


@pytest.mark.parametrize(
    ("metric", "planets", "levels"), [("peak_to_peak", 2, 4), pytest.param("amplitude", 3, 6, marks=pytest.mark.slow)]
)
def test_the_structured_search_is_the_brute_force_one(scene, metric, planets, levels):
    """Small grids, the same combinations judged one by one."""
    chosen = scene if planets == 2 else three_planets(scene)
    paths = PHASES if planets == 2 else [*PHASES[:2], "errors.planet_3.phase", "errors.output_wheel.phase"]
    theta = window(scene, 3.0, 0.03)
    step = 360 * deg / levels
    quick = gj.grid_search(f"no_load_{metric}", chosen, where=paths, step=step, theta=theta)
    slow = gj.grid_search(
        lambda s: getattr(gj.transmission_error(s, theta), metric), chosen, where=paths, step=step, theta=theta
    )
    assert quick.combinations == slow.combinations == slow.evaluated == levels**4
    assert quick.evaluated < slow.evaluated
    np.testing.assert_allclose(quick.objectives, slow.objectives, rtol=1e-12)
    assert quick.objective == quick.objectives[0] == quick.objectives.min()


@pytest.mark.slow
def test_every_combination_is_covered(scene):
    """Lowest and highest of each combination, in the order of the walk, against single evaluations."""
    theta = window(scene, 2.0, 0.01)
    free = pick(scene, PHASES)
    levels = tuple(np.arange(n) * 0.7 - 1.0 for n in (3, 4, 2, 3))
    contributions = separable.contributions(scene, free, tuple(jnp.asarray(axis) for axis in levels), theta)
    plan = separable.plan(contributions)
    assert plan.outer == (2, 3)
    assert plan.inner == ((0,), (1,))
    grid = separable.lay_out(contributions, plan, theta.size)
    walks = [separable.walk(grid.own, shift) for shift in grid.outer]
    low = np.stack([np.asarray(lowest) for lowest, _ in walks])
    high = np.stack([np.maximum(tops[0][:, None], tops[1][None, :]) for _, tops in walks])
    assert low.shape == high.shape == (6, 3, 4)
    for outer, (g, o) in enumerate(np.ndindex(2, 3)):
        for a, b in np.ndindex(3, 4):
            values = jnp.array([levels[0][a], levels[1][b], levels[2][g], levels[3][o]])
            te = np.asarray(gj.transmission_error(free.set(scene, values), theta).te)
            assert low[outer, a, b] == pytest.approx(te.min(), abs=1e-15)
            assert high[outer, a, b] == pytest.approx(te.max(), abs=1e-15)


@pytest.mark.slow
def test_other_leaves_and_functions(scene):
    """Amplitude budgets are not periodic; any function of a scene may be searched."""
    theta = window(scene, 3.0, 0.01)
    path = "errors.planet_2.amplitude"
    found = gj.grid_search(
        "static_peak_to_peak", scene, where=path, step=5 * um, bounds={path: (0.0, 20 * um)}, theta=theta, torque=100.0
    )
    levels = np.arange(5) * 5e-6
    values = [
        float(gj.transmission_error(pick(scene, path).set(scene, jnp.array([v])), theta, 100.0).peak_to_peak)
        for v in levels
    ]
    assert found.combinations == 5
    assert found.best[0] == levels[int(np.argmin(values))]
    assert found.objective == pytest.approx(min(values), rel=1e-12)
    quick = gj.grid_search(
        "no_load_amplitude",
        scene,
        where=[path, PHASES[0]],
        step={path: 5 * um, PHASES[0]: 30 * deg},
        bounds={path: (0.0, 20 * um)},
        theta=theta,
    )
    assert quick.combinations == 5 * 12


@pytest.mark.slow
@pytest.mark.parametrize(("name", "torque"), [("backlash_range", None), ("static_amplitude", 60.0)])
def test_bounds_keep_the_best_of_any_grid(scene, name, torque):
    """Bounded from samples and then judged: the same as all combinations one by one, with fewer judgements."""
    theta = window(scene, 15.8, 0.02)
    asked = {"where": PHASES[1:], "step": 30 * deg, "theta": theta, "keep": 5}
    quick = gj.grid_search(name, scene, torque=torque, **asked)
    result = "peak_to_peak" if torque is None else "amplitude"

    def loss(scene):
        found = gj.backlash(scene, theta) if torque is None else gj.transmission_error(scene, theta, torque)
        return getattr(found, result)

    slow = gj.grid_search(loss, scene, **asked)
    assert quick.evaluated < slow.evaluated == 12**3
    np.testing.assert_allclose(quick.objectives, slow.objectives, rtol=1e-12)
    np.testing.assert_allclose(quick.best, slow.best, atol=1e-12)


def test_paths(scene):
    assert set(PHASES) < set(numbers(scene))
    free = pick(scene, PHASES[0])
    assert free.periods == (2 * np.pi,)
    assert float(free.get(scene)[0]) == pytest.approx(np.pi / 2)
    assert pick(scene, "system.module").periods == (None,)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"where": "errors.planet_1.phas"}, 'did you mean "errors.planet_1.phase"?'),
        ({"where": "errors.planet_9.phase"}, "no number of this scene"),
        ({"where": [PHASES[0], PHASES[0]]}, "is listed twice"),
        ({"step": 0.0}, "must be a number above 0"),
        ({"step": 0.7}, "must divide the period"),
        (
            {"where": "backlash.initial", "step": 1e-4, "bounds": {"backlash.initial": (0.0, 1e-3)}},
            "does not depend on it",
        ),
        ({"where": "compliance.mean", "step": 1e6, "bounds": {"compliance.mean": (8e7, 9e7)}}, "does not depend on it"),
        (
            {"where": "compliance.mean", "step": 1e-3, "bounds": {"compliance.mean": (1e7, 1e8)}},
            "levels, more than 1e+08",
        ),
        ({"step": 0.1 * deg}, "combinations, more than 1e+08"),
        ({"where": "errors.planet_1.amplitude", "bounds": {"errors.planet_1.amplitude": (1.0, 0.0)}}, "lowest first"),
        ({"loss": "no_load_amplitud"}, 'did you mean "no_load_amplitude"?'),
        ({"loss": "static_std"}, "needs a torque"),
    ],
)
def test_mistakes(scene, keywords, words):
    asked = {"loss": "no_load_amplitude", "where": PHASES, "step": 60 * deg, **keywords}
    with pytest.raises(gj.ParameterError) as caught:
        gj.grid_search(asked.pop("loss"), scene, theta=window(scene, 1.0, 0.01), **asked)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_zero_amplitude_is_no_mistake(scene):
    """Its phase has no influence now, but it is modelled: every level of it is as good."""
    errors = {**scene.errors, "planet_1": gj.Eccentricity("planet_1", 0.0, 0.0)}
    still = dataclasses.replace(scene, errors=errors)
    theta = window(scene, 1.0, 0.01)
    found = gj.grid_search("no_load_amplitude", still, where=PHASES, step=60 * deg, theta=theta)
    others = gj.grid_search("no_load_amplitude", still, where=PHASES[1:], step=60 * deg, theta=theta)
    assert found.objective == pytest.approx(others.objective, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("duration", "objective", "phases"), [(15.8, 0.633498, (-70, 120, 110, 40)), (3.0, 0.286055, (-120, 80, 10, 160))]
)
def test_the_grid_of_the_paper(scene, duration, objective, phases):
    """All 36^4 combinations: the paper's optimum is the exact one over 15.8 s, another one over 3 s."""
    words = []
    found = gj.grid_search(
        "no_load_amplitude", scene, where=PHASES, step=10 * deg, theta=window(scene, duration), progress=words.append
    )
    assert found.combinations == 1_679_616
    assert found.objective / arcmin == pytest.approx(objective, abs=2e-6)
    np.testing.assert_allclose(found.best / deg, phases, atol=1e-9)
    assert words[0].startswith("grid of 1679616 combinations")
    if duration == 15.8:
        np.testing.assert_allclose(found.objectives[1:3] / arcmin, 0.633540, atol=2e-6)


def of_pins(random) -> gj.Scene:
    """An RV reducer of five pins whose errors are drawn."""
    small = {"pins": 5, "pin_circle": 20 * mm, "pin_radius": 2 * mm, "eccentricity": 1.2 * mm}
    errors = {
        "throw": gj.Eccentricity("throw", random.uniform(1, 4) * um, random.uniform(-3, 3)),
        "disc": gj.Eccentricity("disc_1", random.uniform(1, 4) * um, random.uniform(-3, 3)),
        "pins": gj.Positions("pin_ring", random.normal(0, 2 * um, 5), []),
    }
    return gj.Scene(rv.system(**small), errors, compliance=rv.LINEAR)


SMALL = np.linspace(0.0, 6.0, 25)
NUMBERS = {  # of each kind: a phase, an amplitude, one of a series, one of the system; levels apart, and bounds
    "errors.throw.phase": (90 * deg, None),
    "errors.disc.amplitude": (2 * um, (0.0, 4 * um)),
    "errors.pins.outward[0]": (3 * um, (-3 * um, 3 * um)),
    "system.isometric_modification": (2 * um, (-23 * um, -19 * um)),
}


def one_by_one(scene, paths, levels, curve, metric):
    """Objectives of all combinations by the analyses themselves, the order as by `itertools.product`."""
    points = np.array(list(itertools.product(*levels)))
    free = pick(scene, paths)
    judge = jax.jit(lambda point: getattr(curve(free.set(scene, point)), metric))
    return points, np.array([float(judge(jnp.asarray(point))) for point in points])


@pytest.mark.parametrize(
    ("name", "torque"),
    [
        ("no_load_amplitude", None),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("no_load_peak_to_peak", None), ("static_peak_to_peak", 20.0), ("backlash_range", None))
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")  # the search and what it is held against see the same ones
def test_contacts_that_touch_either_flank_are_searched_exactly(name, torque, rng):
    """Numbers of every kind, random errors: what the bound leaves out was worse."""

    def curve(scene):
        return gj.backlash(scene, SMALL) if name == "backlash_range" else gj.transmission_error(scene, SMALL, torque)

    scene = of_pins(rng)
    paths = list(NUMBERS)
    found = gj.grid_search(
        name,
        scene,
        where=paths,
        step={path: step for path, (step, _) in NUMBERS.items()},
        bounds={path: ends for path, (_, ends) in NUMBERS.items() if ends},
        theta=SMALL,
        torque=torque,
        keep=7,
    )
    levels = [
        np.arange(-180, 180, 90) * deg if ends is None else np.arange(ends[0], ends[1] + 0.5 * step, step)
        for step, ends in NUMBERS.values()
    ]
    points, objectives = one_by_one(scene, paths, levels, curve, "amplitude" if "ampl" in name else "peak_to_peak")
    order = np.argsort(objectives, kind="stable")
    assert found.combinations == len(points) == 4 * 3**3
    np.testing.assert_allclose(found.objectives, objectives[order[:7]], rtol=1e-9)
    place = np.flatnonzero(np.isclose(objectives, objectives.min(), rtol=1e-9))
    assert np.isclose(points[place], found.best, atol=1e-12).all(axis=1).any()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")  # the search and what it is held against see the same ones
def test_single_pins_of_a_shipped_reducer_and_phases_of_both_discs():
    scene = gj.load(ROOT / "configs" / "rv_cycloidal" / "hu_2020.toml")
    theta = jnp.linspace(0.0, 6.2, 101)
    paths = ["errors.disc_1.phase", "errors.disc_2.phase"]
    found = gj.grid_search("no_load_amplitude", scene, where=paths, step=60 * deg, theta=theta, keep=3)
    free = pick(scene, paths)
    judge = jax.jit(lambda point: gj.transmission_error(free.set(scene, point), theta).amplitude)
    each = [float(judge(jnp.asarray(p))) for p in itertools.product(np.arange(-180, 180, 60) * deg, repeat=2)]
    np.testing.assert_allclose(found.objectives, np.sort(each)[:3], rtol=1e-9)
    assert found.evaluated < 36
