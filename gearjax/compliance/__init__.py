"""Compliance of the teeth: stiffness of each pair."""

from gearjax.compliance.base import AbstractCompliance
from gearjax.compliance.harmonic import HarmonicStiffness

COMPLIANCES: tuple[type[AbstractCompliance], ...] = (HarmonicStiffness,)

__all__ = ["COMPLIANCES", "AbstractCompliance", "HarmonicStiffness"]
