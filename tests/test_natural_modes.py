"""Natural frequencies and modes: closed forms, the published pair in all its coordinates, gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.helical_pairs import GUO_1, pair_of, scene_of

LISTED = (254.6, 344.6, 360.5, 557.4, 678.3, 794.3, 1078, 1080, 3474, 3954, 4025)
"""Of the pair of Guo and Fang (2018), tables 1 and 3, its mesh of 1.076e9 N/m one spring at the pitch point [Hz]."""


def published(width):
    """The pair with that mesh spread over a face of some width."""
    given = GUO_1 | {"face_width": width}
    pair = pair_of(**given)
    length = width * float(pair.transverse_contact_ratio) / float(jnp.cos(pair.base_helix_angle))
    bearings = gj.Support(x=2e8, y=2e8, z=1e8, rx=1e7, ry=1e7)
    inertia = gj.MomentOfInertia(3.2568 * float(pair.gears[1].base_radius) ** 2)
    return dataclasses.replace(
        scene_of(given, {}, gj.LineStiffness(1.076e9 / length), slices=20),
        inertia=inertia,
        supports={"pinion": bearings, "wheel": bearings},
        body_inertia={
            "pinion": gj.BodyInertia(8.03, transverse=1.62e-2),
            "wheel": gj.BodyInertia(38.99, transverse=2.17e-1),
        },
    )


@pytest.mark.slow
def test_the_published_pair_in_all_its_coordinates():
    """A narrow face is one spring; a wide one holds against tilting by itself, which raises three modes of tilting."""
    narrow = gj.natural_modes(published(1e-3), 830.0)
    np.testing.assert_allclose(narrow.frequencies, LISTED, rtol=3e-3)
    assert narrow.coordinates[:3] == ("output", "pinion.x", "pinion.y")
    np.testing.assert_allclose(np.abs(narrow.shapes - 1).min(axis=1), 0.0, atol=1e-15)  # the largest part
    wide = gj.natural_modes(published(75e-3), 830.0)
    np.testing.assert_allclose(wide.frequencies[:7], LISTED[:7], rtol=1e-3)
    tilting = np.asarray(wide.frequencies)[[7, 9, 10]] / np.asarray(narrow.frequencies)[[7, 9, 10]]
    assert (tilting > 1.005).all()


def test_one_coordinate_by_hand(scene):
    """All pairs of a 2K-V hold; each has a damper."""
    found = gj.natural_modes(scene, 100.0)
    contacts = scene.contacts(jnp.zeros(()), "mean")
    drives = np.asarray(scene.layout.side) > 0
    lever, stiffness = (np.asarray(part)[drives] for part in (contacts.lever, contacts.linear))
    inertia = float(scene.inertia.moment(jnp.asarray(lever)))
    rate = np.sqrt((lever**2 * stiffness).sum() / inertia)
    assert float(found.frequencies[0]) == pytest.approx(rate / (2 * np.pi), rel=1e-12)
    mass = float(scene.inertia.at_contacts(jnp.asarray(lever)))
    drag = (lever**2 * np.asarray(scene.damping.coefficient(jnp.asarray(stiffness), jnp.asarray(mass)))).sum()
    assert float(found.damping[0]) == pytest.approx(drag / inertia / (2 * rate), rel=1e-12)


@pytest.mark.slow
def test_modes_satisfy_the_equation_of_motion():
    """Of the structure with its mean mesh, not scaled; modes do not see each other."""
    from gearjax.analysis.modes import StructureEquation
    from gearjax.analysis.modes.lines import Lines

    scene = dataclasses.replace(published(75e-3), load=gj.ConstantLoad())
    found = gj.natural_modes(scene, 830.0)
    equation = StructureEquation.of(scene, jnp.asarray(830.0))
    stiffness, _ = Lines.of(equation, equation.excitation(jnp.zeros(()))).whole
    mass = equation.structure.mass
    rates = 2 * np.pi * np.asarray(found.frequencies)
    shapes = np.asarray(found.shapes)
    pulled, moved = shapes @ np.asarray(stiffness), rates[:, None] ** 2 * (shapes @ np.asarray(mass))
    np.testing.assert_allclose(pulled, moved, atol=1e-8 * np.abs(moved).max())
    apart = shapes @ np.asarray(mass) @ shapes.T
    size = np.sqrt(np.diagonal(apart))
    np.testing.assert_allclose(apart / np.outer(size, size), np.eye(len(rates)), atol=1e-9)


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap():
    scene = published(75e-3)

    def frequencies(numbers):
        mass, support = numbers
        inertia = {**scene.body_inertia, "pinion": gj.BodyInertia(mass, transverse=1.62e-2)}
        held = {**scene.supports, "wheel": dataclasses.replace(scene.supports["wheel"], y=support)}
        return gj.natural_modes(dataclasses.replace(scene, body_inertia=inertia, supports=held), 830.0).frequencies

    at = jnp.asarray([[8.03, 2.1e8], [7.0, 2.4e8]])
    slopes = jax.jit(jax.vmap(jax.jacrev(frequencies)))(at)
    value = jax.jit(jax.vmap(frequencies))
    for place, step in enumerate((1e-4, 1e3)):
        way = np.zeros((1, 2))
        way[0, place] = step
        difference = (value(at + way) - value(at - way)) / (2 * step)
        np.testing.assert_allclose(slopes[:, :, place], difference, rtol=1e-5, atol=1e-6 * np.abs(difference).max())


@pytest.mark.slow
def test_back_flanks_carry_a_negative_torque():
    """Modes are those of the mesh that holds the torque, by scipy; nothing holds it without back flanks."""
    from scipy.linalg import eigh

    scene = published(75e-3)
    held = {**scene.supports, "pinion": dataclasses.replace(scene.supports["pinion"], y=jnp.asarray(3e8))}
    loose = dataclasses.replace(scene, supports=held, backlash=gj.InitialBacklash(1e-4), load=gj.ConstantLoad())
    structure = loose.structure(loose.contacts(0.0))
    side = np.asarray(loose.layout.side)
    for torque in (830.0, -830.0):
        found = gj.natural_modes(loose, torque)
        whole = np.array(structure.stiffness)
        for angle in np.arange(256) / 256 * 2 * np.pi / 19:
            contacts = loose.contacts(jnp.asarray(angle), "mean")
            own = np.where(side == np.sign(torque), contacts.linear, 0.0)
            whole += np.asarray(contacts.jacobian).T @ (own[:, None] * np.asarray(contacts.jacobian)) / 256
        squares, shapes = eigh(whole, np.asarray(structure.mass))
        np.testing.assert_allclose(found.frequencies, np.sqrt(squares) / (2 * np.pi), rtol=1e-3)
        for one, other in zip(np.asarray(found.shapes), shapes.T, strict=True):
            place = np.argmax(np.abs(one - 1) < 1e-12)
            np.testing.assert_allclose(one, other / other[place], atol=0.02 * np.abs(one).max())
    with pytest.raises(gj.SceneError, match="no flank carries a negative torque"):
        gj.natural_modes(scene, -830.0)
