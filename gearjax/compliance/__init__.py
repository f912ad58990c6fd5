"""Compliance of the teeth: stiffness of each pair of teeth, law of a line contact, or influence of coupled contacts."""

from gearjax.compliance.base import (
    COUPLED,
    AbstractCompliance,
    AbstractCoupledCompliance,
    AbstractSliceCompliance,
    AbstractToothCompliance,
    couples,
)
from gearjax.compliance.elastic_teeth import ElasticTeeth
from gearjax.compliance.harmonic import HarmonicStiffness
from gearjax.compliance.influence_matrix import InfluenceMatrix
from gearjax.compliance.iso6336 import Iso6336Stiffness, iso6336_stiffness
from gearjax.compliance.line_contact import LINE_CONTACTS, AbstractLineContact, HertzLineContact, HuLineContact
from gearjax.compliance.line_stiffness import Iso6336Teeth, LineStiffness
from gearjax.compliance.tooth_slices import ToothSlices

AnyCompliance = (
    AbstractCompliance
    | AbstractLineContact
    | AbstractCoupledCompliance
    | AbstractToothCompliance
    | AbstractSliceCompliance
)
"""Types that a scene accepts as its compliance."""
COMPLIANCES: tuple[type[AnyCompliance], ...] = (
    HarmonicStiffness,
    *LINE_CONTACTS,
    ElasticTeeth,
    InfluenceMatrix,
    LineStiffness,
    Iso6336Teeth,
    ToothSlices,
)

__all__ = [
    "COMPLIANCES",
    "COUPLED",
    "AbstractCompliance",
    "AbstractCoupledCompliance",
    "AbstractLineContact",
    "AbstractSliceCompliance",
    "AbstractToothCompliance",
    "AnyCompliance",
    "ElasticTeeth",
    "HarmonicStiffness",
    "HertzLineContact",
    "HuLineContact",
    "InfluenceMatrix",
    "Iso6336Stiffness",
    "Iso6336Teeth",
    "LineStiffness",
    "ToothSlices",
    "couples",
    "iso6336_stiffness",
]
