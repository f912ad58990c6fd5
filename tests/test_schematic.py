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


def seen(scene: gj.Scene, body: str) -> np.ndarray:
    """Change of the gaps per displacement of a body along x and y of its supports, shape (contact, 2)."""
    supported = dataclasses.replace(
        scene, errors={}, reference=None, supports={body: gj.Support(x=1e8, y=1e8)}, compliance=scene.compliance
    )
    return -np.asarray(supported.contacts(jnp.zeros(()), "mean").jacobian[:, 1:])


@pytest.mark.parametrize(
    ("name", "body"), [(name, body) for name, scene in SETS.items() for body in scene.system.bodies]
)
def test_phases_point_where_the_contacts_see_them(name, body, rng):
    """A run-out in the drawn direction does what a displacement in that direction does, by way of the supports."""
    scene = SETS[name]
    drawn = scene.system.sketch().body(body)
    with_supports = drawn.seen_by or body
    normals = seen(scene, with_supports)
    own = np.abs(normals).max(axis=1) > 0  # contacts of another wheel do not see this one
    for phase in rng.uniform(-np.pi, np.pi, 3):
        error = {"run_out": gj.Eccentricity(body, SIZE, phase)}
        change = (gaps(scene, error) - gaps(scene, {})) / SIZE
        direction = drawn.zero + drawn.sense * phase - drawn.frame
        expected = drawn.share * normals @ np.array([np.cos(direction), np.sin(direction)])
        # supports of an involute reducer count by the normals of the ring's flanks, run-outs by those of its own
        tolerance = 0.01 if name.startswith("involute_rv") else 1e-9
        np.testing.assert_allclose(change[own], expected[own], atol=tolerance)


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
