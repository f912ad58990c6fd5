"""Pairs of gears that tests of helical geometry and of its stiffness share."""

import math

import jax
import jax.numpy as jnp
import numpy as np

import gearjax as gj
from gearjax.geometry import InvolutePair
from gearjax.units import deg, mm, rpm

GUO_1 = {
    "teeth": (19, 47),
    "normal_module": 6 * mm,
    "normal_pressure_angle": 20 * deg,
    "helix_angle": 9.911 * deg,
    "profile_shifts": (0.0, 0.0),
    "face_width": 75 * mm,
    "centre_distance": 201 * mm,
}
"""Table 1 of Guo and Fang (2018)."""
GUO_2 = {
    "teeth": (20, 40),
    "normal_module": 2.5 * mm,
    "normal_pressure_angle": 20 * deg,
    "helix_angle": 25 * deg,
    "profile_shifts": (0.0, 0.0),
    "face_width": 40 * mm,
    "centre_distance": 82.7534 * mm,
}
"""Table 2 there."""
SPUR = {
    "teeth": (20, 33),
    "normal_module": 3 * mm,
    "normal_pressure_angle": 20 * deg,
    "helix_angle": 0.0,
    "profile_shifts": (0.2, 0.1),
    "face_width": 25 * mm,
    "centre_distance": 80.4 * mm,
}
INTERNAL = {
    "teeth": (21, 67),
    "normal_module": 2 * mm,
    "normal_pressure_angle": 20 * deg,
    "helix_angle": 12 * deg,
    "profile_shifts": (0.1, 0.4),
    "face_width": 20 * mm,
    "centre_distance": 47.5 * mm,
    "internal": True,
}


def pair_of(**given):
    """The geometry of a pair."""
    return InvolutePair(**given)


RING = INTERNAL | {"teeth": (24, 81), "profile_shifts": (0.3, 0.7), "centre_distance": None}
SPUR_RING = RING | {"helix_angle": 0.0}
PAIRS = {"spur": SPUR, "spur ring": SPUR_RING, "helical": GUO_1, "overlapping": GUO_2, "helical ring": RING}
STEEL = {"youngs_modulus": 206e9, "poissons_ratio": 0.3}
TEETH = gj.ToothSlices(**STEEL, pinion_bore=40 * mm, wheel_bore=80 * mm)


def system_of(given, **changes):
    given = dict(given)
    pinion, wheel = given.pop("teeth")
    shifts = given.pop("profile_shifts")
    kind = "internal" if given.pop("internal", False) else "external"
    own = {"pinion_shift": shifts[0], "wheel_shift": shifts[1], "wheel_kind": kind, "input_speed": 50.8 * rpm}
    return gj.HelicalPair(pinion, wheel, **(given | own | changes))


def scene_of(given, errors=None, compliance=None, backlash=None, **changes):
    return gj.Scene(system_of(given, **changes), errors or {}, compliance=compliance, backlash=backlash)


def meshes_of(system, number=64, of=1.0):
    return np.arange(number) / number * 2 * math.pi / system.pinion_teeth * of


def stiffness_of(system, law, angles):
    """Of all that is on the path of contact, along the normals [N/m]."""

    def total(angle):
        return law.of_meshes(system.pose(angle, gj.Request(slices=True)).slices).stiffness.sum()

    return np.asarray(jax.jit(jax.vmap(total))(jnp.asarray(angles)))
