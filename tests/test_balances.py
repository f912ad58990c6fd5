"""Populations with two-sided contacts: gaps as sums of few products, balances one angle after the other."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact.search import closed_side, hard_balance
from gearjax.errors import AbstractError
from gearjax.parameters import length, name
from gearjax.tolerance.affine import AffineGaps
from gearjax.tolerance.balances import Balances
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.measures import Measures
from gearjax.tolerance.monte_carlo import Work
from gearjax.units import um
from tests.rv import angles, scene

NAMES = ["static.peak_to_peak@784Nm", "static.mean@-300Nm", "static.mean@1e-6Nm", "no_load.mean", "backlash.minimum"]


def measures(population: gj.Tolerances, theta, names=NAMES) -> Measures:
    return Measures([Measure.named(name) for name in names], population, theta, "samples")


def some_pins() -> gj.Tolerances:
    """Every third pin, run-out by its components, one pitch wave, a stiffness."""
    spread: dict = {f"errors.pins.outward[{i}]": gj.Normal(0.0, 2 * um) for i in range(0, 40, 3)}
    spread |= {"errors.run_out_1.amplitude": gj.Rayleigh(2 * um), "errors.run_out_1.phase": gj.UniformPhase()}
    spread |= {"errors.pitch_2.phase": gj.UniformPhase(), "compliance.mean": gj.Uniform(1.5e8, 1.8e8)}
    return gj.Tolerances(scene(with_errors=True), spread)


@pytest.fixture(scope="module")
def population() -> gj.Tolerances:
    return some_pins()


@pytest.fixture(scope="module")
def quick(population) -> Measures:
    return measures(population, jnp.asarray(angles(per_turn=12)))


def one_by_one(population: gj.Tolerances, theta, values) -> list[float]:
    own = population.with_values(jnp.asarray(values))
    te, back, slight = (gj.transmission_error(own, theta, torque).te for torque in (784.0, -300.0, 1e-6))
    play = gj.backlash(own, theta)
    return [float(x) for x in (jnp.ptp(te), back.mean(), slight.mean(), play.lower.mean(), play.backlash.min())]


@pytest.mark.slow
def test_samples_are_the_analyses_one_by_one(population, quick):
    assert isinstance(quick.curves, Balances)
    rows = population.examples[:3]
    found, codes = jax.jit(quick.rows)(jnp.asarray(rows))
    assert not codes.any()
    expected = [one_by_one(population, quick.theta, row) for row in rows]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.slow
def test_contacts_that_share_no_number_share_a_table(quick):
    """Two sorts of numbers of the pins, two components of a run-out and of a pitch wave on either disc."""
    gaps = quick.curves.gaps
    assert gaps.influence.shape[1] == 4
    assert gaps.nominal.shape == (12, 80)


@pytest.mark.slow
def test_gradients_are_central_differences_under_vmap_and_jit(population, quick):
    rows = jnp.asarray(population.examples[5:7])
    slopes = np.asarray(jax.jit(jax.vmap(jax.jacrev(lambda row: quick(row)[0])))(rows))
    evaluate = jax.jit(quick.rows)
    for column in (0, 5, len(population.paths) - 4, len(population.paths) - 3, len(population.paths) - 1):
        step = 3e-4 * population.deviations[column]
        ends = [np.asarray(evaluate(rows.at[:, column].add(sign * step))[0]) for sign in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2 * step)
        assert difference.any()
        scale = (
            np.abs(difference).max(axis=0) + 1e-3 * np.abs(difference).max()
        )  # not every pin has to do with every measure
        np.testing.assert_allclose(slopes[:, :, column] / scale, difference / scale, atol=1e-6)


class Curved(AbstractError):
    """Opens gaps by the square of its size."""

    kind: ClassVar[str] = "curved"
    body: str = name()
    size: gj.typing.Number = length()

    def gap(self, view):
        return 1e3 * self.size**2 * view.sine


@pytest.mark.slow
def test_gaps_that_are_no_sums_are_looked_at_one_by_one():
    own = scene()
    own = dataclasses.replace(own, errors={**own.errors, "curved": Curved("disc_1", jnp.asarray(1e-5))})
    population = gj.Tolerances(own, {"errors.curved.size": gj.Uniform(1e-5, 5e-5)})
    theta = jnp.asarray(angles(1, 8))
    other = measures(population, theta, NAMES[:1])
    assert other.curves is None
    values = jnp.asarray(population.examples[3])
    te = gj.transmission_error(population.with_values(values), theta, 784.0).te
    assert float(other(values)[0][0]) == pytest.approx(float(jnp.ptp(te)), rel=1e-9)


@pytest.mark.slow
def test_without_varied_errors():
    population = gj.Tolerances(scene(), {"compliance.mean": gj.Uniform(1.5e8, 1.8e8)})
    found = measures(population, jnp.asarray(angles(1, 8)))
    assert found.curves.gaps.influence.shape[1] == 0
    values = population.examples[0]
    np.testing.assert_allclose(
        found(jnp.asarray(values))[0], one_by_one(population, found.theta, values), rtol=1e-9, atol=1e-15
    )
    few = jnp.asarray(population.examples[:3])
    alone = np.stack([one_by_one(population, found.theta, row) for row in population.examples[:3]])
    np.testing.assert_allclose(found.rows(few)[0], alone, rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_float32(population):
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), population.scene)
    narrow = gj.Tolerances(single, population.distributions)
    theta = angles(per_turn=12)
    works = [Work(p, NAMES, number=16, theta=theta, extremes="samples") for p in (population, narrow)]
    assert isinstance(works[1].one.curves, Balances)
    wide, short = (work.evaluate(work.inputs(0, 16))[0] for work in works)
    np.testing.assert_allclose(short, wide, atol=2e-9)


@pytest.mark.slow
def test_a_lane_that_cannot_carry_leaves_the_others_alone():
    """Two contacts that hold against one side alone, one of which touches first."""
    lever = jnp.array([[-0.06], [-0.03]])
    gap = jnp.array([[1e-5, 1e-5], [2e-5, -1e-5]])
    load = jnp.array([-1e-8, 1e-8])
    start = closed_side(lever, gap, load)
    found = hard_balance(lever, gap, load, start)
    assert np.isnan(found[1])
    assert float(found[0]) == pytest.approx((-1e-8 - 0.06 * 1e-5) / 0.06**2, rel=1e-12)
    slopes = jax.jacfwd(hard_balance, argnums=2)(lever, gap, load, start)
    assert float(slopes[0, 0]) == pytest.approx(1 / 0.06**2, rel=1e-12)
    assert not slopes[0, 1]


@pytest.mark.parametrize("torque", [0.0, 1e-9, -1e-9, 1e-6, 1e-3])
def test_hardly_any_torque_in_play_is_found_from_anywhere(torque, rng):
    """Play of 2e-4 rad, a wind-up of 1e-15 rad and up: the edge of the play, and nothing in it, is the balance."""
    lever = jnp.asarray(0.06 * np.sin(np.linspace(0.1, 6.2, 30))[:, None])
    gap = jnp.asarray(rng.uniform(5e-6, 2e-5, (30, 8)))
    load = jnp.full(8, -torque / 1.6e8)
    upper = jnp.where(lever > 0, gap / lever, np.inf).min(axis=0)
    lower = jnp.where(lever < 0, gap / lever, -np.inf).max(axis=0)
    within = lower + (upper - lower) * jnp.linspace(-0.3, 1.2, 8)
    found = hard_balance(lever, gap, load, within)
    edge = upper if torque < 0 else lower
    forces = jnp.maximum(lever * found[None] - gap, 0.0)
    np.testing.assert_allclose(found, edge, rtol=2e-11, atol=1e-5 * abs(torque))  # by one contact
    np.testing.assert_allclose((lever * forces).sum(axis=0), load, rtol=1e-3, atol=0.06**2 * 2e-11 * 2e-4)


@pytest.mark.slow
def test_a_contact_that_hardly_turns_anything_does_not_hold_up_the_search():
    """One that is wedged where its lever all but vanishes pushes through the play, against the other side."""
    lever = jnp.array([[1e-7], [0.05], [-0.05]])
    gap = jnp.array([[-1e-6], [1e-5], [1e-5]])
    for start in (-1e-3, 0.0, 1e-3):
        found = hard_balance(lever, gap, jnp.zeros(1), jnp.full(1, start))
        np.testing.assert_allclose(found, -2e-4 - 1e-13 / 0.05**2, rtol=1e-9)


@pytest.mark.parametrize("begin", [-1e-2, 0.0, 3e-4, 1e-2])
def test_any_start_leads_to_the_balance(begin, rng):
    lever = jnp.asarray(rng.normal(size=(30, 1)) * 0.05)
    gap = jnp.asarray(rng.normal(size=(30, 50)) * 1e-5)
    load = jnp.asarray(rng.choice([-1.0, 1.0], 50) * 10.0 ** rng.uniform(-12, -3, 50))
    position = hard_balance(lever, gap, load, jnp.full(50, begin))
    arm, gap = np.asarray(lever), np.asarray(gap)
    moment = (arm * np.maximum(arm * np.asarray(position) - gap, 0.0)).sum(axis=0)
    np.testing.assert_allclose(moment, load, rtol=1e-9, atol=1e-22)


def test_numbers_that_open_gaps_together_have_tables_of_their_own():
    def gap(numbers, at):
        return jnp.array([1.0, 2.0, 3.0]) * at + jnp.stack([numbers[0], numbers[1] * at, numbers[0] + numbers[2]])

    at = jnp.linspace(0.1, 1.0, 7)
    examples = jnp.arange(6.0).reshape(2, 3)
    sums = AffineGaps.of(gap, at, examples)
    assert sums.influence.shape == (7, 2, 3)
    np.testing.assert_allclose(sums.everywhere(examples[1]), jax.vmap(gap, (None, 0), 1)(examples[1], at), rtol=1e-12)
    assert AffineGaps.of(lambda numbers, at: gap(numbers**2, at), at, examples) is None


@pytest.mark.parametrize(
    ("numbers", "shared"),
    [
        ([[0, 1, 2, 0, 1, 2], [3, 3, 3, 4, 4, 4], [5] * 6], ((1, 3), (2, 1), (1, 1))),  # pins, discs, all
        ([[0, 1, 2, 0, 1, 2]], ((1, 3),)),
        ([[0, 0, 0, 1, 1, 1]], ((2, 1),)),
        ([[0] * 6], ((1, 1),)),
        ([[0, 1, 0, 1, 0, 1], [2, 3, 4, 5, 6, 7]], ((1, 2), (3, 2))),
        ([[0, 1, 2, 3, 4, 5]], ((1, 6),)),
    ],
)
def test_contacts_that_share_numbers_read_them_once(numbers, shared, rng):
    """Each contact still gets its own numbers: sums are those of the tables, whatever repeats."""
    number, contacts = np.array(numbers), len(numbers[0])
    influence, nominal = rng.normal(size=(7, *number.shape)), rng.normal(size=(7, contacts))
    size, lanes = number.max() + 1, 5

    def gap(numbers, at):
        return jnp.asarray(nominal)[at] + (jnp.asarray(influence)[at] * numbers[number]).sum(axis=0)

    values = jnp.asarray(rng.normal(size=(size, lanes)))
    sums = AffineGaps.of(gap, jnp.arange(7), values.T)
    assert sorted(sums.shared) == sorted(shared)
    assert sum(part.size for part in sums.once(values)) == lanes * sum(row * column for row, column in shared)
    expected = nominal[..., None] + np.einsum("ntc,tcl->ncl", influence, np.asarray(values)[number])
    for lane in range(lanes):
        np.testing.assert_allclose(sums.everywhere(values[:, lane]).T, expected[..., lane], rtol=1e-12, atol=1e-12)


def test_gaps_without_numbers_are_the_nominal_ones():
    sums = AffineGaps.of(lambda _, at: at * jnp.arange(3.0), jnp.arange(4.0), jnp.zeros((2, 1)))
    np.testing.assert_array_equal(sums.everywhere(jnp.ones(1)), np.outer(np.arange(3.0), np.arange(4.0)))


BETWEEN = ["static.maximum@784Nm", "static.minimum@784Nm", "no_load.minimum", "backlash.maximum"]


@pytest.mark.slow
def test_extremes_between_samples_are_those_of_the_analyses():
    """Eight samples per pin, where the analyses find them from slopes: within 1e-3 of the larger peak-to-peak. One per
    pin, as of the record with eight: the samples alone miss up to a tenth."""
    population = some_pins()
    rows = population.examples[:3]
    theta = np.linspace(0.0, 0.5, 26)
    found = Measures([Measure.named(name) for name in BETWEEN], population, theta, "between")
    assert isinstance(found.curves, Balances)
    few = Measures([Measure.named(name) for name in BETWEEN], population, theta[::5], "between")
    assert isinstance(few.curves, Balances)
    assert few.places > 1
    values, codes = jax.jit(found.rows)(jnp.asarray(rows))
    sparse = jax.jit(few.rows)(jnp.asarray(rows))[0]
    assert not codes.any()
    for row, own, other in zip(rows, np.asarray(values), np.asarray(sparse), strict=True):
        one = population.with_values(jnp.asarray(row))
        te, play = gj.transmission_error(one, theta, 784.0).extremes, gj.backlash(one, theta)
        empty = gj.transmission_error(one, theta).extremes
        expected = [float(x) for x in (te.maximum, te.minimum, empty.minimum, play.extremes.maximum)]
        swing = float(empty.maximum - empty.minimum)
        np.testing.assert_allclose(own, expected, atol=1e-3 * swing)
        np.testing.assert_allclose(other, expected, atol=5e-3 * swing)
