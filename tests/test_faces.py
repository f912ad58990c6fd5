"""Slices coupled along tooth faces: what the whole matrix gives, in lanes of every kind, with derivatives."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import Faces
from gearjax.contact.coupled import coupled_balance
from gearjax.contact.springs import CoupledSprings, block_diagonal
from gearjax.units import um
from tests.test_coupled_blocks import only_the_middle_has_none

GUO = Path(__file__).parents[1] / "configs" / "helical" / "guo_2018.toml"
FACES, SLICES = 4, 12


def faces_of(rng, faces=FACES, slices=SLICES):
    """Faces of slices with some stiffness of their own, a few of them partly on the path of contact."""
    fall = rng.uniform(0.1, 0.8, faces)
    size = rng.uniform(0.8, 1.2, (2, faces, slices)) * 1e-5
    low, high = size * np.exp(-0.5 * fall[:, None])
    own = low * high * np.exp(fall[:, None]) + rng.uniform(0.3, 1.0, (faces, slices)) * 1e-10
    own[:, 0] *= rng.choice([1.0, 1e4], faces)
    return Faces(*map(jnp.asarray, (own, low, high, fall)))


def problem(rng, sides=True):
    """Faces, levers of both sides (driving first), and gaps."""
    lever = -rng.uniform(0.05, 0.06, FACES * SLICES)
    if sides:
        lever[lever.size // 2 :] *= -1
    return faces_of(rng), jnp.asarray(lever), jnp.asarray(rng.uniform(0, 3e-7, lever.size))


def stacked(parts):
    return jax.tree.map(lambda *each: jnp.stack(each), *parts)


def dense(faces):
    return block_diagonal(faces.blocks)


def test_the_approach_is_that_of_the_matrix(rng):
    faces, forces = faces_of(rng), jnp.asarray(rng.normal(size=FACES * SLICES))
    matrix = np.asarray(dense(faces))
    np.testing.assert_allclose(faces.approach(forces), matrix @ np.asarray(forces), rtol=1e-12, atol=1e-22)
    i, j, one = 3, 7, jax.tree.map(np.asarray, faces)
    np.testing.assert_allclose(matrix[i, j], one.low[0, i] * one.high[0, j] * np.exp(-one.fall[0] * (j - i - 1)))
    np.testing.assert_array_equal(matrix, matrix.T)
    np.testing.assert_array_equal(CoupledSprings(faces).influence, matrix)


@pytest.mark.slow
@pytest.mark.parametrize("sided", [False, True])
def test_faces_give_what_the_whole_matrix_gives(sided, rng):
    """Loads of both signs, slight ones, none, and flanks of both sides that are pressed together."""
    faces, lever, gap = stacked([problem(rng) for _ in range(40)])
    gap = gap.at[::5].add(-4e-7)  # closed on both sides, whatever the position
    load = jnp.asarray(rng.choice([-30.0, 10.0, -1e-5, 0.0, -0.5], 40))

    def both(faces, *given):
        return coupled_balance(faces, *given, sided), coupled_balance(dense(faces), *given)

    mine, known = jax.jit(jax.vmap(both))(faces, lever, gap, load)
    assert not np.asarray(mine[2]).any()
    np.testing.assert_allclose(mine[0], known[0], rtol=1e-10)
    np.testing.assert_allclose(mine[1], known[1], rtol=1e-9, atol=1e-11 * float(known[1].max()))
    pressed = np.asarray(mine[1] > 0)
    half = pressed.shape[1] // 2
    assert (pressed[:, :half].any(axis=1) & pressed[:, half:].any(axis=1)).sum() >= 5
    assert (pressed.sum(axis=1) < half).any()
    assert len({int(count) for count in pressed.sum(axis=1)}) > 5


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [3, 50])
def test_lanes_of_every_kind_are_single_problems(lanes, rng):
    """Gaps under the same faces, faces with gaps of their own, gaps under each of several faces, in either order."""
    faces, lever, _ = stacked([problem(rng, sides=False) for _ in range(3)])
    gaps, load = jnp.asarray(rng.uniform(0, 3e-7, (3, lanes, FACES * SLICES))), jnp.asarray(-20.0)

    def forces(faces, lever, gap):
        return coupled_balance(faces, lever, gap, load)[1]

    one = jax.jit(forces)
    each = [jax.tree.map(lambda part, i=i: part[i], faces) for i in range(3)]
    known = np.array([[one(each[i], lever[i], gaps[i, j]) for j in range(0, lanes, 2)] for i in range(3)])
    under_each = jax.vmap(jax.vmap(forces, (None, None, 0)), (0, 0, 0))
    across = jax.vmap(jax.vmap(forces, (0, 0, 0)), (None, None, 1), 1)
    found = [under_each(faces, lever, gaps), across(faces, lever, gaps)]
    copies = jax.tree.map(lambda part: jnp.repeat(part[:, None], lanes, axis=1), (faces, lever))
    found.append(jax.vmap(jax.vmap(forces))(*copies, gaps))
    for mine in found:
        np.testing.assert_allclose(mine[:, ::2], known, rtol=1e-11, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_derivatives_are_those_of_the_whole_matrix(derivative, rng):
    """With lanes; with respect to the numbers of the faces, levers, gaps and load."""
    faces, lever, gap = problem(rng)
    weights = jnp.asarray(rng.normal(size=gap.shape))

    def number(faces, lever, gap, load, whole):
        given = dense(faces) if whole else faces
        place, forces, _ = coupled_balance(given, lever, gap, load, not whole)
        return 1e6 * place + weights @ forces

    loads = jnp.asarray([-20.0, -60.0])
    mine, known = (
        jax.jit(
            jax.vmap(derivative(lambda *given, whole=whole: number(*given, whole), (0, 1, 2, 3)), (None, None, None, 0))
        )(faces, lever, gap, loads)
        for whole in (False, True)
    )
    for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(known), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9 * float(np.abs(other).max()))


@pytest.mark.slow
def test_second_derivatives_are_those_of_the_whole_matrix(rng):
    """Of the position with respect to two scales of the influence, of which one is not differentiated at first."""
    faces, lever, gap = problem(rng, sides=False)

    def place(scales, whole):
        own = dataclasses.replace(faces, own=faces.own * scales[0], low=faces.low * scales[1])
        return 1e6 * coupled_balance(dense(own) if whole else own, lever, gap, jnp.asarray(-20.0))[0]

    mine, known = (jax.jit(jax.hessian(lambda scales, w=w: place(scales, w)))(jnp.array([1.1, 1.0])) for w in (0, 1))
    np.testing.assert_allclose(mine, known, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("sided", [False, True])
def test_faces_that_are_not_positive_definite_have_no_solution(sided, rng):
    """In lanes, the others have theirs."""
    faces, lever, gap = problem(rng)
    wrong = dataclasses.replace(faces, own=faces.own.at[0].add(-2 * faces.own[0].max()))
    lanes = stacked([faces, wrong, faces])
    only_the_middle_has_none(jax.vmap(lambda own: coupled_balance(own, lever, gap, jnp.asarray(-50.0), sided)), lanes)


def coupled_scene(slices=24, **changes):
    scene = gj.load(GUO)
    system = dataclasses.replace(scene.system, slices=slices)
    compliance = dataclasses.replace(scene.compliance, coupling_length=1.5)
    return dataclasses.replace(scene, system=system, compliance=compliance, run=None, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("torque", [830.0, -830.0, 20.0, 0.0])
def test_forces_of_a_pair_fulfil_the_conditions_of_contact(torque):
    """With the matrix that its springs show: no tension, no overlap, and the torque is held; both flanks."""
    scene = coupled_scene(backlash=gj.InitialBacklash(30 * um))
    theta = np.linspace(0.0, 2 * np.pi / 19, 7)
    found = gj.transmission_error(scene, theta, torque=torque)
    contacts = jax.vmap(lambda angle: scene.contacts(angle, "mean"))(jnp.asarray(theta))
    assert isinstance(contacts.springs.blocks, Faces)
    assert contacts.springs.blocks.own.shape[-1] == 24
    for at in range(len(theta)):
        influence = np.asarray(jax.tree.map(lambda part, at=at: part[at], contacts.springs).influence)
        lever, gap, forces = (np.asarray(part[at]) for part in (contacts.jacobian[:, :, 0], contacts.gap, found.forces))
        opening = influence @ forces + gap - lever * float(found.te[at])
        assert forces.min() >= 0
        assert opening.min() > -1e-18
        assert np.abs(forces * opening).max() <= 1e-15 * max(forces.max(), 1.0)
        np.testing.assert_allclose(lever @ forces, -torque, rtol=1e-12)


@pytest.mark.slow
def test_a_population_under_shared_faces_is_its_members():
    """Errors move the gaps alone, so that all members have the same faces at an angle."""
    scene = coupled_scene()
    theta = jnp.linspace(0.0, 2 * np.pi / 19, 6)
    amplitudes = jnp.linspace(0.0, 20 * um, 40)

    def te(amplitude):
        pinion = dataclasses.replace(scene.errors["pinion"], amplitude=amplitude)
        own = dataclasses.replace(scene, errors=dict(scene.errors) | {"pinion": pinion})
        return gj.transmission_error(own, theta, torque=830.0, extremes="samples").te

    together = jax.jit(jax.vmap(te))(amplitudes)
    for at in (0, 17, 39):
        np.testing.assert_allclose(together[at], jax.jit(te)(amplitudes[at]), rtol=1e-12, atol=1e-20)


@pytest.mark.slow
def test_known_numbers_of_no_definite_dtype_stay_known_in_a_trace():
    """A weakly typed number of a coupled compliance, as `jnp.asarray(1.5)` is; the scene is changed in a trace."""
    scene = coupled_scene(slices=9)
    weak = dataclasses.replace(scene.compliance, coupling_length=jnp.asarray(1.5))
    assert weak.coupling_length.weak_type
    scene = dataclasses.replace(scene, compliance=weak)

    def te(amplitude):
        pinion = dataclasses.replace(scene.errors["pinion"], amplitude=amplitude)
        own = dataclasses.replace(scene, errors=dict(scene.errors) | {"pinion": pinion})
        return gj.transmission_error(own, jnp.zeros(1), torque=830.0).te[0]

    known = te(10 * um)
    np.testing.assert_allclose(jax.jit(te)(10 * um), known, rtol=1e-12)


@pytest.mark.slow
def test_single_precision_is_as_accurate_as_it_can_be(rng):
    faces, lever, gap = problem(rng, sides=False)
    known = coupled_balance(faces, lever, gap, jnp.asarray(-20.0))[1]
    single = jax.tree.map(lambda part: part.astype(jnp.float32), (faces, lever, gap))
    found = coupled_balance(*single, jnp.asarray(-20.0, jnp.float32))[1]
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, known, atol=2e-5 * float(known.max()))
