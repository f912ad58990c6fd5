"""Pure functions of gear geometry and kinematics."""

from gearjax.geometry.involute import base_radius, internal_centre_distance
from gearjax.geometry.planetary import FewTeethDifference

__all__ = ["FewTeethDifference", "base_radius", "internal_centre_distance"]
