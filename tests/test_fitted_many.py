"""The fitted scheme for many degrees of freedom: exact undamped, second order with dampers and contacts."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import gearjax as gj
from gearjax.analysis.fitted import OscillatorTerm
from gearjax.analysis.fitted_many import States

MASS = np.diag([1.0, 2.0, 0.5])
STIFFNESS = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -0.7], [0.0, -0.7, 1.2]])
DAMPING = np.array([[0.4, -0.1, 0.0], [-0.1, 0.3, -0.2], [0.0, -0.2, 0.25]])
PUSH = np.array([0.5, -1.0, 0.3])
START = np.array([[0.2, -0.1, 0.4], [1.0, 0.3, -0.5]])
CONTACT, GAP = np.array([1.0, 0.0, -1.0]), 0.1


def solve(step, number, damping, contact=0.0, swing=0.0):
    """Positions and velocities after even steps; one-sided spring between the first and the last body."""
    inverse = jnp.asarray(np.linalg.inv(MASS))
    lever = jnp.asarray(CONTACT)

    def state(time, position, args):
        del args
        overlap = lever @ position - GAP
        closed = jnp.where(overlap > 0, contact, 0.0)
        force = jnp.asarray(PUSH) * (1 + swing * jnp.sin(time * step)) - jnp.asarray(STIFFNESS) @ position
        stiffness = jnp.asarray(STIFFNESS) + closed * lever[:, None] * lever[None, :]
        push = step**2 * (inverse @ (force - closed * overlap * lever))
        return States(push, step**2 * (inverse @ stiffness), step * (inverse @ jnp.asarray(damping)))

    first = jnp.asarray(START) * jnp.array([[1.0], [step]])
    solution = diffrax.diffeqsolve(
        OscillatorTerm(state), gj.ExponentialFitMany(), 0.0, float(number), 1.0, first, max_steps=number + 8
    )
    assert solution.ys is not None
    return solution.ys[-1] / jnp.array([[1.0], [step]])


def exact(time, damping):
    """The linear system by the exponential of its matrix."""
    inverse, nothing = np.linalg.inv(MASS), np.zeros((3, 3))
    matrix = np.block([[nothing, np.eye(3)], [-inverse @ STIFFNESS, -inverse @ damping]])
    rest = np.concatenate([np.linalg.solve(STIFFNESS, PUSH), np.zeros(3)])
    return (rest + expm(matrix * time) @ (START.ravel() - rest)).reshape(2, 3)


@pytest.mark.parametrize("step", [0.05, 0.4])
def test_exact_undamped_at_long_steps(step):
    """Up to 0.8 rad of the fastest mode per step, positions and velocities."""
    number = round(20 / step)
    np.testing.assert_allclose(solve(step, number, np.zeros((3, 3))), exact(20.0, np.zeros((3, 3))), atol=1e-10)


@pytest.mark.slow
def test_second_order_with_dampers_that_mix_the_modes():
    errors = [abs(np.asarray(solve(h, round(8 / h), DAMPING)) - exact(8.0, DAMPING)).max() for h in (0.2, 0.1, 0.05)]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.1)
    assert errors[0] < 2e-3


@pytest.mark.slow
def test_contacts_that_open_and_close():
    """Against Dopri8; the error falls with the square of the step, on the whole."""

    def field(time, y, args):
        del args
        overlap = jnp.asarray(CONTACT) @ y[0] - GAP
        force = jnp.asarray(PUSH) * (1 + 0.5 * jnp.sin(time)) - jnp.asarray(STIFFNESS) @ y[0]
        force = force - jnp.asarray(DAMPING) @ y[1] - 40.0 * jnp.maximum(overlap, 0.0) * jnp.asarray(CONTACT)
        return jnp.stack([y[1], jnp.asarray(np.linalg.inv(MASS)) @ force])

    truth = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        0.0,
        12.0,
        0.01,
        jnp.asarray(START),
        stepsize_controller=diffrax.PIDController(rtol=1e-11, atol=1e-11),
        max_steps=100_000,
    ).ys
    assert truth is not None
    errors = []
    for number in (240, 960, 3840):
        found = solve(12.0 / number, number, DAMPING, contact=40.0, swing=0.5)
        errors.append(float(abs(found[0] - truth[-1, 0]).max()))
    assert errors[0] < 3e-2
    assert errors[1] < errors[0] / 6
    assert errors[2] < errors[1] / 6


@pytest.mark.slow
def test_gradients_under_vmap_and_jit():
    def end(stiffness):
        return solve(0.1, 100, DAMPING, contact=stiffness, swing=0.3)[0].sum()

    values = jnp.array([0.5, 2.0])
    slopes = jax.jit(jax.vmap(jax.grad(end)))(values)
    both = jax.jit(jax.vmap(end))
    central = (both(values + 1e-5) - both(values - 1e-5)) / 2e-5
    np.testing.assert_allclose(slopes, central, rtol=1e-6)
