"""Metrics, extremes between samples, and order spectra, against exact values."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.extremes import extremes
from gearjax.analysis.metrics import load_sharing_factor
from gearjax.units import arcmin


def kinked(shift, angle):
    """The larger of two sines: its lowest points are kinks."""
    return jnp.maximum(jnp.sin(angle), 0.7 * jnp.cos(angle + shift))


def exact_minimum(shift):
    """Where the two sines cross downwards."""
    fine = np.linspace(0, 2 * np.pi, 4_000_001)
    values = np.maximum(np.sin(fine), 0.7 * np.cos(fine + shift))
    return values.min()


@pytest.mark.slow
def test_a_kink_between_samples_is_found():
    for size in (20, 57, 400):
        theta = jnp.linspace(0.0, 2 * jnp.pi, size)
        values = jax.vmap(kinked, in_axes=(None, 0))(0.3, theta)
        found = jax.jit(lambda theta, values: extremes(kinked, jnp.asarray(0.3), theta, values))(theta, values)
        lost = float(values.min()) - exact_minimum(0.3)
        assert lost > 1e-4, "the samples alone miss it"
        assert float(found.minimum) == pytest.approx(exact_minimum(0.3), abs=1e-6)
        assert float(found.maximum) == pytest.approx(1.0, abs=1e-12)
        assert float(found.theta_maximum) == pytest.approx(np.pi / 2, abs=1e-6)


@pytest.mark.slow
def test_the_higher_of_two_kinks_in_a_bracket_is_found(rng):
    """Golden sections alone take the side that they look at first."""
    theta = jnp.arange(-60.0, 61.0)

    def curve(places: jax.Array, t: jax.Array) -> jax.Array:
        others = 0.5 - jnp.abs(t % 2 - 1)  # tops of their own, so that not every sample is a bracket
        return jnp.maximum((jnp.asarray([1.0, 0.95]) - jnp.abs(t - places)).max(), others)

    for here in rng.uniform(0.15, 0.25, 10):
        places = jnp.asarray([here, 1.06 - here])  # the sample beside the lower kink is the highest
        found = extremes(curve, places, theta, jax.vmap(curve, (None, 0))(places, theta))
        assert float(found.maximum) == pytest.approx(1.0, abs=1e-12)
        assert float(found.theta_maximum) == pytest.approx(here, abs=1e-9)


@pytest.mark.slow
def test_the_gradient_at_a_kink_is_that_of_the_true_extreme():
    theta = jnp.linspace(0.0, 2 * jnp.pi, 57)

    @jax.jit
    def lowest(shift):
        values = jax.vmap(kinked, in_axes=(None, 0))(shift, theta)
        return extremes(kinked, shift, theta, values).minimum

    shift, step = jnp.asarray(0.3), 1e-5
    central = (lowest(shift + step) - lowest(shift - step)) / (2 * step)
    assert float(jax.grad(lowest)(shift)) == pytest.approx(float(central), rel=1e-8)
    assert float(jax.jvp(lowest, (shift,), (1.0,))[1]) == pytest.approx(float(central), rel=1e-8)


def sines(numbers, angle):
    """The largest of three sums of two sines, shape (3, 2, 2) of amplitudes and phases."""
    orders = jnp.array([[1.0, 3.0], [2.0, 5.0], [1.0, 4.0]])
    return (numbers[..., 0] * jnp.sin(orders * angle + numbers[..., 1])).sum(axis=1).max()


def uneven(size: int, rng) -> jax.Array:
    """Angles of one turn whose spacing varies threefold."""
    steps = rng.uniform(0.5, 1.5, size - 1)
    return jnp.asarray(np.concatenate([[0.0], np.cumsum(steps)]) * 2 * np.pi / steps.sum())


@pytest.mark.slow
@pytest.mark.parametrize("even", [True, False])
def test_random_curves_of_kinks_and_waves(even, rng):
    """No point of a fine record is beyond the extremes, and they are within its spacing."""
    numbers = jnp.asarray(rng.standard_normal((60, 3, 2, 2)))
    theta = jnp.linspace(0.0, 2 * jnp.pi, 161) if even else uneven(161, rng)

    def both(numbers):
        found = extremes(sines, numbers, theta, jax.vmap(sines, (None, 0))(numbers, theta))
        fine = jax.lax.map(lambda angle: sines(numbers, angle), jnp.linspace(0.0, 2 * jnp.pi, 40_001), batch_size=1000)
        return jnp.stack([found.maximum, found.minimum]), jnp.stack([fine.max(), fine.min()])

    found, fine = jax.jit(jax.vmap(both))(numbers)
    beyond = np.asarray(found - fine) * np.array([1.0, -1.0])
    assert float(beyond.min()) > -1e-13
    assert float(beyond.max()) < 30 * 2 * np.pi / 40_000  # the steepest slope times the spacing
    np.testing.assert_allclose(found[7], jax.jit(both)(numbers[7])[0], rtol=1e-14)


@pytest.mark.slow
def test_gradients_of_extremes_in_a_batch_are_those_of_differences(rng):
    numbers, way = jnp.asarray(rng.standard_normal((20, 3, 2, 2))), jnp.asarray(rng.standard_normal((3, 2, 2)))
    theta = jnp.linspace(0.0, 2 * jnp.pi, 161)

    def swing(numbers):
        found = extremes(sines, numbers, theta, jax.vmap(sines, (None, 0))(numbers, theta))
        return found.maximum - found.minimum

    slopes = jnp.tensordot(jax.jit(jax.vmap(jax.grad(swing)))(numbers), way, 3)
    forward = jax.jit(jax.vmap(lambda numbers: jax.jvp(swing, (numbers,), (way,))[1]))(numbers)
    np.testing.assert_allclose(slopes, forward, rtol=1e-12, atol=1e-13)
    swings = jax.jit(jax.vmap(swing))
    central = (swings(numbers + 1e-5 * way[None]) - swings(numbers - 1e-5 * way[None])) / 2e-5
    np.testing.assert_allclose(slopes, central, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_extremes_in_single_precision(rng):
    numbers, theta = jnp.asarray(rng.standard_normal((20, 3, 2, 2))), jnp.linspace(0.0, 2 * jnp.pi, 161)

    def curve(numbers, angle):
        return sines(numbers.astype(jnp.float64), angle.astype(jnp.float64)).astype(angle.dtype)

    @jax.jit
    def both(numbers, theta):
        record = jax.vmap(jax.vmap(curve, (None, 0)), (0, None))(numbers, theta)
        found = jax.vmap(lambda own, values: extremes(curve, own, theta, values))(numbers, record)
        return jnp.stack([found.maximum, found.minimum])

    rough = both(numbers.astype(jnp.float32), theta.astype(jnp.float32))
    assert rough.dtype == jnp.float32
    np.testing.assert_allclose(rough, both(numbers, theta), atol=3e-6)


@pytest.mark.slow
def test_gradients_at_kinks_in_single_precision():
    """Of the lowest point, a kink, with the curve so far from zero that rounding hides where it is."""
    theta, shifts = jnp.linspace(0.0, 6.2, 121), jnp.linspace(0.1, 1.0, 20)

    def lowest(shift, theta):
        def curve(shift, angle):
            return 200.0 + kinked(shift, angle)

        return extremes(curve, shift, theta, jax.vmap(curve, (None, 0))(shift, theta)).minimum

    slopes = jax.jit(jax.vmap(jax.grad(lowest), (0, None)))
    rough = slopes(shifts.astype(jnp.float32), theta.astype(jnp.float32))
    np.testing.assert_allclose(rough, slopes(shifts, theta), atol=5e-3)


@pytest.mark.slow
def test_second_derivatives_go_through_the_values():
    theta = jnp.linspace(0.0, 6.0, 121)

    def top(size):
        def curve(size, angle):
            return size * jnp.sin(angle)

        return extremes(curve, size, theta, jax.vmap(curve, (None, 0))(size, theta)).maximum

    size = jnp.asarray(0.7)
    assert float(jax.jit(jax.hessian(lambda p: top(p) ** 2))(size)) == pytest.approx(2.0, rel=1e-9)
    assert float(jax.hessian(lambda p: jnp.exp(top(p)))(size)) == pytest.approx(np.exp(0.7), rel=1e-9)
    assert float(jax.grad(lambda p: jax.value_and_grad(top)(p)[0])(size)) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.slow
def test_an_extreme_at_an_end_of_the_record_goes_with_it(scene):
    def swing(end):
        return 1e3 * gj.transmission_error(scene, jnp.linspace(0.0, 1.0, 101) * end).peak_to_peak

    slope, central = jax.grad(swing)(5.0), (swing(5.0 + 1e-4) - swing(5.0 - 1e-4)) / 2e-4
    assert abs(float(central)) > 1e-3
    assert float(slope) == pytest.approx(float(central), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("where", [0, 30, 56])
def test_a_record_with_an_unknown_sample_has_no_extremes(where):
    """Where no flank carries the torque the TE is nan; other samples must not hide that."""
    theta = jnp.linspace(0.0, 2 * jnp.pi, 57)
    values = jax.vmap(kinked, (None, 0))(0.3, theta).at[where].set(jnp.nan)
    found = extremes(kinked, jnp.asarray(0.3), theta, values)
    assert bool(jnp.isnan(found.maximum) & jnp.isnan(found.minimum))


@pytest.mark.slow
def test_extremes_at_the_ends_and_of_a_constant():
    theta = jnp.linspace(0.0, 1.0, 11)
    rising = extremes(lambda k, a: k * a, jnp.asarray(2.0), theta, 2.0 * theta)
    assert (float(rising.minimum), float(rising.maximum)) == (0.0, 2.0)
    flat = extremes(lambda k, a: k + 0 * a, jnp.asarray(2.0), theta, jnp.full(11, 2.0))
    assert (float(flat.minimum), float(flat.maximum)) == (2.0, 2.0)
    bent = extremes(lambda k, a: -k * (a - 0.03) ** 2, jnp.asarray(2.0), theta, -2.0 * (theta - 0.03) ** 2)
    assert (float(bent.maximum), float(bent.theta_maximum)) == pytest.approx((0.0, 0.03), abs=1e-8)  # before sample 1
    two = extremes(lambda k, a: -k * (a - 0.3) ** 2, jnp.asarray(2.0), theta[::10], -2.0 * (theta[::10] - 0.3) ** 2)
    assert float(two.theta_maximum) == pytest.approx(0.3, abs=1e-7)
    one = extremes(lambda k, a: k * a, jnp.asarray(2.0), theta[3:4], 2.0 * theta[3:4])
    assert float(one.maximum) == float(one.minimum) == pytest.approx(0.6)


@pytest.mark.slow
def test_sampling_hardly_changes_the_metrics(scene):
    """The extremes of 5 ms samples are those of 0.05 ms samples; plain samples would lose 0.008 arcmin."""
    fine = gj.transmission_error(scene, scene.system.input_speed * jnp.linspace(0.0, 3.0, 60001))
    coarse = gj.transmission_error(scene, scene.system.input_speed * jnp.linspace(0.0, 3.0, 601))
    assert abs(float(coarse.peak_to_peak - fine.peak_to_peak)) / arcmin < 1e-4
    assert abs(float(coarse.amplitude - fine.amplitude)) / arcmin < 1e-4
    assert float(fine.amplitude - abs(coarse.te).max()) / arcmin > 0.004
    assert abs(float(coarse.mean - fine.mean)) / arcmin < 2e-3


@pytest.mark.slow
def test_metrics_are_those_of_the_record(scene, theta):
    te = gj.transmission_error(scene, theta)
    assert float(te.mean) == pytest.approx(np.mean(np.asarray(te.te)), rel=1e-12)
    assert float(te.std) == pytest.approx(np.std(np.asarray(te.te)), rel=1e-12)
    assert float(te.peak_to_peak) >= np.ptp(np.asarray(te.te))
    assert float(te.amplitude) >= np.abs(te.te).max()
    play = gj.backlash(scene, theta)
    assert float(play.range) >= np.ptp(np.asarray(play.backlash))
    assert float(play.range) == float(play.peak_to_peak)


@pytest.mark.slow
def test_extremes_of_random_assemblies(scene, rng):
    """Many peaks of nearly the same height: the highest is found, not the one with the loosest bound."""
    span = float(scene.system.cycle / scene.system.input_speed)
    spacings = {2e-4: 0.0, 0.005: 1e-4, 0.01: 2e-4, 0.02: 2e-3}  # and what may be lost [arcmin]
    angles = [scene.system.input_speed * jnp.linspace(0.0, span, round(span / h) + 1) for h in spacings]
    for _ in range(20):
        errors = {
            key: gj.Eccentricity(error.body, rng.uniform(0, 20e-6), rng.uniform(-np.pi, np.pi))
            for key, error in scene.errors.items()
        }
        found = [gj.transmission_error(dataclasses.replace(scene, errors=errors), theta) for theta in angles]
        for te, lost in zip(found, spacings.values(), strict=True):
            assert abs(float(te.peak_to_peak - found[0].peak_to_peak)) / arcmin <= lost
            assert abs(float(te.amplitude - found[0].amplitude)) / arcmin <= lost


@pytest.mark.slow
def test_constant_records_have_gradients(scene):
    """Perfect bodies: every deviation is zero, and so is its slope."""
    perfect = dataclasses.replace(scene, errors={})
    theta = jnp.linspace(0.0, 10.0, 11)
    ts = 1e-3 * theta

    def deviation(stiffness, analysis):
        changed = dataclasses.replace(perfect, compliance=gj.HarmonicStiffness(stiffness, [], []))
        if analysis == "dynamic":
            return gj.simulate(changed, ts, 0.0).std
        return gj.transmission_error(changed, theta, 50.0).std + gj.backlash(changed, theta).std

    for analysis, derivative in (("static", jax.grad), ("static", jax.jacfwd), ("dynamic", jax.grad)):
        stiffness = jnp.asarray(9e7)
        value = jax.jit(deviation, static_argnums=1)(stiffness, analysis)
        slope = jax.jit(derivative(deviation), static_argnums=1)(stiffness, analysis)
        assert float(value) == pytest.approx(0.0, abs=1e-18)
        assert float(slope) == pytest.approx(0.0, abs=1e-20)


def test_angles_must_increase(scene, theta):
    with pytest.raises(gj.SceneError, match="theta must increase"):
        gj.transmission_error(scene, theta[::-1])
    with pytest.raises(gj.SceneError, match="theta must increase"):
        gj.backlash(scene, jnp.zeros(3))


def test_the_line_at_half_the_sampling_rate():
    alternating = (-1.0) ** np.arange(64)
    spectrum = gj.order_spectrum(alternating, 2 * np.pi * np.arange(64) / 64, window="none")
    assert float(spectrum.amplitude[-1]) == pytest.approx(1.0)


def test_load_sharing_factor():
    forces = jnp.array([[100.0, 0.0, 0.0, 0.0], [50.0, 50.0, 0.0, 0.0], [0.0, 0.0, 30.0, 10.0], [0.0, 0.0, 0.0, 0.0]])
    carried = gj.Layout.of_flanks(2, back=True).per_pair(forces)
    np.testing.assert_allclose(load_sharing_factor(carried, 2), [2.0, 1.0, 1.5, np.nan])


def test_load_sharing_without_torque_is_refused(scene, theta):
    with pytest.raises(gj.SceneError, match="load sharing needs a torque"):
        _ = gj.transmission_error(scene, theta[:5]).load_sharing


def test_spectrum_on_whole_turns_is_exact():
    theta = 2 * jnp.pi * 3 * jnp.arange(600.0) / 600
    record = 0.7 + 0.3 * jnp.sin(4 * theta + 0.2) + 0.05 * jnp.cos(11 * theta)
    spectrum = gj.order_spectrum(record, theta, window="none")
    lines = {round(float(o), 6): float(a) for o, a in zip(spectrum.order, spectrum.amplitude, strict=True)}
    assert lines[4.0] == pytest.approx(0.3, rel=1e-12)
    assert lines[11.0] == pytest.approx(0.05, rel=1e-12)
    rest = [amplitude for order, amplitude in lines.items() if order not in (4.0, 11.0)]
    assert max(rest) < 1e-12


def test_windowed_spectrum_on_a_broken_span():
    theta = jnp.linspace(0.0, 2 * jnp.pi * 7.37, 4000)
    spectrum = gj.order_spectrum(0.3 * jnp.sin(4 * theta), theta)
    peak = int(jnp.argmax(spectrum.amplitude))
    assert float(spectrum.order[peak]) == pytest.approx(4.0, abs=0.1)
    assert 0.3 * 0.84 < float(spectrum.amplitude[peak]) <= 0.3
    far = spectrum.amplitude[jnp.abs(spectrum.order - 4) > 1.0]
    assert float(far.max()) < 0.003


@pytest.mark.slow
def test_the_no_load_spectrum_sits_on_crank_and_planet_orders(scene):
    """Over one output turn: orders 25 and 26 and their multiples, as in fig. 16."""
    theta = scene.system.cycle * jnp.arange(8192.0) / 8192
    te = gj.transmission_error(scene, theta)
    turn = 2 * jnp.pi / scene.system.orders["output"]
    spectrum = gj.order_spectrum(te.te, theta, turn=turn, window="none")
    assert round(float(spectrum.order[jnp.argmax(spectrum.amplitude)])) == 26
    single = gj.order_spectrum(gj.transmission_error(scene, theta, 1e5).te, theta, turn=turn, window="none")
    strong = {round(float(o)) for o in single.order[single.amplitude > 1e-3 * single.amplitude.max()]}
    assert strong <= {25, 26}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((jnp.ones(8), jnp.arange(8.0), {"window": "hamming"}), 'window = "hamming": valid: none, hann'),
        ((jnp.ones(3), jnp.arange(3.0), {}), "at least 4 samples"),
        ((jnp.ones(5), jnp.array([0.0, 1, 2, 3, 7]), {}), "unevenly spaced"),
    ],
)
def test_spectrum_refuses(arguments, message):
    values, theta, keywords = arguments
    with pytest.raises(gj.SceneError, match=message):
        gj.order_spectrum(values, theta, **keywords)


@pytest.mark.parametrize("samples", [1581, 15801, 158001])
def test_the_extremes_do_not_depend_on_the_samples(scene, samples):
    """Every kink is resolved: none is missed where fused code rounds the branches of the maximum differently."""
    absolute = dataclasses.replace(scene, reference=None)
    te = gj.transmission_error(absolute, jnp.linspace(0.0, scene.system.cycle, samples))
    assert float(te.peak_to_peak) / arcmin == pytest.approx(2.1010055900, abs=1e-7)
    assert float(te.amplitude) / arcmin == pytest.approx(1.4465759985, abs=1e-7)
