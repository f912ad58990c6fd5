"""Levers, driving flanks and gaps against bodies as curves and points, written out apart from the package."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import gearjax as gj
from gearjax.units import arcmin, deg, mm, um
from tests.rv import PLACES, angles, scene, system, with_errors

FIRST = {"sun_teeth": 22, "planet_teeth": 60, "first_stage_module": 1.25 * mm}


def turned(vector, angle):
    """A vector as a complex number, turned by an angle [rad]."""
    return vector * np.exp(1j * angle)


@dataclasses.dataclass
class Stage:
    """A disc among its pins as curves and points of the plane, complex numbers [m]."""

    own: gj.RVCycloidal
    pins: np.ndarray  # centres
    radii: np.ndarray  # of the pins
    centre: complex  # of the disc
    turn: np.ndarray  # of the disc as each pin meets it, an error of its pitch included

    @classmethod
    def ideal(cls, own: gj.RVCycloidal, crank: float, place: float = 0.0) -> "Stage":
        places = 2 * np.pi * np.arange(own.pins) / own.pins
        circle, radius = float(own.pin_circle), float(own.pin_radius)
        turn = np.full(own.pins, -(crank + place) / (own.pins - 1))
        throw = float(own.eccentricity) * np.exp(1j * (crank + place))
        return cls(own, circle * np.exp(1j * places), np.full(own.pins, radius), throw, turn)

    def curve(self, v):
        """The curve at a distance from which the flanks run, in axes of the disc."""
        teeth = self.own.pins - 1
        circle = float(self.own.pin_circle + self.own.shifting_modification)
        throw = float(self.own.eccentricity)
        return circle * np.exp(1j * v / teeth) - throw * np.exp(1j * v * self.own.pins / teeth)

    def along(self, v):
        """Direction of the curve."""
        h = 1e-4  # a difference of fourth order: exact to rounding
        far, near = self.curve(v + 2 * h) - self.curve(v - 2 * h), self.curve(v + h) - self.curve(v - h)
        slope = (8 * near - far) / (12 * h)
        return slope / abs(slope)

    def foot(self, pin: int) -> tuple[float, complex]:
        """Where on the curve a pin is closest, and the vector from there to the pin's centre, in axes of the disc."""
        seen = turned(self.pins[pin] - self.centre, -self.turn[pin])
        v = np.linspace(0, 2 * np.pi * (self.own.pins - 1), 60 * self.own.pins)
        near = v[np.argmin(abs(self.curve(v) - seen))]
        foot = brentq(lambda v: ((seen - self.curve(v)) * np.conj(self.along(v))).real, near - 0.15, near + 0.15)
        return foot, seen - self.curve(foot)

    def gap(self, pin: int) -> float:
        """True distance of a pin from the flank; negative where they overlap."""
        foot, to_pin = self.foot(pin)
        away = (np.conj(-1j * self.along(foot)) * to_pin).real  # the disc lies to the left of the curve
        return away + float(self.own.pin_radius + self.own.isometric_modification) - self.radii[pin]

    def normal(self, pin: int) -> complex:
        """Direction from the disc to the pin."""
        return turned(-1j * self.along(self.foot(pin)[0]), self.turn[pin])


def moved(stage: Stage, crank: float, output: float) -> Stage:
    """The stage with the crank and the output turned further [rad]; both counted in the crank's sense."""
    return dataclasses.replace(stage, centre=turned(stage.centre, crank), turn=stage.turn + output)


@pytest.mark.parametrize("first", [False, True], ids=["crank held", "sun held"])
def test_a_lever_is_the_change_of_the_true_distance_per_output_angle_at_a_held_input(first, rng):
    own = system("conjugate", 1, **(FIRST if first else {}))
    crank, h = float(rng.uniform(0, 6)), 1e-6
    lever = gj.Scene(own, {}).contacts(jnp.asarray(crank / own.orders["crank"])).lever
    with_output = 1 + 22 / 60 if first else 0.0
    stage = Stage.ideal(own, crank)
    for pin in range(0, 40, 3):
        ahead, behind = (  # the output's own sense is against the crank
            moved(stage, -side * h * with_output, -side * h).gap(pin) for side in (1.0, -1.0)
        )
        assert float(lever[pin]) == pytest.approx(-(ahead - behind) / (2 * h), abs=2e-8)


def test_cranks_that_the_sun_turns_follow_the_output():
    """The train of the first stage from its pitch points alone: rolling without slip on a turning carrier."""
    own = system(**FIRST)
    sun, output = 0.0, 1e-3  # a held sun
    planet = output - (sun - output) * 22 / 60
    assert float(own.with_output) == pytest.approx(planet / output)
    crank = -39 * 1.0  # an output turn by one with the disc rolling in the ring
    sun = 1.0 + (1.0 - crank) * 60 / 22
    assert abs(sun) == pytest.approx(float(own.ratio))


@pytest.mark.parametrize("seed", range(4))
def test_the_pins_forces_take_their_share_of_the_torque_from_the_crank(seed):
    """Virtual work: a load that resists the output takes +T / z_c from whatever turns the crank, whatever carries."""
    rng = np.random.default_rng(seed)
    pins, torque = int(rng.integers(8, 60)), float(rng.uniform(10, 2000))
    circle = rng.uniform(40, 120) * mm
    own = gj.RVCycloidal(
        pins, circle, 0.2 * circle / pins, rng.uniform(0.3, 0.85) * circle / pins, 0.0, 0.0, 100.0, discs=1
    )
    crank = float(rng.uniform(0, 6))
    sizes = gj.Sizes("pin_ring", rng.uniform(-10 * um, 0, pins))  # which pins carry is up to chance
    one = gj.Scene(own, {"sizes": sizes}, compliance=gj.HarmonicStiffness(2e8, [], []))
    te = gj.transmission_error(one, jnp.asarray([crank]), torque)
    assert int(te.result[0]) == 0
    stage, forces = Stage.ideal(own, crank), np.asarray(te.forces[0])
    on_disc = -sum(forces[pin] * stage.normal(pin) for pin in np.flatnonzero(forces))
    on_crank = (np.conj(stage.centre) * on_disc).imag  # in the crank's own sense: what holds it back is negative
    assert on_crank == pytest.approx(-torque / (pins - 1), rel=1e-9)
    ahead = np.sin(2 * np.pi * np.arange(pins) / pins - crank) > 0
    assert ahead[forces > 0].all()


@pytest.mark.slow
def test_a_larger_pin_ahead_of_the_throw_moves_the_driven_output():
    """One pin of 40, a quarter turn ahead of the throw, 5 um too large: +0.2133 arcmin by exact geometry."""
    for clearance, expected in (("exact", 0.21331), ("linear", 0.2136)):
        clean = gj.Scene(system("conjugate", 1, isometric_modification=10 * um, clearance=clearance), {})
        larger = np.where(np.arange(40) == 10, 5 * um, 0.0)
        one = with_errors(clean, larger=gj.Sizes("pin_ring", larger))
        te = [gj.transmission_error(s, jnp.asarray([0.0])).te[0] for s in (clean, one)]
        assert float(te[1] - te[0]) / arcmin == pytest.approx(expected, abs=2e-4)


@pytest.mark.slow
def test_backlash_under_a_held_sun_is_that_of_exact_geometry():
    clean = system("conjugate", 2, isometric_modification=10 * um, clearance="exact")
    theta = jnp.linspace(0.0, 1.0, 30)
    for own, expected in ((clean, 1.17582), (dataclasses.replace(clean, **FIRST), 1.13602)):
        assert float(gj.backlash(gj.Scene(own, {}), theta).mean) / arcmin == pytest.approx(expected, rel=1e-3)


LISTED = {
    "pins": gj.Positions("pin_ring", 4 * um * np.cos(PLACES), 5 * um * np.sin(2 * PLACES + 0.3)),
    "sizes": gj.Sizes("pin_ring", 2 * um * np.cos(5 * PLACES)),
    "ring": gj.Eccentricity("pin_ring", 6 * um, 0.7),
    "throw": gj.Eccentricity("throw", 3 * um, 0.4),
    "run_out": gj.Eccentricity("disc_1", 4 * um, 1.1),
    "pitch": gj.CumulativePitch("disc_1", 5 * um, 0.2, waves=3),
    "outward": gj.Positions("disc_1", [1 * um], []),
    "sun": gj.Eccentricity("sun", 7 * um, 0.9),
    "planet": gj.Eccentricity("planet", 5 * um, 2.0),
}


def placed(own: gj.RVCycloidal, theta: float, position: float) -> Stage:
    """The first disc with `LISTED`, the output away from its ideal position."""
    crank = own.orders["crank"] * theta
    radius = 0.5 * 60 * 1.25 * mm * np.cos(20 * deg)
    ahead = 7 * um / radius * np.sin(own.orders["sun"] * theta + 0.9)
    ahead += 5 * um / radius * np.sin(own.orders["planet"] * theta + 2.0)
    ahead -= (1 + 22 / 60) * position
    disc = -crank / 39 - position
    place = PLACES + crank / 39  # of each pin on the disc
    outward = np.exp(1j * PLACES)
    listed = LISTED["pins"]
    pins = (76 * mm + np.asarray(listed.outward) + 1j * np.asarray(listed.around)) * outward + 6 * um * np.exp(0.7j)
    centre = turned(1.5 * mm + 3 * um * np.exp(0.4j), crank + ahead) + 4 * um * turned(np.exp(1.1j), disc)
    turn = disc + 5 * um * np.sin(3 * place + 0.2) / (76 * mm)
    tooth = 1 * um * turned(np.exp(1j * place), disc)  # each tooth lies further out on the disc
    return Stage(own, pins - tooth, 3 * mm + np.asarray(LISTED["sizes"].larger), centre, turn)


@pytest.mark.parametrize("position", [0.0, 3e-4])
def test_exact_gaps_are_true_distances_of_displaced_bodies(position):
    own = system("initial", 1, clearance="exact", **FIRST)
    theta = 7.3
    contacts = gj.Scene(own, LISTED).contacts(jnp.asarray(theta), position=jnp.asarray(position))
    overlap = np.asarray(contacts.lever * position - contacts.gap)
    stage = placed(own, theta, position)
    true = np.array([stage.gap(pin) for pin in range(40)])
    np.testing.assert_allclose(-overlap, true, rtol=0, atol=2e-12)
    sides = [placed(own, theta, position + side * 1e-6) for side in (1.0, -1.0)]
    for pin in range(0, 40, 7):
        rate = (sides[0].gap(pin) - sides[1].gap(pin)) / 2e-6
        assert float(contacts.lever[pin]) == pytest.approx(-rate, abs=1e-7)


def test_first_order_gaps_are_the_slope_of_the_exact_ones():
    """Errors and modification ten thousand times as small: what is left between both falls with their square."""
    small = {
        "pins": gj.Positions("pin_ring", 4e-10 * np.cos(PLACES), 5e-10 * np.sin(2 * PLACES + 0.3)),
        "ring": gj.Eccentricity("pin_ring", 6e-10, 0.7),
        "throw": gj.Eccentricity("throw", 3e-10, 0.4),
        "run_out": gj.Eccentricity("disc_1", 4e-10, 1.1),
        "pitch": gj.CumulativePitch("disc_1", 5e-10, 0.2, waves=3),
        "sun": gj.Eccentricity("sun", 7e-10, 0.9),
        "planet": gj.Eccentricity("planet", 5e-10, 2.0),
    }
    own = system("conjugate", 1, isometric_modification=-2e-9, shifting_modification=-4e-9, **FIRST)
    linear, exact = (
        gj.Scene(dataclasses.replace(own, clearance=clearance), small).contacts(jnp.asarray(7.3))
        for clearance in ("linear", "exact")
    )
    np.testing.assert_allclose(linear.gap, exact.gap, rtol=0, atol=2e-14)
    np.testing.assert_allclose(linear.lever, exact.lever, rtol=0, atol=2e-6)


@pytest.mark.slow
def test_the_exact_equilibrium_balances_on_the_turned_levers():
    one = scene(with_errors=True, clearance="exact")
    te = gj.transmission_error(one, jnp.asarray([0.7, 1.9]), 784.0)
    for angle, position, forces in zip((0.7, 1.9), te.te, te.forces, strict=True):
        contacts = one.contacts(jnp.asarray(angle), "mean", position)
        pressed = contacts.linear * jnp.maximum(contacts.lever * position - contacts.gap, 0.0)
        np.testing.assert_allclose(forces, pressed, rtol=1e-9, atol=1e-6)
        assert float((contacts.lever * forces).sum()) == pytest.approx(-784.0, rel=1e-9)


@pytest.mark.slow
def test_gradients_of_exact_positions_are_central_differences_under_vmap_and_jit():
    one, theta = scene(with_errors=True, clearance="exact"), jnp.asarray(angles(per_turn=5))

    def lag(numbers, torque):
        own = dataclasses.replace(one.system, isometric_modification=numbers[0], eccentricity=numbers[1])
        pins = dataclasses.replace(one.errors["pins"], outward=one.errors["pins"].outward.at[13].set(numbers[2]))
        again = dataclasses.replace(with_errors(one, pins=pins), system=own)
        loaded = gj.transmission_error(again, theta, torque)
        return loaded.te.mean() + 1e-9 * loaded.forces[0].max() + gj.backlash(again, theta).mean

    starts = jnp.asarray([[-22e-6, 1.5e-3, 1e-6], [-25e-6, 1.51e-3, 3e-6]])
    torques = jnp.asarray([784.0, -300.0])
    both = jax.jit(jax.vmap(jax.value_and_grad(lag, argnums=(0, 1))))  # one program of values and slopes
    by_number, by_torque = both(starts, torques)[1]
    for index, step in enumerate((1e-9, 1e-8, 1e-9)):
        move = jnp.zeros((1, 3)).at[0, index].set(step)
        slopes = (both(starts + move, torques)[0] - both(starts - move, torques)[0]) / (2 * step)
        np.testing.assert_array_less(np.abs(by_number[:, index] - slopes), np.maximum(2e-6 * np.abs(slopes), 1e-8))
    slopes = (both(starts, torques + 1e-2)[0] - both(starts, torques - 1e-2)[0]) / 2e-2
    np.testing.assert_allclose(by_torque, slopes, rtol=1e-6)


@pytest.mark.slow
def test_single_pin_forces_are_told_apart_by_exact_geometry():
    """What first order costs: little of the position, much of single pins."""
    theta = jnp.asarray(angles(per_turn=6))
    linear, exact = (
        gj.transmission_error(scene(with_errors=True, clearance=c), theta, 784.0) for c in ("linear", "exact")
    )
    assert float(jnp.abs(linear.te - exact.te).max()) / arcmin < 0.03
    assert 0.03 < float(jnp.abs(linear.forces - exact.forces).max() / exact.forces.max()) < 0.25


# 2K-V: involutes ------------------------------------------------------------------------------------------------------


def involute(base: float, roll, sense: int):
    """Points of an involute that unwinds in one sense, complex numbers [m]."""
    return base * np.exp(1j * sense * roll) * (1 - 1j * sense * roll)


def separation(planet_base, ring_base, centre, planet_turn, ring_turn, sense) -> float:
    """Distance of a planet's flank from a ring's along the line that stands square on both: negative where they
    overlap. Both flanks are involutes of the same sense; parallels of one another along that line."""

    def away(roll):
        """Distance of the planet's flank from a point of the ring's."""
        point = turned(involute(ring_base, roll, sense), ring_turn) - centre
        own = turned(point, -planet_turn)
        length = np.sqrt(abs(own) ** 2 - planet_base**2)  # of the tangent from the point to the base circle
        unwound = planet_base * (sense * np.angle(own) + np.arctan2(length, planet_base))
        return length - unwound

    # along the ring's flank the distance to the planet's has one turning point
    low, high = 0.35, 1.1
    found = minimize_scalar(away, bounds=(low, high), method="bounded", options={"xatol": 1e-10})
    return found.fun


def test_levers_of_involute_planets_are_true_distances():
    own = gj.load("configs/two_kv/wang_2020.toml").system
    planet, ring = (0.5 * z * 2.5 * mm * np.cos(20 * deg) for z in (50, 52))
    throw, h = float(own.centre_distance), 1e-5
    held = {"planet": 0.0, "ring": 1.0, "held_sun": 1 + 12 / 36}
    for word, with_output in held.items():
        lever = gj.Scene(dataclasses.replace(own, te_radius=word), {}).contacts(jnp.asarray(0.0)).lever
        for sense in (1, -1):
            gaps = []
            for side in (1.0, -1.0):
                # the crank turns on, the planet and the output against it; `side` is how far the output leads
                centre = throw * np.exp(1j * side * -h * with_output)
                gaps.append(separation(planet, ring, centre, -side * h, 0.0, sense))
            rate = (gaps[0] - gaps[1]) / (2 * h)
            assert abs(rate) == pytest.approx(abs(float(lever[0])), rel=1e-6)
    assert (np.asarray(lever) < 0).all()
