"""The RV reducer against an independent study, exact cases, properties and extremes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.geometry.cycloid_errors import geometric_error
from gearjax.units import arcmin, mm, um
from tests.rv import ACCEPTED, HERTZ, HU, LINEAR, PLACES, TORQUE, angles, scene, share, system, with_errors

LAWS = {"linear": LINEAR, "line": HU}


def arms(one: gj.Scene, theta: float) -> np.ndarray:
    return np.asarray(one.contacts(jnp.asarray(theta)).lever)


def check_accepted(row):
    one = scene(row.design, row.discs, with_errors=row.with_errors, compliance=LAWS[row.law])
    theta = jnp.asarray(angles(39 if row.with_errors else 1))
    # the study loads the pins behind the throw: without errors the stage is its own mirror, with errors it is another
    # flank, which a load that helps the output carries
    te, play = gj.transmission_error(one, theta, -share(row.discs)), gj.backlash(one, theta)
    # the study leaves the shifting out of the curvature and of the short-width coefficient of its line contacts
    relative = (2e-2 if row.with_errors else 5e-2) if row.law == "line" else 1e-5
    assert float(jnp.ptp(te.te)) / arcmin == pytest.approx(row.peak_to_peak, rel=relative)
    assert float(te.mean) / arcmin == pytest.approx(row.mean, abs=1e-3 if row.law == "line" else 1e-5)
    assert float(play.backlash.min()) / arcmin == pytest.approx(row.backlash[0], abs=1e-5)
    assert float(play.mean) / arcmin == pytest.approx(row.backlash[1], abs=1e-5)
    assert float(te.forces.max()) == pytest.approx(row.force, rel=1e-2 if row.law == "line" else 1e-5)
    assert (int(te.engaged.min()), int(te.engaged.max())) == row.engaged
    if row.unloaded is not None:
        assert float(jnp.ptp(play.upper)) / arcmin == pytest.approx(row.unloaded, abs=1e-6)
    if not row.with_errors:
        forward = gj.transmission_error(one, theta, share(row.discs))
        assert -float(forward.mean) / arcmin == pytest.approx(row.mean, abs=1e-3 if row.law == "line" else 1e-5)


@pytest.mark.slow
def test_one_row_of_the_study():
    check_accepted(ACCEPTED[6])


@pytest.mark.slow
@pytest.mark.parametrize("row", ACCEPTED, ids=str)
def test_the_study(row):
    check_accepted(row)


@pytest.mark.slow
def test_backlash_is_the_closed_formula_within_the_pins_being_discrete():
    play = gj.backlash(scene(), jnp.asarray(angles()))
    closed = float(geometric_error(system().profile, {}))
    assert float(play.backlash.min()) == pytest.approx(closed, rel=0.02)


@pytest.mark.parametrize(
    ("compliance", "torque"),
    [
        (HERTZ, -784.0),
        pytest.param(LINEAR, 784.0, marks=pytest.mark.slow),
        *(pytest.param(law, t, marks=pytest.mark.slow) for law in (LINEAR, HU, HERTZ) for t in (-784.0, 1e-6, 1e6)),
    ],
)
def test_forces_balance_the_torque(compliance, torque):
    one, theta = scene("modified", with_errors=True, compliance=compliance), jnp.asarray(angles(per_turn=7))
    te = gj.transmission_error(one, theta, torque)
    assert not bool(te.result.any())
    for angle, forces in zip(theta, te.forces, strict=True):
        assert float((arms(one, float(angle)) * forces).sum()) == pytest.approx(-torque, rel=1e-6, abs=1e-6)


@pytest.mark.slow
def test_the_linear_law_is_solved_exactly():
    """Against the sums over the set of contacts that carry, found by trying."""
    one, theta = scene(with_errors=True), 0.7
    te = gj.transmission_error(one, jnp.asarray([theta]), TORQUE)
    contacts = one.contacts(jnp.asarray(theta))
    lever, gap, stiffness = np.asarray(contacts.lever), np.asarray(contacts.gap), 1.6465e8
    closed = np.asarray(te.forces[0]) > 0
    position = (-TORQUE / stiffness + (lever * gap)[closed].sum()) / (lever[closed] ** 2).sum()
    assert float(te.te[0]) == pytest.approx(position, rel=1e-13)
    assert ((lever * position - gap > 0) == closed).all()


@pytest.mark.slow
def test_an_approach_is_inverted_to_rounding():
    springs = scene(compliance=HERTZ).contacts(jnp.asarray(0.3), "mean").springs
    for force in (1e-3, 1.0, 1e3, 1e5):
        forces = jnp.full((80,), force)
        np.testing.assert_allclose(springs.force(springs.approach(forces)), forces, rtol=1e-10)


def test_hertz_is_stiffer_than_the_paper_by_as_much_as_the_study_found():
    own = system()
    place = jnp.arccos(own.profile.modified_short_width)
    from gearjax.geometry.cycloid import curvature
    from gearjax.geometry.line_contact import Radii

    radii = Radii(jnp.asarray([3 * mm]), curvature(own.profile, place)[None])
    soft, stiff = (float(law.springs(radii).approach(jnp.array([1910.0]))[0]) for law in (HU, HERTZ))
    assert soft / mm == pytest.approx(0.0116, abs=5e-5)
    assert soft / stiff == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("compliance", [LINEAR, pytest.param(HERTZ, marks=pytest.mark.slow)])
def test_gradients_are_central_differences_under_vmap_and_jit(compliance):
    one = scene(with_errors=True, compliance=compliance)
    theta = jnp.asarray(angles(per_turn=16))

    def lag(numbers, torque):
        changed = dataclasses.replace(
            system(), isometric_modification=numbers[0], shifting_modification=numbers[1], eccentricity=numbers[2]
        )
        pins = one.errors["pins"]
        moved = dataclasses.replace(pins, outward=pins.outward.at[5].set(numbers[3]))
        again = dataclasses.replace(with_errors(one, pins=moved), system=changed)
        return gj.transmission_error(again, theta, torque).te.mean()

    start = np.array([-22e-6, -43.7e-6, 1.5e-3, 1e-6])
    rows = jnp.asarray(start[None] * (1 + 0.05 * np.arange(3)[:, None] * [1, 1, 0, 1]))
    torques = jnp.array([300.0, 784.0, 1500.0])
    slopes = jax.jit(jax.vmap(jax.grad(lag, argnums=(0, 1))))(rows, torques)
    value = jax.jit(lag)
    for row, torque, by_number, by_torque in zip(rows, torques, *slopes, strict=True):
        for index, step in enumerate((1e-10, 1e-10, 1e-9, 1e-10)):
            move = jnp.zeros(4).at[index].set(step)
            slope = (value(row + move, torque) - value(row - move, torque)) / (2 * step)
            assert float(by_number[index]) == pytest.approx(float(slope), rel=1e-6, abs=1e-8)
        slope = (value(row, torque + 1e-3) - value(row, torque - 1e-3)) / 2e-3
        assert float(by_torque) == pytest.approx(float(slope), rel=1e-6)


@pytest.mark.slow
def test_at_a_contact_change_the_one_sided_slopes_bracket_the_derivative():
    one, theta = scene(), jnp.asarray([0.35])

    def engaged(torque):
        return int(gj.transmission_error(one, theta, torque).engaged[0])

    low, high = 500.0, 1500.0
    assert engaged(low) < engaged(high)
    while high - low > 1e-10 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if engaged(middle) == engaged(500.0) else (low, middle)
    slope = jax.grad(lambda t: gj.transmission_error(one, theta, t).te[0])
    below, here, above = (float(slope(jnp.asarray(t))) for t in (low - 1e-3, high, high + 1e-3))
    assert below < above < 0  # the output gives way less once one more pin carries
    assert below * (1 + 1e-6) <= here <= above * (1 - 1e-6)


@pytest.mark.slow
def test_a_batch_is_a_loop():
    theta = jnp.asarray(angles(per_turn=8))
    one = scene(with_errors=True, compliance=HU)
    values = jnp.array([-30e-6, -22e-6, 5e-6])

    def te(isometric):
        changed = dataclasses.replace(one.system, isometric_modification=isometric)
        return gj.transmission_error(dataclasses.replace(one, system=changed), theta, 784.0).te

    np.testing.assert_allclose(jax.vmap(te)(values), jnp.stack([te(v) for v in values]), rtol=1e-12)


@pytest.mark.slow
def test_zero_torque_rests_on_the_first_contact_and_a_negative_one_on_the_other_flank():
    one, theta = scene(with_errors=True), jnp.asarray(angles(per_turn=16))
    play = gj.backlash(one, theta)
    np.testing.assert_allclose(gj.transmission_error(one, theta, 0.0).te, play.lower, atol=1e-12)
    back = gj.transmission_error(one, theta, -784.0)
    assert bool((back.te > play.upper).all())


@pytest.mark.slow
def test_a_mirrored_stage_gives_way_as_much_backwards():
    """Without errors the stage is the same seen from behind."""
    one, theta = scene(), jnp.asarray(angles(per_turn=10))
    forward = gj.transmission_error(one, theta, 784.0).te
    backward = gj.transmission_error(one, -theta[::-1], -784.0).te[::-1]
    np.testing.assert_allclose(backward, -forward, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("compliance", [LINEAR, HERTZ], ids=lambda c: c.kind)
def test_one_pin_alone_and_one_pin_missing(compliance):
    whole, theta = scene(discs=1, compliance=compliance), jnp.asarray([0.3, 0.31])
    thin = np.full(40, -1 * mm)
    thin[9] = 0.0
    alone = gj.transmission_error(with_errors(whole, size=gj.Sizes("pin_ring", thin)), theta, 50.0)
    np.testing.assert_array_equal(np.flatnonzero(np.asarray(alone.forces[0])), [9])
    assert float(alone.forces[0, 9] * -arms(whole, 0.3)[9]) == pytest.approx(50.0, rel=1e-9)
    missing = np.zeros(40)
    missing[9] = -1 * mm
    less = gj.transmission_error(with_errors(whole, size=gj.Sizes("pin_ring", missing)), theta, 431.0)
    assert float(less.forces[0, 9]) == 0.0
    assert bool((less.te < gj.transmission_error(whole, theta, 431.0).te).all())


@pytest.mark.slow
def test_without_modification_half_of_the_pins_carry():
    te = gj.transmission_error(scene("conjugate", discs=1), jnp.asarray(angles()), 431.2)
    assert int(te.engaged.min()) in (19, 20)
    assert float(te.te.max()) < 0


@pytest.mark.slow
def test_a_straight_flank_has_finite_forces_and_gradients():
    """Where the curvature changes its sign, the logarithm of eq. 38 would be infinite."""
    own = system(discs=1)
    short = float(own.profile.modified_short_width)
    inflection = np.arccos((1 + 40 * short**2) / (short * 41))
    one = scene(discs=1, compliance=HU)
    te = gj.transmission_error(one, jnp.asarray([inflection]), 431.0)
    assert bool(jnp.isfinite(te.te).all())
    slope = jax.grad(lambda t: gj.transmission_error(one, jnp.asarray([inflection]), t).te[0])(jnp.asarray(431.0))
    assert np.isfinite(float(slope))


@pytest.mark.slow
def test_interference_shows_as_negative_backlash_and_at_the_edges_nothing_is_infinite():
    play = gj.backlash(scene("modified", with_errors=True), jnp.asarray(angles(2)))
    assert float(play.backlash.min()) < 0
    assert bool(jnp.isfinite(play.lower).all())
    assert bool(jnp.isfinite(play.upper).all())


@pytest.mark.slow
@pytest.mark.parametrize("clearance", ["linear", "exact"])
def test_the_exact_gap_is_an_option_and_close(clearance):
    theta = jnp.asarray(angles(per_turn=32))
    linear, exact = (gj.transmission_error(scene(clearance=c), theta, 784.0).te for c in ("linear", clearance))
    apart = float(jnp.abs(linear - exact).max()) / arcmin
    assert apart == 0.0 if clearance == "linear" else 1e-4 < apart < 0.02


@pytest.mark.slow
def test_errors_repeat_after_a_turn_of_the_output_and_discs_are_half_a_turn_apart():
    one = scene(with_errors=True)
    assert one.system.cycle == pytest.approx(2 * np.pi * 39)
    theta = jnp.asarray([0.2, 1.4])
    first = gj.transmission_error(one, theta, 784.0).te
    np.testing.assert_allclose(gj.transmission_error(one, theta + one.system.cycle, 784.0).te, first, rtol=1e-9)
    alone = scene(discs=1)
    both = scene().contacts(jnp.asarray(0.4))
    later = alone.contacts(jnp.asarray(0.4 + np.pi))
    np.testing.assert_allclose(both.gap[40:], later.gap, atol=1e-18)


def test_an_eccentric_pin_ring_is_pins_that_are_all_displaced():
    theta, size, phase = jnp.asarray(0.9), 3e-6, 0.4
    ring = with_errors(scene(), ring=gj.Eccentricity("pin_ring", size, phase))
    along = size * np.cos(PLACES - phase), -size * np.sin(PLACES - phase)
    pins = with_errors(scene(), pins=gj.Positions("pin_ring", *along))
    np.testing.assert_allclose(ring.contacts(theta).gap, pins.contacts(theta).gap, atol=1e-18)


def test_one_value_stands_for_all_pins():
    theta = jnp.asarray(0.9)
    one = with_errors(scene(), pins=gj.Positions("pin_ring", [2e-6], []), size=gj.Sizes("pin_ring", [1e-6]))
    each = with_errors(scene(), pins=gj.Positions("pin_ring", [2e-6] * 40, []), size=gj.Sizes("pin_ring", [1e-6] * 40))
    np.testing.assert_array_equal(one.contacts(theta).gap, each.contacts(theta).gap)


def test_a_longer_throw_is_an_error_along_it():
    theta, more = jnp.asarray(0.9), 1e-7
    listed = with_errors(scene("conjugate"), throw=gj.Eccentricity("throw", more, 0.0)).contacts(theta).gap
    own = system("conjugate").profile
    from gearjax.geometry.cycloid import pin_distance, trochoid

    crank = 0.9 + np.repeat([0.0, np.pi], 40)
    angle = jnp.asarray(crank - np.tile(PLACES, 2))
    pin = trochoid(own._replace(throw=own.throw + more), angle)
    np.testing.assert_allclose(listed, pin_distance(own, pin, angle), atol=1e-11)


@pytest.mark.slow
def test_the_first_stage_adds_its_error_and_costs_nothing_where_it_is_absent():
    first = {"sun_teeth": 22, "planet_teeth": 60, "first_stage_module": 1.25 * mm}
    two_stages = scene(**first)
    assert float(two_stages.system.ratio) == pytest.approx(1 + 60 / 22 * 40)
    theta = jnp.asarray(angles(1, 64)) * float(two_stages.system.ratio) / 39
    clean = gj.transmission_error(two_stages, theta, 784.0).te
    longer = (40 + 22 / 60) / 39  # levers, as the cranks turn with the output
    held = gj.transmission_error(scene(), jnp.asarray(angles(1, 64)), 784.0 / longer).te / longer
    np.testing.assert_allclose(clean, held, rtol=1e-9)
    sun = with_errors(two_stages, sun=gj.Eccentricity("sun", 10 * um, 0.3))
    added = np.asarray(gj.transmission_error(sun, theta, 784.0).te - clean)
    radius = 0.5 * 60 * 1.25 * mm * np.cos(np.radians(20))
    turns = 1 - 1 / float(two_stages.system.ratio)  # of the sun, seen from the output
    expected = 10 * um / ((40 + 22 / 60) * radius) * np.sin(turns * np.asarray(theta) + 0.3)
    np.testing.assert_allclose(added, expected, atol=1e-13)
    one = jnp.asarray(0.3)
    bare, listed = (str(jax.make_jaxpr(lambda t, s=s: s.contacts(t).gap)(one)) for s in (scene(), sun))
    assert len(bare) < len(listed)


@pytest.mark.slow
def test_lost_motion_is_backlash_and_a_little_wind_up():
    theta = jnp.asarray(angles(per_turn=16))
    lost = gj.lost_motion(scene(), theta, TORQUE)
    te = [gj.transmission_error(scene(), theta, t).te for t in (0.03 * TORQUE, -0.03 * TORQUE)]
    np.testing.assert_allclose(lost.lost_motion, te[1] - te[0], rtol=1e-10)
    np.testing.assert_allclose(lost.backlash, gj.backlash(scene(), theta).backlash, rtol=1e-12)
    assert bool((lost.wind_up > 0).all())
    with pytest.raises(gj.ParameterError, match="rated_torque"):
        gj.lost_motion(scene(), theta, 0.0)


@pytest.mark.slow
def test_the_torsion_curve_is_stiffer_the_more_pins_carry():
    theta = jnp.asarray(angles(per_turn=4))
    curve = gj.torsion(scene(), theta, jnp.array([50.0, 200.0, 800.0, 1600.0]))
    assert bool((jnp.diff(curve.stiffness, axis=0) > 0).all())
    conjugate = gj.torsion(scene("conjugate"), theta, jnp.array([400.0, 800.0])).stiffness
    arm = -np.minimum(arms(scene("conjugate"), 0.0), 0.0)
    assert float(conjugate[0, 0]) == pytest.approx(1.6465e8 * (arm**2).sum(), rel=1e-9)
    with pytest.raises(gj.ParameterError, match="must increase"):
        gj.torsion(scene(), theta, jnp.array([2.0, 1.0]))


@pytest.mark.slow
def test_pressure_is_that_of_hertz():
    one, theta = scene(discs=1, compliance=HERTZ), jnp.asarray([0.3])
    te = gj.transmission_error(one, theta, 431.0)
    pressure = gj.contact_pressure(one, te)
    pin = int(jnp.argmax(te.forces[0]))
    radii = one.system.pose(theta[0], gj.Request(radii=True)).radii
    relative = 1 / (1 / (3 * mm) + float(radii.curvature[pin]))
    modulus = 2.06e11 / (2 * (1 - 0.09))
    expected = np.sqrt(float(te.forces[0, pin]) * modulus / (np.pi * 11 * mm * relative))
    assert float(pressure[0, pin]) == pytest.approx(expected, rel=1e-12)
    linear = scene(discs=1)
    with pytest.raises(gj.SceneError, match="material"):
        gj.contact_pressure(linear, gj.transmission_error(linear, theta, 431.0))


MISTAKES = {
    'kind = "positions"\nbody = "disc_1"\noutward = ["1 um", "2 um"]\naround = []': r"errors.extra.outward.*one value",
    'kind = "positions"\nbody = "pin_ring"\noutward = ["1 um", "2 um"]\naround = []': r"extra.outward.*must be 40",
    'kind = "sizes"\nbody = "throw"\nlarger = ["1 um"]': r"errors.extra.body = \"throw\": has no rim",
    'kind = "eccentricity"\nbody = "disc_3"\namplitude = "1 um"\nphase = "0 deg"': r"errors.extra.body.*disc_1",
}


@pytest.mark.parametrize("table", MISTAKES, ids=range(len(MISTAKES)))
def test_errors_of_wrong_bodies_are_refused_by_name(rv_text, table):
    with pytest.raises(gj.ParameterError, match=MISTAKES[table]):
        gj.loads(rv_text + f"\n[errors.extra]\n{table}\n")


def test_parts_that_do_not_go_together_are_refused(rv_text, config_text):
    with pytest.raises(gj.SceneError, match=r"\[backlash\] is not for an rv_cycloidal"):
        gj.loads(rv_text + '\n[backlash]\ninitial = "1 um"\n')
    line = 'kind = "hertz_line_contact"\nyoungs_modulus = "206 GPa"\npoissons_ratio = 0.3\nface_width = "11 mm"\n'
    begin, end = config_text.index("[compliance]"), config_text.index("[inertia]")
    with pytest.raises(gj.SceneError, match="does not offer"):
        gj.loads(config_text[:begin] + "[compliance]\n" + line + config_text[end:])
    with pytest.raises(gj.ParameterError, match="a first stage needs"):
        system(sun_teeth=22)
