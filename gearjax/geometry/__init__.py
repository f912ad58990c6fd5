"""Gear geometry and kinematics, as pure functions and immutable classes."""

from gearjax.geometry.helical_pair import BasicRack, InvolutePair
from gearjax.geometry.involute import InvoluteGear, base_radius, internal_centre_distance
from gearjax.geometry.planetary import FewTeethDifference

__all__ = [
    "BasicRack",
    "FewTeethDifference",
    "InvoluteGear",
    "InvolutePair",
    "base_radius",
    "internal_centre_distance",
]
