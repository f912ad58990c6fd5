"""Candidate contacts, their laws, and the equilibrium of one-sided springs."""

from gearjax.contact.equilibrium import Equilibrium, equilibrium, first_contact
from gearjax.contact.frame import BodyView, ContactFrame, ContactSet, Flank, Moved, Movements, Rim
from gearjax.contact.interference import Overlap, least_overlap
from gearjax.contact.laws import AbstractContact, HardContact, QuadraticContact, SoftplusContact
from gearjax.contact.line import LineSprings

__all__ = [
    "AbstractContact",
    "BodyView",
    "ContactFrame",
    "ContactSet",
    "Equilibrium",
    "Flank",
    "HardContact",
    "LineSprings",
    "Moved",
    "Movements",
    "Overlap",
    "QuadraticContact",
    "Rim",
    "SoftplusContact",
    "equilibrium",
    "first_contact",
    "least_overlap",
]
