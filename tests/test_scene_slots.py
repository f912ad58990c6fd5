"""What is no part of the kind that a slot of a scene takes is refused as the scene is made, with the slot's name."""

import dataclasses

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import gearjax as gj
from gearjax.scene_checks import NAMED, SLOTS

WRONG = [
    ({"compliance": 2e8}, r"compliance = 200000000.0: must be a part such as gj.HarmonicStiffness\(.*, or None"),
    ({"compliance": gj.HardContact()}, "compliance = HardContact"),
    ({"backlash": 2e-5}, "backlash = 2e-05: must be"),
    ({"backlash": False}, "backlash = False: must be"),
    ({"backlash": gj.Eccentricity("planet_1", 1e-6, 0.0)}, "backlash = Eccentricity"),
    ({"load": gj.EquivalentMass(3.0)}, "load = EquivalentMass"),
    ({"load": gj.ConstantLoad}, 'load = "ConstantLoad": is a class: give a part with its numbers, such as'),
    ({"inertia": gj.BodyInertia(mass=3.0)}, "inertia = BodyInertia"),
    ({"damping": jnp.asarray(0.1)}, "damping = .*: must be"),
    ({"reference": 0}, "reference = 0: must be a part such as gj.ZeroAtStart"),
    ({"reference": "absolute"}, 'reference = "absolute": must be'),
    ({"contact": None}, r"contact = None: must be a part such as gj.HardContact\(\)$"),
    ({"contact": "hard"}, 'contact = "hard": must be'),
    ({"impact": 1}, "impact = 1: must be"),
    ({"run": {"duration": 3.0}}, "run = .*: must be"),
    ({"errors": None}, r"errors = None: must be parts by name, such as .*, or \{\}"),
    ({"errors": [gj.Eccentricity("planet_1", 1e-6, 0.0)]}, "errors = .*: must be parts by name"),
    ({"errors": {"a": 3}}, "errors.a = 3: must be a part such as"),
    ({"supports": {"planet_1": 2e8}}, "supports.planet_1 = 200000000.0: must be"),
    ({"shafts": {"one": ("planet_1", "planet_2")}}, "shafts.one = .*: must be"),
    ({"body_inertia": {"planet_1": np.float64(3.0)}}, "body_inertia.planet_1 = .*: must be"),
]


@pytest.fixture
def as_users_run():
    """Without the checks of annotations, which only tests have."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(("slots", "words"), WRONG)
def test_a_part_of_another_kind_is_refused(scene, slots, words):
    with pytest.raises(gj.ParameterError, match=words) as refused:
        dataclasses.replace(scene, **slots)
    assert len(str(refused.value)) < 300
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("slot", [*SLOTS, *NAMED])
def test_the_examples_that_messages_give_are_right(slot):
    kinds, example = (SLOTS | NAMED)[slot]
    assert isinstance(eval(f"gj.{example}", {"gj": gj}), kinds)
