"""First contact and equilibrium of one-sided springs, against closed forms and brute force."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gearjax.contact import (
    ContactSet,
    HardContact,
    Layout,
    LinearSprings,
    QuadraticContact,
    SoftplusContact,
    equilibrium,
    first_contact,
)
from gearjax.contact.equilibrium import hard_edges, hard_rest

LEVER = 0.06


def contact_set(drive, back=(), stiffness=9e7):
    """Contacts from the rises of the driving flanks and the edges of the back flanks [m]."""
    gap = jnp.concatenate([-jnp.asarray(drive, float), jnp.asarray(back, float)])
    lever = jnp.concatenate([jnp.full(len(drive), -LEVER), jnp.full(len(back), LEVER)])
    springs = jnp.broadcast_to(jnp.asarray(stiffness, float), gap.shape)
    sides, pairs = (1,) * len(drive) + (-1,) * len(back), (*range(len(drive)), *range(len(back)))
    return ContactSet(lever[:, None], gap, LinearSprings(springs), Layout(sides, pairs))


def brute_force(contacts: ContactSet, load: float) -> float:
    """Try every set of active contacts; the right one closes exactly its own members."""
    lever, gap, springs = (np.asarray(x) for x in (contacts.lever, contacts.gap, contacts.linear))
    for active in itertools.product((False, True), repeat=len(gap)):
        on = np.array(active)
        if not on.any():
            continue
        q = (load + (lever * springs * gap)[on].sum()) / (lever**2 * springs)[on].sum()
        overlap = lever * q - gap
        if (overlap[on] >= -1e-18).all() and (overlap[~on] <= 1e-18).all():
            return q
    raise AssertionError("no equilibrium")


rises = st.floats(-40e-6, 40e-6)
torques = st.floats(0.01, 3000.0)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(rises, rises, torques)
def test_two_springs_closed_form(first, second, torque):
    """Wang et al. (2020), eq. 18, to 1e-12 of the deflection and the rises."""
    found = equilibrium(contact_set([first, second]), jnp.asarray(-torque), HardContact())
    q = torque / (LEVER * 9e7)
    expected = max(first - q, second - q, (first + second - q) / 2) / LEVER
    scale = max(abs(first), abs(second), q) / LEVER
    assert abs(float(found.position) - expected) <= 1e-12 * scale
    assert int(found.result) == 0


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    st.lists(rises, min_size=3, max_size=3),
    st.lists(st.floats(1e7, 3e8), min_size=6, max_size=6),
    st.lists(st.floats(60e-6, 200e-6), min_size=3, max_size=3),
    st.floats(-3000.0, 3000.0).filter(lambda t: abs(t) > 1e-3),
)
def test_three_pairs_against_brute_force(drive, springs, back, torque):
    contacts = contact_set(drive, back, springs)
    found = equilibrium(contacts, jnp.asarray(-torque), HardContact())
    expected = brute_force(contacts, -torque)
    assert float(found.position) == pytest.approx(expected, rel=1e-11, abs=1e-15)
    assert float((contacts.lever * found.forces).sum()) == pytest.approx(-torque, rel=1e-10)
    assert bool((found.forces >= -1e-9 * abs(torque)).all())


@pytest.mark.slow
def test_jammed_flanks_against_brute_force(rng):
    """Back edges below the driving edges: both sides carry force, with or without a torque."""
    for _ in range(50):
        contacts = contact_set(rng.uniform(0, 30e-6, 3), rng.uniform(-20e-6, 10e-6, 3), rng.uniform(1e7, 3e8, 6))
        for torque in (0.0, 5.0, -200.0):
            found = equilibrium(contacts, jnp.asarray(-torque), HardContact())
            assert float(found.position) == pytest.approx(brute_force(contacts, -torque), rel=1e-10, abs=1e-15)


@pytest.mark.slow
def test_zero_torque_is_the_first_driving_contact(rng):
    contacts = contact_set(rng.uniform(-20e-6, 20e-6, 4), rng.uniform(50e-6, 90e-6, 4))
    lower, upper = first_contact(contacts, HardContact())
    found = equilibrium(contacts, jnp.asarray(0.0), HardContact())
    assert float(found.position) == pytest.approx(float(lower), abs=1e-18)
    assert not np.asarray(found.forces).any()
    assert upper is not None
    assert float(upper) > float(lower)


@pytest.mark.slow
def test_no_flank_to_carry_the_torque():
    found = equilibrium(contact_set([1e-6, 2e-6]), jnp.asarray(5.0), HardContact())
    assert int(found.result) == 1
    assert np.isnan(float(found.position))
    smooth = equilibrium(contact_set([1e-6, 2e-6]), jnp.asarray(5.0), SoftplusContact(1e-7))
    assert int(smooth.result) == 1


@pytest.mark.parametrize("extreme", [1e-9, 1e-3, 1e12])
@pytest.mark.parametrize("stiffness", [1e2, 1e15])
def test_extremes_stay_finite_and_balanced(extreme, stiffness):
    contacts = contact_set([3e-6, -8e-6], [1e-4, 1.2e-4], stiffness)
    for torque in (extreme, -extreme):
        found = equilibrium(contacts, jnp.asarray(-torque), HardContact())
        assert np.isfinite(float(found.position))
        assert float((contacts.lever * found.forces).sum()) == pytest.approx(-torque, rel=1e-6)


@pytest.mark.parametrize("law", [SoftplusContact, QuadraticContact])
@pytest.mark.parametrize("torque", [0.0, 0.3, 30.0, 1000.0, -80.0])
def test_smooth_equilibrium_converges_and_balances(law, torque, rng):
    """First order in the width, no further than the smoothing of the maximum, torque balanced exactly."""
    for _ in range(10):
        contacts = contact_set(rng.uniform(-20e-6, 20e-6, 3), rng.uniform(60e-6, 90e-6, 3))
        hard = equilibrium(contacts, jnp.asarray(-torque), HardContact())
        for width in (1e-6, 1e-8):
            smooth = equilibrium(contacts, jnp.asarray(-torque), law(width))
            bound = width * np.log(64) if law is SoftplusContact else width
            assert abs(float(smooth.position - hard.position)) * LEVER <= bound * (1 + 1e-9)
            assert float((contacts.lever * smooth.forces).sum()) == pytest.approx(
                -torque, abs=1e-9 + 1e-9 * abs(torque)
            )


@pytest.mark.slow
def test_softplus_equilibrium_is_the_reference_form():
    """Two pairs: logsumexp of {D1 - q, D2 - q, (D1 + D2 - q) / 2}."""
    first, second, torque, width = 4e-6, 6e-6, 20.0, 5e-7
    q = torque / (LEVER * 9e7)
    values = jnp.array([first - q, second - q, (first + second - q) / 2])
    expected = width * jax.nn.logsumexp(values / width) / LEVER
    found = equilibrium(contact_set([first, second]), jnp.asarray(-torque), SoftplusContact(width))
    assert float(found.position) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("law", [SoftplusContact, QuadraticContact])
def test_of_many_pairs_the_smooth_balance_is_searched_for(law, rng):
    """More than the closed form is for: it balances the torque and tends to the hard one with the width."""
    contacts = contact_set(list(rng.uniform(0, 5e-6, 12)))
    for torque in (1.0, 50.0):
        hard = equilibrium(contacts, jnp.asarray(-torque), HardContact())
        apart = []
        for width in (1e-7, 1e-9):
            smooth = equilibrium(contacts, jnp.asarray(-torque), law(width))
            assert float(contacts.lever @ smooth.forces) == pytest.approx(-torque, rel=1e-9)
            apart.append(abs(float(smooth.position - hard.position)) * LEVER)
        assert apart[0] < 1e-7 * np.log(2**12)
        assert apart[1] < 1e-9 * np.log(2**12)


def test_rigid_contacts_are_refused():
    rigid = ContactSet(jnp.array([[-1.0]]), jnp.array([0.0]), None, Layout.of_flanks(1, back=False))
    with pytest.raises(ValueError, match="rigid contacts"):
        equilibrium(rigid, jnp.asarray(-1.0), HardContact())


def test_more_than_one_degree_of_freedom_is_refused():
    wide = ContactSet(jnp.ones((2, 3)), jnp.zeros(2), LinearSprings(jnp.ones(2)), Layout.of_flanks(2, back=False))
    with pytest.raises(ValueError, match="one degree of freedom"):
        equilibrium(wide, jnp.asarray(-1.0), HardContact())


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(rises, st.floats(1e6, 1e9)), min_size=1, max_size=4),
    st.floats(-3000.0, 3000.0),
    st.booleans(),
)
def test_contacts_written_out_rest_where_contact_sets_do(pairs, torque, has_back):
    drive, springs = (list(part) for part in zip(*pairs, strict=True))
    back = [10e-6 - rise for rise in drive] if has_back else []
    contacts = contact_set(drive, back, springs * (2 if has_back else 1))
    touch = list(contacts.gap / contacts.lever)
    strength = list(contacts.linear * contacts.lever**2)
    found = hard_rest(touch, strength, contacts.layout.side, jnp.asarray(-torque))
    rest = equilibrium(contacts, jnp.asarray(-torque), HardContact())
    if int(rest.result):
        assert np.isnan(found)
    elif torque:  # at rest without a load the driving flanks touch, here and there
        np.testing.assert_allclose(found, rest.position, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(
        [edge for edge in hard_edges(touch, contacts.layout.side) if edge is not None],
        [edge for edge in first_contact(contacts, HardContact()) if edge is not None],
    )
