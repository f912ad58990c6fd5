"""Compliance of the teeth: stiffness of each pair, or the law of its line contact."""

from gearjax.compliance.base import AbstractCompliance, AbstractCoupledCompliance
from gearjax.compliance.harmonic import HarmonicStiffness
from gearjax.compliance.line_contact import LINE_CONTACTS, AbstractLineContact, HertzLineContact, HuLineContact

COMPLIANCES: tuple[type[AbstractCompliance | AbstractLineContact], ...] = (HarmonicStiffness, *LINE_CONTACTS)

__all__ = [
    "COMPLIANCES",
    "AbstractCompliance",
    "AbstractCoupledCompliance",
    "AbstractLineContact",
    "HarmonicStiffness",
    "HertzLineContact",
    "HuLineContact",
]
