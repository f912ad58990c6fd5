"""Bodies on supports, and springs coupled by a matrix, in scenes: exact geometry, energy, limits, other solvers."""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.quasi_static import _transmission_error
from gearjax.contact import ContactSet, CoupledSprings, HardContact, Layout, LinearSprings, equilibrium
from gearjax.contact.equilibrium import Equilibrium
from gearjax.parameters import check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar
from gearjax.units import ANGLE, ANGULAR_SPEED, deg, mm, um
from tests.rv import HERTZ, LINEAR, system
from tests.test_batches import equations
from tests.test_exact_geometry import Stage, separation

STIFF = 2e8


class Bearings(AbstractSystem):
    """Two spur wheels on bearings: one pair of teeth or two, each wheel free to move in x and y."""

    kind: ClassVar[str] = "bearings"
    pinion_teeth: int = count()
    wheel_teeth: int = count()
    wheel_base_radius: Number = length(above=0.0)
    pressure_angle: Number = number(ANGLE, above=0.0)
    input_speed: Number = number(ANGULAR_SPEED, above=0.0)
    pairs: int = count(default=2)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("pinion", "wheel")

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {"pinion": ("x", "y"), "wheel": ("y",)}

    @property
    def orders(self) -> Mapping[str, float]:
        teeth = float(self.pinion_teeth)  # gaps change with the teeth
        return {"output": teeth / self.wheel_teeth, "tooth": teeth, "mesh": teeth}

    @property
    def cycle(self) -> float:
        return 2 * math.pi * self.wheel_teeth / math.gcd(self.pinion_teeth, self.wheel_teeth)

    def layout(self, request: gj.Request) -> Layout:
        return Layout.of_flanks(self.pairs, request.back)

    def pose(self, theta: Scalar, request: gj.Request) -> gj.Pose:
        layout = self.layout(request)
        side = jnp.asarray(layout.side, theta.dtype)
        gap = 3e-6 * (1 + jnp.cos(self.pinion_teeth * theta + jnp.asarray(layout.pair, theta.dtype)))
        ways = {"x": side * 0 + jnp.sin(self.pressure_angle), "y": side * jnp.cos(self.pressure_angle)}
        signs = {"pinion": 1.0, "wheel": -1.0}
        parts = [coordinate.partition(".") for coordinate in request.coordinates]
        moving = [signs[body] * ways[way] for body, _, way in parts]
        columns = jnp.stack([-side * self.wheel_base_radius, *moving], axis=1)
        return gj.Pose(theta, columns, gap)


class Sharing(gj.AbstractCoupledCompliance):
    """Teeth of one rim: a force on one moves its neighbour too."""

    kind: ClassVar[str] = "sharing"
    own: Number = number(ANGLE, default=5e-9)
    shared: Number = number(ANGLE, default=2e-9)

    def influence(self, layout: Layout) -> Float[Array, "contact contact"]:
        alike = np.equal.outer(layout.side, layout.side)
        return self.own * np.eye(len(layout.side)) + self.shared * (alike - np.eye(len(layout.side)))


def pair(**changes) -> gj.Scene:
    own = Bearings(20, 31, 30 * mm, 20 * deg, 60.0, pairs=changes.pop("pairs", 2))
    given = {
        "compliance": Sharing(),
        "backlash": gj.InitialBacklash(50 * um),
        "supports": {"pinion": gj.Support(x=1e8, y=3e8), "wheel": gj.Support(y=2e8)},
    }
    return gj.Scene(own, **(given | changes))


def reducer(stiff: float = STIFF, **changes) -> gj.Scene:
    """The cycloidal stage with run-out, both discs on supports, one in a single direction."""
    errors = {"run_out": gj.Eccentricity("disc_1", 3 * um, 0.4), "ring": gj.Eccentricity("pin_ring", 4 * um, 1.0)}
    supports = {"disc_1": gj.Support(x=stiff, y=1.3 * stiff), "disc_2": gj.Support(y=0.8 * stiff)}
    return gj.Scene(system(), errors, **({"compliance": LINEAR, "supports": supports} | changes))


def planets(stiff: float = STIFF) -> gj.Scene:
    one = gj.load("configs/two_kv/wang_2020.toml")
    return dataclasses.replace(one, supports={f"planet_{i}": gj.Support(x=stiff, y=2 * stiff) for i in (1, 2)})


SCENES = {"two_kv": planets, "rv_cycloidal": reducer}
THETA = np.linspace(0.3, 6.0, 9)


def contact_sets(scene: gj.Scene, theta) -> ContactSet:
    return jax.vmap(lambda angle: scene.physics("backlash", "compliance").contacts(angle, "mean"))(jnp.asarray(theta))


def missed(scene: gj.Scene, te: gj.TransmissionError, torque: float) -> float:
    """How far K q + J^T f(J q - gap) misses the load, relative: zero for the one equilibrium, as energy is convex."""
    contacts, worst = contact_sets(scene, te.theta), 0.0
    for at in range(len(te.theta)):
        one = jax.tree.map(lambda leaf, at=at: leaf[at], contacts)
        place, jacobian = np.asarray(te.q[at]), np.asarray(one.jacobian)
        forces = np.asarray(one.springs.force(jnp.maximum(jacobian @ place - one.gap, 0.0)))
        held = np.concatenate([[torque], np.asarray(one.supports) @ place[1:]])
        size = np.abs(jacobian.T) @ forces
        worst = max(worst, (np.abs(jacobian.T @ forces + held) / np.where(size > 0, size, forces.max())).max())
        worst = max(worst, np.abs(forces - te.forces[at]).max() / forces.max())
    return worst


# exact geometry ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_displaced_disc_changes_true_distances(rng):
    own, crank = system("conjugate", 1), float(rng.uniform(0, 6))
    request = gj.Request(coordinates=("disc_1.x", "disc_1.y"))
    jacobian = own.pose(jnp.asarray(crank / own.orders["crank"]), request).jacobian
    stage, along = Stage.ideal(own, crank), np.exp(1j * crank)
    for pin in range(0, 40, 3):
        for column, way in ((1, along), (2, 1j * along)):
            far, near = (
                dataclasses.replace(stage, centre=stage.centre + side * way).gap(pin) for side in (1e-6, -1e-6)
            )
            assert float(jacobian[pin, column]) == pytest.approx(-(far - near) / 2e-6, abs=1e-4)


def test_a_displaced_planet_changes_true_distances():
    own, h = gj.load("configs/two_kv/wang_2020.toml").system, 1e-7
    planet, ring = (0.5 * z * 2.5 * mm * np.cos(20 * deg) for z in (50, 52))
    request = gj.Request(back=True, coordinates=("planet_1.x", "planet_1.y", "planet_2.x"))
    jacobian = np.asarray(own.pose(jnp.asarray(0.0), request).jacobian)
    throw = float(own.centre_distance)
    np.testing.assert_array_equal(jacobian[[1, 3], 1:3], 0.0)  # the other planet's contacts
    np.testing.assert_array_equal(jacobian[[0, 2], 3], 0.0)
    for contact, sense in ((0, -1), (2, 1)):  # the flank whose distance grows as the output leads is the driving one
        for column, way in ((1, h), (2, 1j * h)):
            far, near = (separation(planet, ring, throw + side * way, 0.0, 0.0, sense) for side in (1, -1))
            assert jacobian[contact, column] == pytest.approx(-(far - near) / (2 * h), abs=1e-6)


# equilibrium ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("torque", [784.0, -50.0, 1e-3])
@pytest.mark.parametrize("name", SCENES)
def test_supports_and_contacts_balance_the_load(name, torque):
    scene = SCENES[name]()
    te = gj.transmission_error(scene, THETA, torque)
    assert not te.result.any()
    assert missed(scene, te, torque) < 1e-9 * max(1.0, 1e-3 / abs(torque))
    assert te.coordinates == scene.coordinates
    assert te.q.shape == (9, len(te.coordinates))


@pytest.mark.parametrize("stiff", [1e3, 1e15])
@pytest.mark.parametrize("name", SCENES)
def test_soft_and_hard_supports(name, stiff):
    """At 1e3 N/m bodies move by metres, of which the overlap of some um is the difference."""
    scene = SCENES[name](stiff)
    te = gj.transmission_error(scene, THETA, 100.0)
    assert not te.result.any()
    np.testing.assert_allclose((contact_sets(scene, THETA).jacobian[..., 0] * te.forces).sum(axis=1), -100.0, rtol=1e-9)
    rigid = gj.transmission_error(dataclasses.replace(scene, supports={}), THETA, 100.0)
    if stiff > 1e10:
        np.testing.assert_allclose(te.te, rigid.te, rtol=0, atol=1e-10)
        np.testing.assert_allclose(te.forces, rigid.forces, rtol=0, atol=1e-6 * float(rigid.forces.max()))
    else:
        assert float(jnp.abs(te.q[:, 1:]).max()) > 0.4


@pytest.mark.parametrize("name", SCENES)
def test_what_supports_add_falls_in_proportion_to_their_compliance(name):
    rigid = gj.transmission_error(dataclasses.replace(SCENES[name](), supports={}), THETA, 300.0).te
    added = [gj.transmission_error(SCENES[name](stiff), THETA, 300.0).te - rigid for stiff in (1e12, 1e13)]
    assert float(jnp.abs(added[0]).max()) > 1e-9
    np.testing.assert_allclose(added[0], 10 * added[1], rtol=2e-3)


@pytest.mark.slow
def test_a_disc_of_one_direction_gives_way_as_a_spring_in_series():
    """An ideal stage, pushed across the throw alone: T / (a z_c) on both discs, each way."""
    one = gj.Scene(system("conjugate"), {}, compliance=LINEAR)
    held = dataclasses.replace(one, supports={f"disc_{i}": gj.Support(y=STIFF) for i in (1, 2)})
    rigid, soft = (gj.transmission_error(scene, THETA, 784.0) for scene in (one, held))
    push = 784.0 / (1.5 * mm * 39)
    np.testing.assert_allclose(soft.q[:, 1:].sum(axis=1), -push / STIFF, rtol=1e-9)
    np.testing.assert_allclose(soft.te - rigid.te, -0.5 * push / STIFF / (1.5 * mm * 39), rtol=1e-9)


@pytest.mark.slow
def test_line_contacts_on_supports():
    scene = reducer(compliance=HERTZ)
    for torque in (784.0, 1e-2):
        te = gj.transmission_error(scene, THETA, torque)
        assert not te.result.any()
        assert missed(scene, te, torque) < 1e-6  # what an overlap of 1e-2 N m is rounded by
    assert missed(scene, gj.transmission_error(scene, THETA, 784.0), 784.0) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("law", [gj.SoftplusContact(1e-8), gj.QuadraticContact(1e-7)])
def test_smooth_laws_on_supports_tend_to_the_hard_one(law):
    hard, smooth = (gj.transmission_error(reducer(contact=c), THETA, 784.0) for c in (HardContact(), law))
    np.testing.assert_allclose(smooth.te, hard.te, rtol=0, atol=3 * float(law.width) / (1.5 * mm * 39))
    lever = contact_sets(reducer(), THETA).jacobian[..., 0]
    np.testing.assert_allclose((lever * smooth.forces).sum(axis=1), -784.0, rtol=1e-9)


@pytest.mark.slow
def test_hardly_any_torque_and_none():
    scene = reducer()
    lever = contact_sets(scene, THETA).jacobian[..., 0]
    for torque in (1e-12, -1e-12):
        te = gj.transmission_error(scene, THETA, torque)
        np.testing.assert_allclose((lever * te.forces).sum(axis=1), -torque, rtol=1e-9)
    none = gj.transmission_error(scene, THETA, 0.0)
    np.testing.assert_allclose(none.te, gj.transmission_error(scene, THETA).te, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(none.forces, 0.0)
    np.testing.assert_array_equal(none.q[:, 1:], 0.0)


@pytest.mark.slow
def test_single_precision():
    exact = gj.transmission_error(reducer(), THETA, 784.0)
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), reducer())
    found = gj.transmission_error(single, THETA.astype(np.float32), 784.0)
    assert found.te.dtype == found.q.dtype == jnp.float32
    np.testing.assert_allclose(found.te, exact.te, rtol=0, atol=2e-7)
    np.testing.assert_allclose(found.forces, exact.forces, rtol=0, atol=2e-3 * float(exact.forces.max()))


@pytest.mark.slow
def test_many_random_contacts_on_many_supports(rng):
    """Levers of either sign, supports that pull at each other, five decades of stiffness."""

    @jax.jit
    def solve(jacobian, gap, stiffness, supports, load):
        contacts = ContactSet(jacobian, gap, LinearSprings(stiffness), Layout.either(len(gap)), supports)
        return equilibrium(contacts, load, HardContact())

    for _ in range(300):
        jacobian = rng.normal(size=(30, 6)) * 10 ** rng.uniform(-1, 1, 6)
        gap, stiffness = rng.uniform(0, 1e-5, 30), 10 ** rng.uniform(6, 9, 30)
        spread = rng.normal(size=(5, 5)) * np.sqrt(10 ** rng.uniform(4, 11, 5))[:, None]
        supports, load = spread @ spread.T, rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 5)
        found = solve(jacobian, gap, stiffness, supports, load)
        assert found.result == 0
        # with the contacts that carry known, it is one linear system
        closed = np.asarray(found.forces) > 0
        matrix = jacobian[closed].T @ (stiffness[closed, None] * jacobian[closed])
        matrix[1:, 1:] += supports
        scale = 1 / np.sqrt(np.diag(matrix))
        right = jacobian[closed].T @ (stiffness[closed] * gap[closed]) + np.eye(6)[0] * load
        place = scale * np.linalg.solve(matrix * scale[:, None] * scale, right * scale)
        assert found.position == pytest.approx(place[0], rel=1e-9)
        overlap = jacobian @ place - gap
        assert overlap[~closed].max(initial=-1.0) < 1e-12
        np.testing.assert_allclose(
            found.forces[closed], (stiffness * overlap)[closed], rtol=1e-6, atol=1e-9 * abs(load)
        )


@pytest.mark.slow
@pytest.mark.parametrize("springs", ["linear", "line"])
@pytest.mark.parametrize("law", [HardContact(), gj.SoftplusContact(1e-7)])
@pytest.mark.parametrize("supported", [False, True])
def test_second_derivatives(springs, law, supported, rng):
    """The rate of an equilibrium that gaps and levers move is a derivative; so its gradient is a second one."""
    scene = reducer(compliance={"linear": LINEAR, "line": HERTZ}[springs])
    scene = scene if supported else dataclasses.replace(scene, supports={})
    one = jax.tree.map(lambda leaf: leaf[0], contact_sets(scene, THETA[:1]))
    way = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)) * 1e-2 * jnp.abs(leaf).max(), one)
    if supported:
        way = eqx.tree_at(lambda contacts: contacts.supports, way, way.supports + way.supports.T)

    def changed(contacts, first, second):
        return jax.tree.map(
            lambda leaf, way: leaf + (first + second) * way + first * second * jnp.abs(way), contacts, way
        )

    def rate(second):
        def position(first):
            return equilibrium(changed(one, first, second), jnp.asarray(-784.0), law).position

        return jax.jvp(position, (jnp.asarray(0.0),), (jnp.asarray(1.0),))[1]

    h = 1e-4
    both = jax.jit(jax.value_and_grad(rate))  # one program of values and slopes
    slope = both(0.0)[1]
    ahead, behind, far, farther = (both(times * h)[0] for times in (1.0, -1.0, 2.0, -2.0))
    central = (8 * (ahead - behind) - (far - farther)) / (12 * h)
    assert float(slope) == pytest.approx(float(central), rel=1e-5)
    assert abs(slope) > 1e-12


@pytest.mark.slow
def test_no_contact_can_carry():
    contacts = ContactSet(
        jnp.array([[-1.0, 0.2]]), jnp.zeros(1), LinearSprings(jnp.ones(1)), Layout.either(1), jnp.eye(1)
    )
    found = equilibrium(contacts, jnp.asarray(1.0), HardContact())
    assert found.result == 1
    assert np.isnan(found.position)
    np.testing.assert_array_equal(found.forces, 0.0)


# coupled springs -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_matrix_with_nothing_beside_its_diagonal_is_springs_one_by_one(rng):
    """Two solvers: the one for coupled contacts, and Newton's method in the coordinates."""

    @jax.jit
    def solve(jacobian, gap, stiffness, supports, load) -> list[Equilibrium]:
        return [
            equilibrium(ContactSet(jacobian, gap, springs, Layout.either(12), supports), load, HardContact())
            for springs in (LinearSprings(stiffness), CoupledSprings(jnp.diag(1 / stiffness)))
        ]

    for _ in range(20):
        jacobian, gap = rng.normal(size=(12, 3)), rng.uniform(0, 1e-5, 12)
        stiffness, supports, load = 10 ** rng.uniform(7, 9, 12), np.diag(10 ** rng.uniform(6, 9, 2)), rng.normal() * 1e3
        one, other = solve(jacobian, gap, stiffness, supports, jnp.asarray(load))
        assert one.result == other.result == 0
        assert float(one.position) == pytest.approx(float(other.position), rel=1e-10)
        np.testing.assert_allclose(one.forces, other.forces, rtol=1e-8, atol=1e-9 * float(one.forces.max()))
        np.testing.assert_allclose(one.moved, other.moved, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("torque", [40.0, -25.0, 2.0])
def test_two_wheels_on_bearings_with_teeth_that_share_a_rim(torque):
    """Every coordinate, a coupled 2 x 2 compliance: against K q + J^T f = Q, solved with the teeth that carry."""
    scene = pair()
    te = gj.transmission_error(scene, THETA, torque)
    assert not te.result.any()
    assert te.coordinates == ("output", "pinion.x", "pinion.y", "wheel.y")
    contacts = contact_sets(scene, THETA)
    for at in range(len(THETA)):
        jacobian, gap = np.asarray(contacts.jacobian[at]), np.asarray(contacts.gap[at])
        influence, supports = np.asarray(contacts.springs.influence[at]), np.asarray(contacts.supports[at])
        forces, place = np.asarray(te.forces[at]), np.asarray(te.q[at])
        opening = influence @ forces + gap - jacobian @ place
        assert forces.min() >= 0
        assert opening.min() > -1e-15
        assert np.abs(forces * opening).max() < 1e-15 * forces.max()
        balance = jacobian.T @ forces
        assert balance[0] == pytest.approx(-torque, rel=1e-12)
        np.testing.assert_allclose(balance[1:], -supports @ place[1:], rtol=1e-9)


@pytest.mark.slow
def test_coupling_matters():
    apart = pair(compliance=gj.HarmonicStiffness(2e8, [], []))
    shared, alone = (gj.transmission_error(one, THETA, 40.0).te for one in (pair(), apart))
    assert float(jnp.abs(shared - alone).max()) > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("scene", [pair(), planets(), reducer()], ids=["coupled", "two_kv", "rv_cycloidal"])
def test_gradients_are_central_differences_under_vmap_and_jit(scene):
    """By the stiffness of a support and the torque."""
    body = next(iter(scene.supports))
    weights = np.random.default_rng(1).normal(size=(9, len(scene.coordinates)))

    def told(stiffness, torque):
        again = eqx.tree_at(lambda s: s.supports[body].y, scene, stiffness)
        te = gj.transmission_error(again, THETA, torque)
        return 1e6 * (weights * te.q).sum() + 1e-3 * (weights[:, :1] * te.forces).sum()

    starts = jnp.asarray([1.1e8, 3e8]), jnp.asarray([30.0, 55.0])
    slopes = jax.jit(jax.vmap(jax.grad(told, argnums=(0, 1))))(*starts)
    forward = jax.jit(jax.vmap(jax.jacfwd(told, argnums=(0, 1))))(*starts)
    value = jax.jit(jax.vmap(told))
    for column, step in enumerate((1e3, 1e-4)):
        moves = [jnp.full(2, step if i == column else 0.0) for i in range(2)]
        ends = [value(*(start + side * move for start, move in zip(starts, moves, strict=True))) for side in (1, -1)]
        np.testing.assert_allclose(slopes[column], (ends[0] - ends[1]) / (2 * step), rtol=1e-5)
        np.testing.assert_allclose(forward[column], slopes[column], rtol=1e-9)


# what a scene does not list ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_not_listed_leaves_no_equation():
    one = dataclasses.replace(planets(), supports={})
    y, both = ({"planet_1": gj.Support(**ways)} for ways in ({"y": 1e8}, {"x": 1e8, "y": 1e8}))

    def count_of(supports, torque: float | None = 20.0) -> int:
        scene = dataclasses.replace(one, supports=supports)
        return equations(jax.make_jaxpr(lambda: gj.transmission_error(scene, THETA, torque).te)().jaxpr)

    assert count_of({}) < count_of(y) < count_of(both)
    assert count_of({}, None) == count_of(both, None)


def test_a_change_of_stiffness_compiles_nothing():
    gj.transmission_error(reducer(), THETA, 20.0)
    before = _transmission_error._cached._cache_size()
    gj.transmission_error(reducer(3e8), THETA, 21.0)
    assert _transmission_error._cached._cache_size() == before
