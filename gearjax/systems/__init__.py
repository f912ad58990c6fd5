"""Gear sets. Each gear set turns the input angle into candidate contacts and does not depend on the contact solver."""

from gearjax.systems.base import AbstractSystem, DiscProfile, GearOutlines, flank_radii
from gearjax.systems.helical_pair import HelicalPair
from gearjax.systems.helical_train import HelicalTrain
from gearjax.systems.involute_rv import InvoluteRV
from gearjax.systems.noncircular import AbstractNoncircularPair, EllipticPair, NoncircularPair
from gearjax.systems.rv_cycloidal import RVCycloidal
from gearjax.systems.two_kv import TwoKV

SYSTEMS: tuple[type[AbstractSystem], ...] = (
    TwoKV,
    RVCycloidal,
    InvoluteRV,
    HelicalPair,
    HelicalTrain,
    EllipticPair,
    NoncircularPair,
)

__all__ = [
    "SYSTEMS",
    "AbstractNoncircularPair",
    "AbstractSystem",
    "DiscProfile",
    "EllipticPair",
    "GearOutlines",
    "HelicalPair",
    "HelicalTrain",
    "InvoluteRV",
    "NoncircularPair",
    "RVCycloidal",
    "TwoKV",
    "flank_radii",
]
