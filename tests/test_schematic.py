"""Sketches of gear sets: directions of phases are those that the contacts see, and every gear set is drawn."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.plot import schematic_figure
from gearjax.units import um
from tests.test_matrix import GEAR_SETS

SIZE = 1e-6
FACING = ("ring", "pin_ring")  # their displacement does the opposite of a wheel's
SETS = {kind: gear_set.scene for kind, gear_set in GEAR_SETS.items()}
SETS["two_kv, three planets"] = dataclasses.replace(
    SETS["two_kv"], system=dataclasses.replace(SETS["two_kv"].system, planets=3)
)
SETS["rv_cycloidal, two discs"] = dataclasses.replace(
    SETS["rv_cycloidal"], system=dataclasses.replace(SETS["rv_cycloidal"].system, discs=2)
)
SETS["involute_rv, two gears"] = dataclasses.replace(
    SETS["involute_rv"], system=dataclasses.replace(SETS["involute_rv"].system, gears=2, pairs=3)
)
SETS["helical_pair, internal"] = dataclasses.replace(
    SETS["helical_pair"],
    system=gj.HelicalPair(
        pinion_teeth=19,
        wheel_teeth=80,
        normal_module=2e-3,
        normal_pressure_angle=np.radians(20),
        helix_angle=0.2,
        face_width=0.02,
        input_speed=10.0,
        wheel_kind="internal",
        addendum=0.8,
        slices=1,
    ),
)


def gaps(scene: gj.Scene, errors: dict) -> np.ndarray:
    """Gaps at input angle zero with these errors alone."""
    return np.asarray(dataclasses.replace(scene, errors=errors, reference=None).contacts(jnp.zeros(())).gap)


def on_the_line_of_action(scene: gj.Scene) -> np.ndarray:
    """Contacts at which the normals of both flanks are the same. Elsewhere on an involute RV they are not: run-outs
    count by those of their own gear, supports by those of the ring."""
    layout = scene.layout
    if not isinstance(scene.system, gj.InvoluteRV):
        return np.ones(len(layout.side), bool)
    at = scene.system.candidates(jnp.zeros(()), layout.has_back)
    return np.asarray(at.points.beyond[0].angle == 0).ravel()


def seen(scene: gj.Scene, body: str) -> np.ndarray:
    """Change of the gaps per displacement of a body along x and y of its supports, shape (contact, 2)."""
    supported = dataclasses.replace(
        scene, errors={}, reference=None, supports={body: gj.Support(x=1e8, y=1e8)}, compliance=scene.compliance
    )
    places = [supported.coordinates.index(f"{body}.{way}") for way in "xy"]
    return -np.asarray(supported.contacts(jnp.zeros(()), "mean").jacobian[:, places])


@pytest.mark.parametrize(
    ("name", "body"), [(name, body) for name, scene in SETS.items() for body in scene.system.bodies]
)
def test_phases_point_where_the_contacts_see_them(name, body, rng):
    """A run-out in the drawn direction does what a displacement in that direction does, by way of the supports."""
    scene = SETS[name]
    drawn = scene.system.sketch().body(body)
    supported = body if body in scene.system.coordinates else next(iter(scene.system.coordinates))
    normals = seen(scene, supported)
    if body in FACING:
        normals = -normals
    own = np.abs(normals).max(axis=1) > 0  # contacts of another wheel do not see this one
    exact = own & on_the_line_of_action(scene)
    assert exact.any()
    for phase in rng.uniform(-np.pi, np.pi, 3):
        error = {"run_out": gj.Eccentricity(body, SIZE, phase)}
        change = (gaps(scene, error) - gaps(scene, {})) / SIZE
        direction = drawn.zero + drawn.sense * phase - drawn.frame
        expected = normals @ np.array([np.cos(direction), np.sin(direction)])
        np.testing.assert_allclose(change[exact], expected[exact], atol=1e-9)
        np.testing.assert_allclose(change[own], expected[own], atol=0.01)


@pytest.mark.parametrize("name", SETS)
def test_every_gear_set_is_drawn_with_its_bodies_and_errors(name):
    scene = SETS[name]
    figure = schematic_figure(scene)
    told = " ".join(text.get_text() for ax in figure.axes for text in ax.texts)
    told += " ".join(text.get_text() for legend in figure.legends for text in legend.get_texts())
    for body in scene.system.bodies:
        assert body in told
    for key, error in scene.errors.items():
        if isinstance(error, gj.Eccentricity):
            assert f"{key}: {float(error.amplitude / um):.4g} um at {np.degrees(float(error.phase)):.4g} deg" in told
