"""Monte Carlo studies against exact answers, against the analyses one by one, and at their limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import gearjax as gj
from gearjax.tolerance.monte_carlo import Work
from gearjax.units import arcmin, um
from tests.conftest import AMPLITUDES, BODIES, PHASES

MEASURES = ["no_load.peak_to_peak", "no_load.amplitude", "no_load.mean", "no_load.std", "no_load.maximum"]
MEASURES += ["backlash.minimum", "backlash.peak_to_peak", "static.peak_to_peak@30Nm", "static.std@300Nm"]
SHORT = {"n": 64, "chunk": 32}


def four_sigma(found: float, truth: float, error: float) -> None:
    assert abs(found - truth) < 4 * error


@pytest.mark.parametrize("sampler", ["monte_carlo", "latin_hypercube", "sobol"])
def test_a_linear_measure_of_normal_numbers(scene, sampler):
    spreads = {path: gj.Normal(20 * um, size * um) for path, size in zip(AMPLITUDES, (1.0, 2.0, 3.0, 4.0), strict=True)}

    def weighed(scene):
        return sum(i * scene.errors[body].amplitude for i, body in enumerate(BODIES, start=1))

    study = gj.monte_carlo(gj.Tolerances(scene, spreads), weighed, n=20_000, key=5, sampler=sampler)
    truth = stats.norm(200 * um, np.sqrt(1 + 16 + 81 + 256) * um)
    four_sigma(study.mean("weighed"), truth.mean(), truth.std() / np.sqrt(20_000))
    four_sigma(study.std("weighed"), truth.std(), truth.std() / np.sqrt(40_000))
    for level in (0.05, 0.5, 0.95):
        found = study.quantile("weighed", level)
        four_sigma(found.value, truth.ppf(level), (found.high - found.low) / 3.9)
        assert found.low < found.value < found.high
    four_sigma(study.share_within("weighed", 210 * um).value, truth.cdf(210 * um), 0.0035)


def test_correlated_numbers(scene):
    spreads = {path: gj.Normal(20 * um, 2 * um) for path in AMPLITUDES[:2]}
    both = gj.Tolerances(scene, spreads, [gj.Correlation(*AMPLITUDES[:2], coefficient=-0.6)])
    study = gj.monte_carlo(
        both, lambda s: {"sum": s.errors["planet_1"].amplitude + s.errors["planet_2"].amplitude}, n=20_000
    )
    four_sigma(study.std("sum"), 2 * um * np.sqrt(2 - 1.2), 2 * um * np.sqrt(0.8) / 200)
    values = both.values(np.random.default_rng(0).random((4000, 2)))
    assert np.corrcoef(values.T)[0, 1] == pytest.approx(-0.6, abs=0.05)
    for column in values.T:
        assert stats.kstest(column, stats.norm(20 * um, 2 * um).cdf).pvalue > 1e-4
    three = dict.fromkeys(AMPLITUDES[:3], gj.Normal(20 * um, um))
    first, second, third = AMPLITUDES[:3]
    pairs = [(first, second, 0.95), (second, third, 0.95), (first, third, -0.9)]
    with pytest.raises(gj.SceneError, match="contradict"):
        gj.Tolerances(scene, three, [gj.Correlation(*pair) for pair in pairs])


@pytest.mark.slow
def test_a_single_eccentricity_makes_rayleigh_transmission_errors(scene):
    # one planet wheel alone: the no-load TE of one error is a sine of its size, seen from the other pair's zero
    alone = dataclasses.replace(scene, errors={"revolution": scene.errors["revolution"]}, reference=None)
    alone = dataclasses.replace(alone, system=dataclasses.replace(alone.system, planets=1), backlash=None)
    tolerances = gj.Tolerances(alone, {"errors.revolution.amplitude": gj.Rayleigh(6 * um)})
    theta = np.linspace(0.0, alone.system.cycle, 801)
    study = gj.monte_carlo(tolerances, "no_load.peak_to_peak", n=10_000, theta=theta, sampler="sobol")
    per_metre = float(gj.transmission_error(alone, theta).peak_to_peak / alone.errors["revolution"].amplitude)
    truth = stats.rayleigh(0.0, 6 * um * per_metre)
    for level in (0.05, 0.5, 0.95):
        found = study.quantile("no_load.peak_to_peak", level)
        assert found.low - 2e-5 * found.value < truth.ppf(level) < found.high + 2e-5 * found.value


def test_yield_of_a_chi_square(scene):
    spreads = {path: gj.Normal(20 * um, 2 * um) for path in AMPLITUDES[:3]}

    def squares(scene):
        return sum(((scene.errors[body].amplitude - 20 * um) / (2 * um)) ** 2 for body in BODIES[:3])

    study = gj.monte_carlo(gj.Tolerances(scene, spreads), squares, n=40_000, sampler="sobol", key=2)
    truth = stats.chi2(3)
    for limit in (1.0, 2.4, 6.25):
        found = study.share_within("squares", limit)
        assert found.low - 0.001 < truth.cdf(limit) < found.high + 0.001
        assert found.high - found.low < 0.012


@pytest.mark.slow
@pytest.mark.parametrize("extremes", ["samples", "between"])
def test_samples_are_the_analyses_one_by_one(population, angles, extremes):
    study = gj.monte_carlo(population, MEASURES, n=12, theta=angles, extremes=extremes)
    work = Work(population, MEASURES, number=12, theta=angles)
    assert (study.result == 0).all()
    for index, row in enumerate(work.inputs(0, 12)):
        scene = population.with_values(jnp.asarray(row))
        analyses = {
            "no_load": gj.transmission_error(scene, angles),
            "static": gj.transmission_error(scene, angles, 30.0),
            "300": gj.transmission_error(scene, angles, 300.0),
            "backlash": gj.backlash(scene, angles),
        }
        curves = {name: np.asarray(a.backlash if name == "backlash" else a.te) for name, a in analyses.items()}
        for name in ("no_load.mean", "no_load.std", "static.std@300Nm"):
            key = "300" if "300" in name else "no_load"
            expected = curves[key].mean() if name.endswith("mean") else curves[key].std()
            assert study.column(name)[index] == pytest.approx(expected, abs=1e-15)
        for name, key in (("no_load.peak_to_peak", "no_load"), ("static.peak_to_peak@30Nm", "static")):
            sampled = np.ptp(curves[key])
            exact = float(analyses[key].peak_to_peak)
            expected = sampled if extremes == "samples" else exact
            within = 1e-15 if extremes == "samples" else 2e-3 * exact
            assert study.column(name)[index] == pytest.approx(expected, abs=within)
        exact = float(analyses["backlash"].extremes.minimum)
        within = 1e-15 if extremes == "samples" else 1e-5 * exact
        expected = curves["backlash"].min() if extremes == "samples" else exact
        assert study.column("backlash.minimum")[index] == pytest.approx(expected, abs=within)


@pytest.mark.slow
def test_close_extremes_are_exact_where_a_curve_has_one_kink(population, angles):
    work = Work(population, MEASURES[:1], number=200, theta=angles)
    inputs = work.inputs(0, 200)
    found, _ = work.evaluate(inputs)
    sampled, _ = Work(population, MEASURES[:1], number=200, theta=angles, extremes="samples").evaluate(inputs)
    exact = np.array(
        [float(gj.transmission_error(population.with_values(jnp.asarray(r)), angles).peak_to_peak) for r in inputs[:24]]
    )
    missed = (exact - found[:24, 0]) / exact
    assert missed.min() > -1e-9
    assert missed.mean() < 1e-3
    assert ((exact - sampled[:24, 0]) / exact).mean() > 4 * missed.mean()


@pytest.mark.slow
def test_chunks_and_functions_change_nothing(population, angles):
    options = {"theta": angles, "n": 100, "key": 3, "sampler": "latin_hypercube"}
    whole = gj.monte_carlo(population, MEASURES[:2], **options)
    parts = gj.monte_carlo(population, MEASURES[:2], chunk=16, **options)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-12)
    inputs = [Work(population, MEASURES[:1], number=100, chunk=c).inputs(40, 61).tobytes() for c in (16, 100)]
    assert inputs[0] == inputs[1]


@pytest.mark.slow
def test_a_chunk_compiles_once(population, angles):
    work = Work(population, MEASURES[:1], number=96, chunk=32, theta=angles)
    assert len(work.chunks) == 3
    for _ in work.each(work.chunks):
        pass
    assert [program._program._cache_size() for program in work._programs] == [1]


def test_functions_of_a_key():
    def sample(key):
        return jax.random.normal(key, (3,))

    def measure(x):
        return {"square": (x * x).sum(), "first": x[0]}

    study = gj.monte_carlo(sample, measure, n=4000, key=jax.random.key(1))
    again = gj.monte_carlo(sample, measure, n=4000, key=jax.random.key(1), chunk=64)
    assert study.names == ("first", "square")
    np.testing.assert_array_equal(study.values, again.values)
    four_sigma(study.mean("square"), 3.0, np.sqrt(6.0 / 4000))
    four_sigma(study.mean("first"), 0.0, np.sqrt(1.0 / 4000))


@pytest.mark.slow
def test_other_contact_laws_and_free_systems_take_the_analyses(scene, angles, with_contact):
    theta = angles[:101]
    soft = with_contact(scene, gj.QuadraticContact(1e-9))
    narrow = gj.Tolerances(soft, {AMPLITUDES[0]: gj.Rayleigh(6 * um)})
    hard = gj.Tolerances(scene, {AMPLITUDES[0]: gj.Rayleigh(6 * um)})
    found, expected = (gj.monte_carlo(p, MEASURES[:2], n=20, theta=theta).values for p in (narrow, hard))
    np.testing.assert_allclose(found, expected, rtol=5e-3)
    spread = {"system.working_pressure_angle": gj.Uniform(0.60, 0.63), AMPLITUDES[0]: gj.Rayleigh(6 * um)}
    system = gj.Tolerances(scene, spread)
    study = gj.monte_carlo(system, MEASURES[:1], n=8, theta=theta)
    rows = Work(system, MEASURES[:1], number=8, theta=theta).inputs(0, 8)
    for row, value in zip(rows, study.column(MEASURES[0]), strict=True):
        exact = gj.transmission_error(system.with_values(jnp.asarray(row)), theta).peak_to_peak
        assert value == pytest.approx(float(exact), rel=1e-9)


@pytest.mark.slow
def test_failed_samples_are_counted_and_the_others_untouched(scene, angles):
    theta = angles[:101]
    spreads = {AMPLITUDES[0]: gj.Normal(3 * um, 2 * um), PHASES[0]: gj.UniformPhase()}
    study = gj.monte_carlo(gj.Tolerances(scene, spreads), MEASURES[:1], n=1000, theta=theta)
    share = stats.norm.cdf(-1.5)
    four_sigma(len(study.failed) / 1000, share, np.sqrt(share / 1000))
    assert list(study.faults) == ["a number lies outside of what it may be"]
    assert np.isnan(study.column(MEASURES[0])[study.failed]).all()
    assert np.isfinite(study.good(MEASURES[0])).all()
    assert len(study.good(MEASURES[0])) == 1000 - len(study.failed)
    good = study.share_within(MEASURES[0], 100 * arcmin)
    assert good.value == pytest.approx(1 - len(study.failed) / 1000)

    def broken(s):
        return jnp.where(s.errors["planet_1"].phase > 0, jnp.nan, 1.0)

    half = gj.monte_carlo(gj.Tolerances(scene, {PHASES[0]: gj.UniformPhase()}), broken, n=1000)
    assert 400 < len(half.failed) < 600
    assert list(half.faults) == ["a measure is not finite"]


@pytest.mark.slow
def test_float32_shifts_quantiles_by_less_than_a_thousandth(population, angles):
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), population.scene)
    narrow = gj.Tolerances(single, population.distributions)
    names = ["no_load.peak_to_peak", "backlash.minimum", "static.peak_to_peak@100Nm"]
    for extremes in ("samples", "between"):
        options = {"n": 2000, "theta": angles, "extremes": extremes}
        double, short = (gj.monte_carlo(p, names, **options) for p in (population, narrow))
        for name in names:
            for level in (0.05, 0.5, 0.95):
                expected = double.quantile(name, level).value
                assert short.quantile(name, level).value == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_motions_of_a_population(scene):
    population = gj.Tolerances(scene, {AMPLITUDES[0]: gj.Rayleigh(6 * um), PHASES[0]: gj.UniformPhase()})
    theta = float(scene.system.input_speed) * np.linspace(0.0, 0.3, 301)
    study = gj.monte_carlo(population, "dynamic.peak_to_peak@100Nm", n=20, theta=theta)
    assert (study.result == 0).all()
    row = Work(population, "dynamic.std@100Nm", number=20, theta=theta).inputs(7, 8)[0]
    motion = gj.simulate(population.with_values(jnp.asarray(row)), np.linspace(0.0, 0.3, 301), 100.0)
    assert study.values[7, 0] == pytest.approx(float(motion.peak_to_peak), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("extremes", ["samples", "between"])
def test_motions_beside_quasi_static_measures_are_those_alone(scene, extremes):
    """Masses and loads of the motion that the curves do not need, and one that varies."""
    spreads = {AMPLITUDES[0]: gj.Rayleigh(6 * um), "inertia.mass": gj.Normal(3.0, 0.1)}
    theta = float(scene.system.input_speed) * np.linspace(0.0, 0.2, 201)
    names = ["no_load.peak_to_peak", "static.minimum@100Nm", "dynamic.peak_to_peak@100Nm", "backlash.std"]

    def values(names):
        return gj.monte_carlo(gj.Tolerances(scene, spreads), names, n=6, theta=theta, extremes=extremes).values

    alone = np.concatenate([values(name) for name in names], axis=1)
    assert np.isfinite(alone).all()
    np.testing.assert_allclose(values(names), alone, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda p: gj.monte_carlo(p, "no_load.peaktopeak", **SHORT), "did you mean"),
        (lambda p: gj.monte_carlo(p, "static.std", **SHORT), "needs a torque"),
        (lambda p: gj.monte_carlo(p, "no_load.std@3Nm", **SHORT), "takes no torque"),
        (lambda p: gj.monte_carlo(p, ["no_load.std", "no_load.std"], **SHORT), "listed twice"),
        (lambda p: gj.monte_carlo(p, [], **SHORT), "at least one"),
        (lambda p: gj.monte_carlo(p, "no_load.std", n=0), "must be at least 1"),
        (lambda p: gj.monte_carlo(p, "no_load.std", sampler="grid", **SHORT), "valid: monte_carlo"),
        (lambda p: gj.monte_carlo(p, "no_load.std", extremes="none", **SHORT), "valid: samples"),
        (lambda p: gj.Tolerances(p.scene, {"errors.planet_3.amplitude": gj.Rayleigh(1e-6)}), "no number"),
        (lambda p: gj.Tolerances(p.scene, {AMPLITUDES[0]: gj.Normal(-1e-6, 1e-7)}), "median"),
        (
            lambda p: gj.Tolerances(p.scene, {AMPLITUDES[0]: gj.Rayleigh(1e-6)}, [gj.Correlation("a", "b", 0.1)]),
            "toler",
        ),
        (lambda p: gj.monte_carlo(p.paths, lambda x: x), "sample"),
    ],
)
def test_mistakes_are_named(population, call, words):
    with pytest.raises(gj.GearjaxError, match=words):
        call(population)


@pytest.mark.slow
def test_one_input_angle_and_two(population):
    for number in (1, 2, 3):
        study = gj.monte_carlo(
            population, ["no_load.peak_to_peak", "no_load.std"], n=4, theta=np.linspace(1, 2, number)
        )
        assert (study.values[:, 0] == 0).all() == (number == 1)
        assert np.isfinite(study.values).all()


@pytest.mark.slow
def test_rare_values_are_right_and_strangers_told(scene, angles):
    rare = {path: gj.Rayleigh(6 * um) for path in AMPLITUDES[:3]} | dict.fromkeys(PHASES, gj.UniformPhase())
    rare[AMPLITUDES[3]] = gj.Discrete((0.0, 30 * um), (0.995, 0.005))
    tolerances = gj.Tolerances(scene, rare)
    work = Work(tolerances, "no_load.std", number=2000, theta=angles)
    rows = work.inputs(0, 2000)
    rows = rows[rows[:, tolerances.paths.index(AMPLITUDES[3])] > 0][:5]
    found, codes = work.evaluate(rows)
    assert (codes == 0).all()
    for row, value in zip(rows, found[:, 0], strict=True):
        exact = gj.transmission_error(tolerances.with_values(jnp.asarray(row)), angles).std
        assert value == pytest.approx(float(exact), rel=1e-9)
    narrow = gj.Tolerances(scene, rare | {AMPLITUDES[3]: gj.Uniform(0.0, 0.0)})
    assert narrow.paths == tolerances.paths
    strangers = Work(narrow, "no_load.std", number=10, theta=angles).evaluate(rows)
    assert (strangers[1] == 4).all()  # unlike all examples: not good
    assert np.isnan(strangers[0]).all()
