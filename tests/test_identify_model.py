"""Curves of recordings as the model has them: against gear sets written out apart, differences, and their own sums."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.identification.model import Model, Normal, Problem
from gearjax.identification.rows import rows_of
from gearjax.identification.search import Known, descend
from gearjax.identification.unknowns import unknowns_of
from gearjax.studies.select import pick
from gearjax.units import arcmin
from tests.bench_units import pin_stage, random_unit, runs, two_kv


@pytest.fixture(scope="module")
def scene():
    return two_kv()


@pytest.fixture(scope="module")
def unit():
    return random_unit(3)


def problem(scene, records, where=None) -> tuple[Problem, np.ndarray]:
    back = any(record.back.any() for record in records)
    loaded = any(record.is_loaded for record in records)
    unknowns = unknowns_of(scene, where, back=back, loaded=loaded)
    model = Model.of(unknowns, records, loaded=loaded)
    rows = rows_of(records, scene)
    return Problem(model, rows), np.concatenate([unknowns.start, np.zeros(rows.basis.shape[1])])


@pytest.mark.slow
def test_the_model_is_the_algebra_of_the_reducer(scene, unit):
    """With the unit's own numbers nothing but the encoders' steps is left."""
    errors = {"planet_1": unit.planet_1, "planet_2": unit.planet_2, "revolution": unit.revolution}
    numbers = {}
    for name, vector in (errors | {"output_wheel": unit.output}).items():
        numbers |= {f"errors.{name}.amplitude": abs(vector), f"errors.{name}.phase": np.angle(vector)}
    numbers |= {"compliance.mean": unit.stiffness, "backlash.initial": unit.play}
    free = pick(scene, list(numbers))
    own = free.set(scene, jnp.asarray(list(numbers.values())))
    records = runs(unit, 0, (10.0, 150.0, -40.0, 0.0), noise=0.0, rows=400)
    solved, start = problem(own, records)
    assert solved.model.__class__.__name__ == "Tables"
    curve, _ = solved.curve(start)
    assert np.abs(curve - solved.rows.te).max() < 2 * 2 * np.pi / 2**20 / arcmin


@pytest.mark.slow
@pytest.mark.parametrize("case", ["tables", "exact", "no load", "turned", "turned exact", "supports"])
def test_derivatives_are_central_differences(case, scene, rng):
    records = runs(random_unit(1), 1, (10.0, -40.0), rows=40)
    if "exact" in case:
        scene = pin_stage()
        theta = np.linspace(0.0, 30.0, 24)
        records = [gj.Measurement(theta, te=np.zeros(24), torque=torque) for torque in (60.0, -60.0)]
    elif case == "no load":
        records = [dataclasses.replace(record, torque=None) for record in records]
        records[1] = dataclasses.replace(records[1], theta=records[1].theta[::-1], output=records[1].output[::-1])
    elif case == "supports":
        supports = {"planet_1": gj.Support(x=2e8, y=3e8)}
        scene = dataclasses.replace(scene, supports=supports)
    if "turned" in case:
        path = "errors.disc" if "exact" in case else "errors.planet_1"
        records[1] = dataclasses.replace(records[1], turned={path: 0.7})
    where = None if "exact" not in case else ["errors.pins", "errors.disc", "compliance.mean"]
    solved, start = problem(scene, records, where)
    point = start + 0.3 * rng.standard_normal(start.size) * np.where(np.arange(start.size) < 8, 1.0, 0.02)
    _, jacobian = solved.curve(point)
    step = 1e-4
    for number in rng.choice(start.size, 6, replace=False):
        ends = [solved.curve(point + side * step * np.eye(start.size)[number])[0] for side in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        off = np.abs(slope - jacobian[:, number])
        # rows whose contacts change within the step differ
        assert np.median(off) < 2e-4 * max(np.abs(slope).max(), 1e-6)
        assert (off < 2e-3 * np.abs(slope).max() + 1e-9).mean() > 0.9


@pytest.mark.slow
def test_sums_of_tables_are_those_of_their_curves(scene, rng):
    solved, start = problem(scene, runs(random_unit(1), 1, rows=123))
    points = start + rng.standard_normal((3, start.size))
    weight = rng.uniform(0.5, 1.0, solved.rows.theta.size)
    sums = solved.normal(points, weight)
    for i, point in enumerate(points):
        curve, jacobian = solved.curve(point)
        residual = solved.rows.te - curve
        np.testing.assert_allclose(sums.cost[i], (weight * residual**2).sum(), rtol=1e-10)
        np.testing.assert_allclose(sums.slope[i], jacobian.T @ (weight * residual), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(sums.matrix[i], jacobian.T * weight @ jacobian, rtol=1e-7, atol=1e-9)


def test_levenberg_and_marquardt_end_where_a_line_is_fitted(rng):
    design, measured = rng.standard_normal((50, 3)), rng.standard_normal(50)

    def sums(points):
        residual = measured - points @ design.T
        matrix = np.broadcast_to(design.T @ design, (len(points), 3, 3)).copy()
        return Normal((residual**2).sum(axis=1), matrix, residual @ design)

    mean, precision = np.array([1.0, 0.0, 0.0]), np.array([4.0, 0.0, 0.0])
    free = np.array([[-np.inf] * 3, [np.inf] * 3])
    ends, _ = descend(sums, rng.standard_normal((5, 3)), Known(mean, precision), free, 50.0)
    best = np.linalg.solve(design.T @ design + np.diag(precision), design.T @ measured + precision * mean)
    np.testing.assert_allclose(ends, np.broadcast_to(best, (5, 3)), atol=1e-4)
