"""Masses on supports that cranks carry round: against Lagrange's equations, and the levers that the output has."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.dependence import depends
from gearjax.structure import Moving, Orbit, Structure
from tests.rv import system

DIRECTIONS = [("xy", "xy"), ("y", "xy"), ("x", "y"), ("x", "x")]


def lagrangian(q, v, names, bodies, orbits, speed, output):
    """Kinetic energy less that of the supports, with the displaced bodies as points of the plane."""
    energy = 0.5 * output * v[0] ** 2
    for body, (mass, support) in bodies.items():
        orbit = orbits[body]

        def centre(q, time, body=body, orbit=orbit):
            x, y = (q[names.index(f"{body}.{way}")] if f"{body}.{way}" in names else 0.0 for way in "xy")
            turn = orbit.order * speed * time + orbit.follows * q[0]
            along, ahead = jnp.stack([jnp.cos(turn), jnp.sin(turn)]), jnp.stack([-jnp.sin(turn), jnp.cos(turn)])
            return (orbit.throw + x) * along + y * ahead

        _, velocity = jax.jvp(centre, (q, 0.0), (v, 1.0))
        energy += 0.5 * mass * velocity @ velocity
        # what turns with the output when nothing gives way is in its moment of inertia already
        energy -= 0.5 * mass * (orbit.throw * orbit.follows * v[0]) ** 2
        for way in support.directions:
            energy -= 0.5 * getattr(support, way) * q[names.index(f"{body}.{way}")] ** 2
    return energy


@pytest.mark.slow
@pytest.mark.parametrize("directions", DIRECTIONS)
def test_structure_is_lagranges_equations(directions):
    orbits = {name: Orbit(3.0 + i, 2e-3 * (i + 1), -1.3 + i) for i, name in enumerate("ab")}
    supports = {n: gj.Support(**dict.fromkeys(ways, 1e6)) for n, ways in zip("ab", directions, strict=True)}
    masses = {"a": 0.7, "b": 1.1}
    speed, output = 200.0, 0.04
    inertia = {n: gj.BodyInertia(m) for n, m in masses.items()}
    found = Structure.of(jnp.asarray(output), Moving.of((), supports, {}), inertia, orbits, jnp.asarray(speed))
    bodies = {name: (masses[name], supports[name]) for name in masses}

    def residual(q, v, a):
        """d/dt dL/dv - dL/dq."""

        def energy(q, v):
            return lagrangian(q, v, found.names, bodies, orbits, speed, output)

        momentum = jax.grad(energy, argnums=1)
        _, rate = jax.jvp(momentum, (q, v), (v, a))
        return rate - jax.grad(energy)(q, v)

    still = jnp.zeros(len(found.names))
    stiffness, damping, mass = (jax.jacobian(residual, argnums=i)(still, still, still) for i in range(3))
    np.testing.assert_allclose(found.mass, mass, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.damping, damping, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.stiffness, stiffness, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(-found.push, residual(still, still, still), rtol=1e-12, atol=1e-12)
    assert np.abs(found.damping[0]).max() > 0 or "x" not in "".join(directions)


def test_dampers_of_supports():
    support = gj.Support(x=1e8, y=2e8, x_damping=300.0)
    moving = Moving.of((), {"a": support}, {})
    found = Structure.of(jnp.asarray(1.0), moving, {"a": gj.BodyInertia(2.0)}, {}, jnp.asarray(50.0))
    np.testing.assert_allclose(found.damping, np.diag([0.0, 300.0, 0.0]))
    np.testing.assert_allclose(found.mass, np.diag([1.0, 2.0, 2.0]))
    np.testing.assert_allclose(found.stiffness, np.diag([0.0, 1e8, 2e8]))
    np.testing.assert_array_equal(found.push, 0.0)


@pytest.mark.parametrize("te_radius", ["planet", "ring", "held_sun", 0.061])
def test_a_crank_that_follows_the_output_carries_the_planet_wheel(te_radius):
    """The lever is that under a held crank, and the displacement of the wheel's centre as the crank follows."""
    own = dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml").system, te_radius=te_radius)
    held = dataclasses.replace(own, te_radius="planet")
    request = gj.Request(back=True, coordinates=("planet_1.y", "planet_2.y"))
    jacobian, crank_held = (np.asarray(s.pose(jnp.asarray(0.4), request).jacobian) for s in (own, held))
    orbit = own.orbits["planet_1"]
    moved = float(orbit.throw * orbit.follows)
    np.testing.assert_allclose(jacobian[:, 0], crank_held[:, 0] + moved * jacobian[:, 1:].sum(axis=1), rtol=1e-12)
    turns = {"planet": 0.0, "ring": -1.0, "held_sun": -(1 + 12 / 36)}
    if te_radius in turns:
        assert float(orbit.follows) == pytest.approx(turns[te_radius], abs=1e-12)


def test_a_crank_that_follows_the_output_carries_the_discs():
    """A first stage makes the lever longer by what the discs move; their y is the crank's way, seen on a circle."""
    own = gj.load("configs/rv_cycloidal/hu_2020.toml").system
    staged = dataclasses.replace(
        own,
        sun_teeth=22,
        planet_teeth=60,
        first_stage_module=1.5e-3,
        first_stage_pressure_angle=0.35,
    )
    assert own.orbits["disc_1"].follows == 0.0
    orbit = staged.orbits["disc_2"]
    request = gj.Request(coordinates=("disc_1.y", "disc_2.y"))
    long, short = (np.asarray(s.pose(jnp.asarray(0.4) / s.orders["crank"], request).jacobian) for s in (staged, own))
    moved = float(orbit.throw * orbit.follows)
    np.testing.assert_allclose(long[:, 0], short[:, 0] + moved * long[:, 1:].sum(axis=1), rtol=1e-9, atol=1e-15)
    assert orbit.order == staged.orders["crank"]


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ParameterError, match="y_damping is for a support that gives way in y"):
        gj.Support(x=1e8, y_damping=10.0)
    with pytest.raises(ParameterError, match="mass"):
        gj.BodyInertia(0.0)
    with pytest.raises(SceneError, match=r"\[inertia.disc_1\] is for a body that can move: list \[supports.disc_1\]"):
        gj.Scene(system(), {}, body_inertia={"disc_1": gj.BodyInertia(1.0)})


def test_what_depends_is_told_through_functions_that_are_compiled_apart():
    """Of the results of such a function, those that it does not take from the argument do not depend on it."""
    inner = jax.jit(lambda moved, still: (2 * moved, still + 1.0, moved * still))
    assert depends(lambda x: (*inner(x, jnp.ones(())), jnp.zeros(())), jnp.ones(())) == [True, False, True, False]
