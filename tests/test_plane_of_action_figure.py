"""The figure of loads over the plane of action: lengths that fit the stiffness of the scene."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.plot.plane_of_action import _lines
from tests.helical_pairs import GUO_1, TEETH, scene_of


@pytest.mark.slow
@pytest.mark.parametrize("whole", [False, True])
def test_loads_times_lengths_are_the_forces(whole):
    """Springs of whole pairs load a slice at the end of the path as if all of it were there: no endless loads."""
    scene = scene_of(GUO_1, {}, TEETH, slices=8)
    if whole:
        scene = dataclasses.replace(scene, compliance=gj.HarmonicStiffness(1e9, [], []))
    theta = jnp.linspace(0.0, 0.4, 61)
    forces = np.asarray(gj.transmission_error(scene, theta, 830.0, extremes="samples").forces)
    stage = scene.system.stages[0]
    _, _, load = _lines(scene, stage, np.asarray(theta), forces)
    width = float(stage.pair.face_width) / 8 / np.cos(float(stage.pair.base_helix_angle))
    assert load.max() < 1e-3 * 1.05 * forces.max() / width  # N/mm
    if whole:
        np.testing.assert_allclose(load * width * 1e3, np.where(load > 0, forces, 0.0), rtol=1e-12)
