"""Pure functions of gear geometry and kinematics."""

from gearjax.geometry.involute import InvoluteGear, base_radius, internal_centre_distance
from gearjax.geometry.planetary import FewTeethDifference

__all__ = ["FewTeethDifference", "InvoluteGear", "base_radius", "internal_centre_distance"]
