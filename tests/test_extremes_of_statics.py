"""Equilibria of one-sided springs against exact rational arithmetic, from hardly any torque to far too much."""

import dataclasses
from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import ContactSet, HardContact, Layout, LinearSprings, LineSprings, equilibrium
from gearjax.units import um
from tests.rv import HERTZ, LINEAR, scene, with_errors

TORQUES = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 784.0, 1e6)


def exact_equilibrium(lever, gap, stiffness, load):
    """Position and forces of hard springs, in fractions: the sum of forces is made of straight lines, which are gone
    through one by one."""
    lever, gap, stiffness = ([Fraction(float(x)) for x in part] for part in (lever, gap, stiffness))
    load = Fraction(float(load))
    touch = [g / arm for g, arm in zip(gap, lever, strict=True)]

    def forces(q):
        return [k * max(arm * q - g, Fraction(0)) for arm, g, k in zip(lever, gap, stiffness, strict=True)]

    def moment(q):
        return sum(arm * f for arm, f in zip(lever, forces(q), strict=True))

    if load == 0:
        drive = max(t for t, arm in zip(touch, lever, strict=True) if arm < 0)
        if moment(drive) == 0:
            return drive, forces(drive)
    ends = sorted(touch)
    below = [end for end in ends if moment(end) <= load]
    above = [end for end in ends if moment(end) > load]
    inner = below[-1] + 1 if below and not above else above[0] - 1 if not below else (below[-1] + above[0]) / 2
    closed = [arm * inner > g for arm, g in zip(lever, gap, strict=True)]
    weight = sum(k * arm * arm for arm, k, on in zip(lever, stiffness, closed, strict=True) if on)
    pull = sum(k * arm * g for arm, g, k, on in zip(lever, gap, stiffness, closed, strict=True) if on)
    position = (load + pull) / weight
    return position, forces(position)


solve = eqx.filter_jit(lambda contacts, load: equilibrium(contacts, load, HardContact()))


def check(contacts: ContactSet, load: float, relative: float):
    found = solve(contacts, jnp.asarray(load))
    position, forces = exact_equilibrium(contacts.lever, contacts.gap, contacts.linear, load)
    assert int(found.result) == 0
    assert float(found.position) == pytest.approx(float(position), rel=1e-12, abs=1e-18)
    # a force is as exact as the gaps are: rounding of them, times the stiffness
    rounding = float(jnp.max(contacts.linear) * jnp.max(jnp.abs(contacts.gap))) * 1e-15
    np.testing.assert_allclose(found.forces, [float(f) for f in forces], rtol=relative, atol=rounding)
    carried = max(abs(float(arm)) * float(f) for arm, f in zip(contacts.lever, forces, strict=True))
    balance = float((contacts.lever * found.forces).sum())
    assert balance == pytest.approx(load, rel=0, abs=1e-12 * max(carried, abs(load)))


def random_contacts(rng: np.random.Generator, sides_turn: bool, pairs: int, back: bool) -> ContactSet:
    if sides_turn:
        lever = 0.06 * np.sin(rng.uniform(0, 2 * np.pi, pairs))
        gap = rng.uniform(0, 3e-5, pairs)
        springs, layout = np.full(pairs, 1.6e8), Layout.either(pairs)
        return ContactSet(jnp.asarray(lever[:, None]), jnp.asarray(gap), LinearSprings(jnp.asarray(springs)), layout)
    layout = Layout.of_flanks(pairs, back)
    lever = np.concatenate([np.full(pairs, -0.06), np.full(pairs if back else 0, 0.06)])
    gap = rng.uniform(-2e-5, 2e-5, lever.size) + 4e-5 * (lever > 0)
    springs = rng.uniform(0.5e8, 2e8, pairs)
    springs = np.concatenate([springs, springs]) if back else springs
    return ContactSet(jnp.asarray(lever[:, None]), jnp.asarray(gap), LinearSprings(jnp.asarray(springs)), layout)


@pytest.mark.parametrize("sides_turn", [False, True])
def test_equilibria_are_exact_to_rounding(sides_turn, rng):
    for torque in TORQUES:
        check(random_contacts(rng, sides_turn, 12 if sides_turn else 3, back=True), -torque, 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("sides_turn", [False, True])
def test_many_equilibria_are_exact_to_rounding(sides_turn):
    for seed in range(24):
        rng = np.random.default_rng(seed)
        contacts = random_contacts(rng, sides_turn, (1, 2, 5, 12)[seed % 4] + 6 * sides_turn, back=True)
        for sign in (1.0, -1.0):
            for torque in (*TORQUES, float(10 ** rng.uniform(-14, 7))):
                if sides_turn and not bool((sign * contacts.lever < -0.002).any()):
                    continue
                check(contacts, -sign * torque, 1e-9)


@pytest.mark.parametrize("torque", [0.0, 1e-12, 1e-9])
def test_hardly_any_torque_rests_on_the_first_contact_at_every_angle(torque, scene):
    """Without back flanks, whose driving contacts the rounding of a zero once lost at half of the angles."""
    drive = dataclasses.replace(scene, backlash=None)
    theta = jnp.linspace(0.0, drive.system.cycle, 4001)
    te = gj.transmission_error(drive, theta, torque)
    assert not bool(te.result.any())
    assert bool(jnp.isfinite(te.te).all())
    np.testing.assert_allclose(te.te, gj.transmission_error(drive, theta).te, rtol=0, atol=1e-16 + 1e-5 * torque)
    balance = -float(drive.system.radius) * te.forces.sum(axis=1)
    np.testing.assert_allclose(balance, -torque, rtol=1e-12, atol=0)


@pytest.mark.parametrize("compliance", [LINEAR, pytest.param(HERTZ, marks=pytest.mark.slow)], ids=lambda c: c.kind)
def test_forces_of_pins_balance_hardly_any_torque(compliance):
    one, theta = scene(with_errors=True, compliance=compliance), jnp.asarray([0.3, 0.8, 2.9])
    for torque in (1e-12, -1e-12):
        te = gj.transmission_error(one, theta, torque)
        for angle, forces in zip(theta, te.forces, strict=True):
            lever = one.contacts(angle).lever
            assert float((lever * forces).sum()) == pytest.approx(-torque, rel=1e-9)


@pytest.mark.slow
def test_derivatives_hold_at_hardly_any_torque():
    one, theta = scene(with_errors=True), jnp.asarray([0.3])

    def te(size, torque):
        larger = gj.Sizes("pin_ring", jnp.full((40,), size))
        return gj.transmission_error(with_errors(one, size=larger), theta, torque).te[0]

    for torque in (0.0, 1e-12):
        slope = jax.grad(te)(jnp.asarray(0.0), torque)
        step = (te(1e-9, torque) - te(-1e-9, torque)) / 2e-9
        assert float(slope) == pytest.approx(float(step), rel=1e-6)


@pytest.mark.slow
def test_a_line_contact_takes_the_smallest_force():
    springs = LineSprings(jnp.full((1,), 2.5e-10), jnp.full((1,), 15.0))
    contacts = ContactSet(jnp.asarray([[-0.06]]), jnp.asarray([3e-5]), springs, Layout.of_flanks(1, back=False))
    found = equilibrium(contacts, jnp.asarray(-1e-12), HardContact())
    assert float(found.forces[0]) == pytest.approx(1e-12 / 0.06, rel=1e-9)


# interference ---------------------------------------------------------------------------------------------------------


def overlap_by_trying(contacts: ContactSet) -> float:
    """The least of the deepest overlaps, by looking at very many positions."""
    lever, gap = np.asarray(contacts.lever), np.asarray(contacts.gap)
    low, high = -2e-3, 2e-3
    for _ in range(6):
        q = np.linspace(low, high, 2001)
        deepest = (lever[:, None] * q - gap[:, None]).max(axis=0)
        best, span = int(np.argmin(deepest)), (high - low) / 1000
        low, high = q[best] - span, q[best] + span
    return float(deepest.min())


def test_the_least_overlap_is_that_of_trying_all_positions(rng):
    for design in ("conjugate", "initial", "modified"):
        one = scene(design, with_errors=True)
        for angle in rng.uniform(0, 200, 3):
            found = gj.interference(one, jnp.asarray([angle]))
            tried = overlap_by_trying(one.contacts(jnp.asarray(angle)))
            assert float(found.overlap[0]) == pytest.approx(tried, abs=1e-10)


@pytest.mark.parametrize("shifting", [0.0, pytest.param(43.7e-6, marks=pytest.mark.slow)])
def test_interference_is_named_and_no_position_comes_out_of_a_vanishing_lever(shifting):
    """Without modification, errors of some um leave a pin at a tooth's tip no room: once a position of 1 rad."""
    one = scene("conjugate", with_errors=True, shifting_modification=shifting)
    theta = jnp.linspace(0.0, 2 * jnp.pi, 801)
    te, play = gj.transmission_error(one, theta), gj.backlash(one, theta)
    assert bool((te.result == 2).any())
    assert bool((play.result == 2).any())
    samples, peak_to_peak = float(jnp.ptp(te.te)), float(te.peak_to_peak)
    assert samples <= peak_to_peak < 0.0363  # 400,000 samples swing by 0.0362 with the shifting
    assert 1e-6 < float(te.interference.overlap.max()) < 60 * um
    words = te.interference.told(one)
    assert "um (pin " in words
    assert "disc_" in words
    assert "deg)" in words
    # elastic pins carry a torque in spite of it, under preload
    assert not bool(gj.transmission_error(one, theta[::50], 784.0).result.any())


@pytest.mark.slow
def test_a_clear_reducer_does_not_interfere(scene):
    theta = jnp.linspace(0.0, scene.system.cycle, 801)
    play = gj.backlash(scene, theta)
    assert bool(((play.backlash < 0) == (play.result == 2)).all())
    assert gj.interference(scene, theta).told(scene) is None
    assert gj.transmission_error(scene, theta).interference is None  # the driving flanks alone


# load sharing, angles -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_load_sharing_of_pins_counts_those_that_could_carry():
    one, theta = scene("conjugate", discs=1), jnp.asarray([0.05, 0.31, 2.0])
    te = gj.transmission_error(one, theta, 431.0)
    for angle, forces, sharing in zip(theta, te.forces, te.load_sharing, strict=True):
        able = int((one.contacts(angle).lever < 0).sum())
        assert able in (19, 20)
        assert float(sharing) == pytest.approx(able * float(forces.max() / forces.sum()), rel=1e-12)


@pytest.mark.slow
def test_few_angles_are_told_where_extremes_between_them_are_asked_for(rng):
    one = scene(discs=1)
    coarse = gj.transmission_error(one, jnp.asarray(np.sort(rng.uniform(0, 0.5, 41))))
    with pytest.warns(gj.FewAngles, match=r"only .* angles per cycle of the fastest order \(40"):
        _ = coarse.peak_to_peak
    with pytest.warns(gj.FewAngles):
        _ = gj.backlash(one, jnp.asarray([0.0, 0.1, 0.2])).range
    fine = gj.transmission_error(one, jnp.linspace(0.0, 0.5, 1 + int(20 * 40 * 0.5 / (2 * np.pi)) + 1))
    assert float(fine.peak_to_peak) > 0
    assert float(gj.transmission_error(one, jnp.asarray([0.1])).peak_to_peak) == 0.0


@pytest.mark.slow
def test_interference_in_a_population_names_its_worst_gear_set():
    one = scene("conjugate", discs=1, with_errors=True)
    tolerances = gj.Tolerances(one, {f"errors.pins.outward[{pin}]": gj.Normal(0.0, 1 * um) for pin in range(40)})
    from gearjax.tolerance import Work
    from gearjax.tolerance.interference import clashes

    theta = jnp.linspace(0.0, 2 * jnp.pi, 41)
    work = Work(tolerances, ["backlash.minimum"], number=6, theta=theta, extremes="samples")
    rows = work.inputs(0, 6)
    found = clashes(tolerances, rows, theta)
    alone = [gj.interference(tolerances.free.set(one, jnp.asarray(row)), theta) for row in rows]
    assert found.interfering == sum(bool(each.interferes.any()) for each in alone) > 0
    assert found.overlap == pytest.approx(float(alone[found.sample].overlap.max()), rel=1e-12)
    assert found.told.startswith(f"interference: rigid bodies overlap in {found.interfering} of the first 6 gear sets")
    assert "um (pin " in found.told
