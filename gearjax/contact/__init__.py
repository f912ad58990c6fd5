"""Candidate contacts, contact laws, and the static equilibrium of one-sided springs."""

from gearjax.contact.contacts import ContactSet
from gearjax.contact.equilibrium import Equilibrium, equilibrium, first_contact
from gearjax.contact.faces import Faces
from gearjax.contact.helical_mesh import HelicalMesh
from gearjax.contact.interference import Overlap, least_overlap
from gearjax.contact.laws import AbstractContact, HardContact, QuadraticContact, SoftplusContact
from gearjax.contact.layout import Layout
from gearjax.contact.pose import (
    BodyView,
    GearSize,
    Moved,
    Movements,
    Places,
    Pose,
    ProfilePlace,
    Request,
    Rim,
    even_parts,
)
from gearjax.contact.slices import Slices
from gearjax.contact.springs import CoupledSprings, LinearSprings, LineSprings, Springs, join_springs

__all__ = [
    "AbstractContact",
    "BodyView",
    "ContactSet",
    "CoupledSprings",
    "Equilibrium",
    "Faces",
    "GearSize",
    "HardContact",
    "HelicalMesh",
    "Layout",
    "LineSprings",
    "LinearSprings",
    "Moved",
    "Movements",
    "Overlap",
    "Places",
    "Pose",
    "ProfilePlace",
    "QuadraticContact",
    "Request",
    "Rim",
    "Slices",
    "SoftplusContact",
    "Springs",
    "equilibrium",
    "even_parts",
    "first_contact",
    "join_springs",
    "least_overlap",
]
