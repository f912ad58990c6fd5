"""Gear sets. Each turns the input angle into candidate contacts; none knows how they are solved."""

from gearjax.systems.base import AbstractSystem
from gearjax.systems.two_kv import TwoKV

SYSTEMS: tuple[type[AbstractSystem], ...] = (TwoKV,)

__all__ = ["SYSTEMS", "AbstractSystem", "TwoKV"]
