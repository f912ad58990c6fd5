"""Equilibrium of few and of many linear springs on known sides, against the closed form and a bisection."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.contact import ContactSet, HardContact, Layout, LinearSprings, equilibrium

LEVER = 0.06  # m/rad
NUMBERS = (2, 3, 7, 24, 25, 60, 300)  # of contacts, on both sides of where the solver changes
MODULE = sys.modules[equilibrium.__module__]


def springs_on_sides(rng, number, play, dtype=float) -> ContactSet:
    """Contacts in any order, the first of which is driving and the second a back flank; some ``play`` apart [m]."""
    side = np.where(rng.uniform(size=number) < 0.5, 1, -1)
    side[:2] = 1, -1
    lever = -side * LEVER * rng.uniform(0.8, 1.2, number)
    gap = rng.uniform(0, 30e-6, number) + np.where(side < 0, play, 0.0)
    stiffness = rng.uniform(1e7, 3e8, number)
    layout = Layout(tuple(side.tolist()), tuple(range(number)))
    return ContactSet(
        jnp.asarray(lever[:, None], dtype),
        jnp.asarray(gap, dtype),
        LinearSprings(jnp.asarray(stiffness, dtype)),
        layout,
    )


def closed_form(contacts: ContactSet, load: float) -> tuple[float, np.ndarray]:
    """All by all: what carries is told by what the springs together carry where each begins to touch."""
    lever, gap, stiffness = (np.asarray(x, np.longdouble) for x in (contacts.lever, contacts.gap, contacts.linear))
    touch = gap / lever
    apart = touch[None, :] - touch[:, None]
    reaction = ((lever * stiffness)[:, None] * np.maximum(lever[:, None] * apart, 0)).sum(axis=0)
    active = np.where(lever < 0, reaction >= load, reaction < load)
    weight = np.where(active, lever**2 * stiffness, 0)
    place = (load + (weight * touch).sum()) / weight.sum()
    return float(place), np.asarray(np.where(active, stiffness * lever * (place - touch), 0), float)


def bisected(contacts: ContactSet, load: float) -> tuple[float, np.ndarray]:
    """The position at which the springs balance the load, between bounds that are halved."""
    lever, gap, stiffness = (np.asarray(x, np.longdouble) for x in (contacts.lever, contacts.gap, contacts.linear))
    low, high = np.longdouble(-1), np.longdouble(1)
    for _ in range(200):
        middle = (low + high) / 2
        reached = (lever * stiffness * np.maximum(lever * middle - gap, 0)).sum() >= load
        low, high = (low, middle) if reached else (middle, high)
    return float(high), np.asarray(stiffness * np.maximum(lever * high - gap, 0), float)


@pytest.fixture(params=["few", "many"])
def way(request, monkeypatch):
    """Either way for all numbers of contacts."""
    monkeypatch.setattr(MODULE, "MOST_ONE_BY_ONE", 1000 if request.param == "few" else 0)


@pytest.mark.slow
@pytest.mark.parametrize("reference", [closed_form, bisected])
@pytest.mark.parametrize("number", NUMBERS)
def test_random_springs_rest_where_the_reference_says(number, reference, rng):
    """Both signs of the load, flanks apart, and flanks that are pressed at the same time."""
    solve = jax.jit(lambda contacts, load: equilibrium(contacts, load, HardContact()))
    for play in (60e-6, 5e-6, -40e-6):
        for torque in (0.3, -20.0, 400.0 * number, -400.0 * number):
            contacts = springs_on_sides(rng, number, play)
            found = solve(contacts, jnp.asarray(-torque))
            position, forces = reference(contacts, -torque)
            assert int(found.result) == 0
            scale = max(abs(position), 30e-6 / LEVER)  # positions are known as well as the gaps are
            assert abs(float(found.position) - position) <= 1e-12 * scale
            np.testing.assert_allclose(found.forces, forces, rtol=0, atol=1e-12 * abs(forces).max() + 1e-7)
            assert float(contacts.lever @ found.forces) == pytest.approx(-torque, rel=1e-12, abs=1e-11 * forces.max())


@pytest.mark.slow
@pytest.mark.usefixtures("way")
def test_both_ways_on_the_same_springs(rng):
    for number in (2, 9, 40):
        for play, torque in ((60e-6, 200.0), (-40e-6, -30.0), (0.0, 0.0)):
            contacts = springs_on_sides(rng, number, play)
            found = equilibrium(contacts, jnp.asarray(-torque), HardContact())
            position, forces = closed_form(contacts, -torque)
            assert float(found.position) == pytest.approx(position, rel=1e-12, abs=1e-16)
            np.testing.assert_allclose(found.forces, forces, rtol=0, atol=1e-12 * (1.0 + abs(forces).max()))


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("torque", [1e-12, -1e-12])
@pytest.mark.parametrize("number", [3, 60])
def test_tiny_torques_are_not_lost_in_rounding(number, torque, rng):
    """Only the contact that closes first carries, all of it; gaps are some 1e16 times as long as it gives way."""
    contacts = springs_on_sides(rng, number, 60e-6)
    found = equilibrium(contacts, jnp.asarray(-torque), HardContact())
    assert float(contacts.lever @ found.forces) == pytest.approx(-torque, rel=1e-12)
    assert int((found.forces != 0).sum()) == 1


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("number", [2, 60])
def test_without_a_torque_the_first_driving_contact_touches(number, rng):
    contacts = springs_on_sides(rng, number, 60e-6)
    found = equilibrium(contacts, jnp.asarray(0.0), HardContact())
    touch = np.asarray(contacts.gap / contacts.lever)
    assert float(found.position) == touch[np.asarray(contacts.lever) < 0].max()
    assert not np.asarray(found.forces).any()


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("number", [2, 60])
def test_contacts_that_touch_at_once_all_carry(number):
    springs = LinearSprings(jnp.full((number,), 1e8))
    layout = Layout.of_flanks(number, back=False)
    contacts = ContactSet(jnp.full((number, 1), -LEVER), jnp.full((number,), 2e-6), springs, layout)
    found = equilibrium(contacts, jnp.asarray(-30.0), HardContact())
    np.testing.assert_allclose(found.forces, 30.0 / LEVER / number, rtol=1e-12)


@pytest.mark.usefixtures("way")
def test_no_flank_to_carry_the_load():
    contacts = ContactSet(
        jnp.full((30, 1), -LEVER),
        jnp.arange(30.0) * 1e-6,
        LinearSprings(jnp.full((30,), 1e8)),
        Layout.of_flanks(30, False),
    )
    found = equilibrium(contacts, jnp.asarray(5.0), HardContact())
    assert int(found.result) == 1
    assert np.isnan(float(found.position))
    assert not np.asarray(found.forces).any()


@pytest.mark.slow
@pytest.mark.parametrize("number", [5, 60])
@pytest.mark.parametrize(("play", "torque"), [(60e-6, 500.0), (60e-6, -500.0), (-40e-6, 90.0)])
def test_gradients_against_central_differences(number, play, torque, rng):
    """Of the position and of all forces, in levers, gaps, stiffnesses and the load; under jit and vmap."""
    contacts = springs_on_sides(rng, number, play)
    start = (contacts.lever, contacts.gap, contacts.linear, jnp.asarray(-torque))
    mixed = jnp.asarray(rng.uniform(0.5, 1.5, number) * 1e-9)

    def measure(lever, gap, stiffness, load):
        found = equilibrium(
            ContactSet(lever[:, None], gap, LinearSprings(stiffness), contacts.layout), load, HardContact()
        )
        return found.position + mixed @ found.forces

    batch = jax.tree.map(lambda part: jnp.stack([part, part * 1.001]), start)
    slopes = jax.jit(jax.vmap(jax.grad(measure, argnums=(0, 1, 2, 3))))(*batch)
    for which in range(2):
        point = [part[which] for part in batch]
        for _ in range(3):
            way = [jnp.asarray(rng.uniform(-1, 1, part.shape)) * part for part in point]
            step = 1e-7
            ends = [
                measure(*(part + sign * step * along for part, along in zip(point, way, strict=True)))
                for sign in (1.0, -1.0)
            ]
            expected = float(ends[0] - ends[1]) / (2 * step)
            parts = [float((slope[which] * along).sum()) for slope, along in zip(slopes, way, strict=True)]
            assert sum(parts) == pytest.approx(expected, rel=1e-6, abs=1e-6 * max(map(abs, parts)))


@pytest.mark.slow
def test_both_ways_have_the_same_gradients(rng, monkeypatch):
    contacts = springs_on_sides(rng, 40, -20e-6)

    def slopes(most):
        monkeypatch.setattr(MODULE, "MOST_ONE_BY_ONE", most)
        both = (
            jax.jacobian(lambda gap: _forces(contacts, gap, -300.0)),
            jax.jacfwd(lambda gap: _forces(contacts, gap, -300.0)),
        )
        return [function(contacts.gap) for function in both]

    few, many = slopes(1000), slopes(0)
    for one, other in zip(few, many, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * float(jnp.abs(one).max()))


def _forces(contacts, gap, load):
    changed = ContactSet(contacts.jacobian, gap, contacts.springs, contacts.layout)
    return equilibrium(changed, jnp.asarray(load), HardContact()).forces


@pytest.mark.slow
@pytest.mark.parametrize("number", [10, 200])
def test_a_batch_is_its_members(number, rng):
    contacts = springs_on_sides(rng, number, -10e-6)
    loads = jnp.asarray([-3000.0, -1e-12, 0.0, 50.0, 3000.0])
    together = jax.jit(jax.vmap(lambda load: equilibrium(contacts, load, HardContact())))(loads)
    for index, load in enumerate(loads):
        alone = equilibrium(contacts, load, HardContact())
        np.testing.assert_allclose(together.position[index], alone.position, rtol=1e-13)
        np.testing.assert_allclose(together.forces[index], alone.forces, rtol=1e-12, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("number", [10, 200])
def test_single_precision(number, rng):
    contacts = springs_on_sides(rng, number, 20e-6)
    single = jax.tree.map(lambda part: part.astype(jnp.float32), contacts)
    found = equilibrium(single, jnp.asarray(-800.0, jnp.float32), HardContact())
    wide = equilibrium(contacts, jnp.asarray(-800.0), HardContact())
    assert found.position.dtype == found.forces.dtype == jnp.float32
    np.testing.assert_allclose(found.position, wide.position, rtol=1e-5)
    np.testing.assert_allclose(found.forces, wide.forces, rtol=0, atol=1e-5 * float(wide.forces.max()))


def _largest_and_count(function, *arguments) -> tuple[int, int]:
    """Elements of the largest array in a program, and the number of its equations."""
    largest = count = 0
    open_programs = [jax.make_jaxpr(function)(*arguments).jaxpr]
    while open_programs:
        program = open_programs.pop()
        for equation in program.eqns:
            count += 1
            largest = max([largest, *(int(np.prod(out.aval.shape)) for out in equation.outvars)])
            for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: hasattr(x, "jaxpr")):
                if hasattr(value, "eqns") or hasattr(value, "jaxpr"):
                    open_programs.append(getattr(value, "jaxpr", value))
    return largest, count


def test_memory_grows_with_the_contacts_and_not_with_their_square(rng):
    """Neither an array of all by all, nor a program that grows; slopes included."""

    def force(contacts, gap):
        return jax.value_and_grad(lambda gap: _forces(contacts, gap, -300.0).max())(gap)

    sizes = {}
    for number in (100, 1000):
        contacts = springs_on_sides(rng, number, 20e-6)
        sizes[number] = _largest_and_count(force, contacts, contacts.gap)
        compiled = jax.jit(force).lower(contacts, contacts.gap).compile().memory_analysis()
        if compiled is not None:
            assert compiled.temp_size_in_bytes < 100 * 8 * number
    assert sizes[1000][0] <= 2 * 1000
    assert sizes[1000][1] == sizes[100][1]
