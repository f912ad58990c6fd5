"""Candidate contacts, their laws, and the equilibrium of one-sided springs."""

from gearjax.contact.equilibrium import Equilibrium, equilibrium, first_contact
from gearjax.contact.frame import BodyView, ContactFrame, ContactSet, Flank
from gearjax.contact.laws import AbstractContact, HardContact, QuadraticContact, SoftplusContact

__all__ = [
    "AbstractContact",
    "BodyView",
    "ContactFrame",
    "ContactSet",
    "Equilibrium",
    "Flank",
    "HardContact",
    "QuadraticContact",
    "SoftplusContact",
    "equilibrium",
    "first_contact",
]
