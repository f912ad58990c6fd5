"""Pairs of gears that tests of helical geometry and of its stiffness share."""

from gearjax.geometry import InvolutePair
from gearjax.units import deg, mm

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
