"""Candidate contacts, their laws, and the equilibrium of one-sided springs."""

from gearjax.contact.contacts import ContactSet
from gearjax.contact.equilibrium import Equilibrium, equilibrium, first_contact
from gearjax.contact.interference import Overlap, least_overlap
from gearjax.contact.laws import AbstractContact, HardContact, QuadraticContact, SoftplusContact
from gearjax.contact.layout import Layout
from gearjax.contact.line import LineSprings
from gearjax.contact.pose import BodyView, Moved, Movements, Pose, Request, Rim

__all__ = [
    "AbstractContact",
    "BodyView",
    "ContactSet",
    "Equilibrium",
    "HardContact",
    "Layout",
    "LineSprings",
    "Moved",
    "Movements",
    "Overlap",
    "Pose",
    "QuadraticContact",
    "Request",
    "Rim",
    "SoftplusContact",
    "equilibrium",
    "first_contact",
    "least_overlap",
]
