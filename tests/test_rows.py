"""Programs for many rows: they compute what one row after the other gives, and no more rows than there are."""

import jax
import numpy as np
import pytest

import gearjax as gj
from gearjax.timing import Stopwatch
from gearjax.tolerance.monte_carlo import Work
from gearjax.tolerance.population import SHARED
from gearjax.tolerance.rows import RowProgram

NAMES = [
    "no_load.peak_to_peak",
    "no_load.std",
    "backlash.minimum",
    "static.peak_to_peak@30Nm",
    "static.peak_to_peak@300Nm",
]


def squared(row, factor):
    return {"sum": factor * (row**2).sum(), "row": row[::-1]}


@pytest.mark.parametrize("number", [1, 4, 7, 40, 41, 95])
def test_any_number_of_rows(rng, number):
    rows, factors = rng.normal(size=(number, 3)), rng.normal(size=number)
    program = RowProgram(squared, jax.local_devices()[:1], 4, 38)
    assert program.room == 40
    found = program(rows, factors)
    np.testing.assert_allclose(found["sum"], factors * (rows**2).sum(axis=1), rtol=1e-15)
    np.testing.assert_array_equal(found["row"], rows[:, ::-1])
    assert program._program._cache_size() == 1


def test_no_more_blocks_are_computed_than_there_are_rows(rng):
    blocks = []

    def counted(row):
        jax.debug.callback(lambda: blocks.append(1))
        return row.sum()

    program = RowProgram(counted, jax.local_devices()[:1], 1, 1000)
    program(rng.normal(size=(5, 2)))
    jax.effects_barrier()
    assert len(blocks) == 5


@pytest.mark.slow
def test_studies_share_the_programs_of_their_analyses(scene, population, angles):
    """Other torques, other measures beside them and other sizes need no other program."""
    measures = [gj.Measure.named(name) for name in NAMES]
    work = Work(population, measures, number=64, theta=angles)
    parts = [(part.one.metrics[0][0], len(part.torques)) for part in work.parts]
    assert parts == [("no_load", 1), ("backlash", 1), ("static", 2)]
    quick = Work(population, measures, number=64, theta=angles, extremes="samples")
    assert [len(part.one.metrics) for part in quick.parts] == [3, 1]
    found, codes = work.evaluate(work.inputs(0, 64))
    other = Work(population, "static.peak_to_peak@100Nm", number=200, seed=1, theta=angles)
    assert other._programs[0] is work._programs[2]
    other.evaluate(other.inputs(0, 200))
    assert [program._program._cache_size() for program in work._programs] == [1, 1, 1]
    assert not codes.any()
    for column, measure in enumerate(measures):
        alone = Work(gj.Tolerances(scene, population.distributions), measure, number=64, theta=angles)
        np.testing.assert_array_equal(alone.evaluate(work.inputs(0, 64))[0][:, 0], found[:, column])


@pytest.mark.slow
def test_programs_in_threads_find_the_same_and_their_compilation_is_told_apart(scene, population, angles):
    found, events = [], []
    for workers in (1, 2):
        own = gj.Tolerances(scene, population.distributions)
        work = Work(own, NAMES, number=32, theta=angles, workers=workers)
        with Stopwatch() as watch:
            found.append(work.evaluate(work.inputs(0, 32))[0])
        events.append(len(watch.intervals))
    np.testing.assert_array_equal(*found)
    assert min(events) >= 3 * len(work.parts) - 3


def test_what_studies_share_is_worked_out_once_and_forgotten_at_last(population):
    made = []
    for key in (0, 1, 0, *range(1, SHARED + 5), 0, 1):
        assert population.once(("a test", key), lambda key=key: made.append(key) or key) == key
    assert made == [*range(SHARED + 5), 0, 1]
    assert len(population._shared) == SHARED
