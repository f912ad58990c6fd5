"""Compliance of teeth by finite elements: tables of both gears, between whose nodes the contacts stand."""

import warnings
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import FewCandidates, ParameterError, SceneError
from gearjax.compliance.base import AbstractToothCompliance
from gearjax.compliance.line_contact import HertzLineContact
from gearjax.contact import Places
from gearjax.contact.springs import block_diagonal
from gearjax.geometry.involute import InvoluteGear
from gearjax.influence import InfluenceTable, influence_of, read_influence, tooth_influence
from gearjax.influence.interpolate import across_face, along_radius
from gearjax.parameters import check_parameters, count, file_name, length, number
from gearjax.typing import Array, Float, Number

FEWEST_POINTS = 3  # along the profile: single nodal forces would tell of the elements, not of the teeth
MARGIN = 1e-6  # of a radius, that nodes stand beyond the contacts


class InfluenceMatrix(AbstractToothCompliance):
    """Teeth of both gears by finite elements, condensed once to the nodes of their flanks (Yang, Tang, Liang 2019).

    Each gear has its `InfluenceTable`: of the package's own run (`tooth_influence`, which needs the extra ``fem``),
    kept in a folder and taken from there the next time, or of a file that another program wrote. Contacts stand between
    its nodes, by cubic splines along the profile, without snapping as the gears turn. It needs candidates along the
    profile, ``profile_points`` of the gear set about as many as there are elements; with a single one across the face
    the force of each spreads over it evenly.

    `made_for` finds the tables for a gear set: configurations do so as they are read. They stay what they are while
    numbers of the gear set are varied. Where candidates along the profile are fewer than elements, it warns
    (`gearjax.FewCandidates`): loads of single pairs are then off by some per cent.

    Args:
        youngs_modulus, poissons_ratio: of both gears [Pa], [-].
        external_width, internal_width: of the teeth [m]; the narrower one meets the middle of the other.
        rim: depth under the root circle at which a gear is held [m]: as decisive as where the teeth stand.
        profile_elements, layers: elements along the part of the profile that may touch, and across the face.
        external_file, internal_file: tables of another program (`save_influence`); both or none.
        cache: folder where tables of the own run are kept; not kept without. In a configuration these three are looked
            for from its folder on.
    """

    kind: ClassVar[str] = "influence_matrix"
    prepares: ClassVar[bool] = True
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13, example="206 GPa")
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.49, example=0.3)
    external_width: Number = length(at_least=1e-6, at_most=10.0, example="6.5 mm")
    internal_width: Number = length(at_least=1e-6, at_most=10.0, example="14 mm")
    rim: Number = length(at_least=1e-6, at_most=10.0, example="0.8 mm")
    profile_elements: int = count(at_least=3, at_most=100, default=10)
    layers: int = count(at_most=200, default=13)
    external_file: str = file_name(default="")
    internal_file: str = file_name(default="")
    cache: str = file_name(default="")
    tables: tuple[InfluenceTable, InfluenceTable] | None = None

    def __check_init__(self):
        check_parameters(self)
        if bool(self.external_file) != bool(self.internal_file):
            raise ParameterError("external_file", self.external_file, "give external_file and internal_file, or none")

    def made_for(self, gears: tuple[InvoluteGear, InvoluteGear], radii: tuple[Array, Array]) -> "InfluenceMatrix":
        if self.tables is not None:
            return self
        points = radii[0].shape[-1]
        if points < FEWEST_POINTS:
            words = f"influence_matrix needs at least {FEWEST_POINTS} candidates along the profile of each pair"
            raise ParameterError("system.profile_points", points, words)
        if self.external_file:
            files = zip((self.external_file, self.internal_file), gears, strict=True)
            tables = tuple(read_influence(file, gear) for file, gear in files)
        else:
            widths = float(self.external_width), float(self.internal_width)
            each = zip(gears, radii, widths, strict=True)
            tables = tuple(self._run(gear, radius, width, min(widths)) for gear, radius, width in each)
        elements = min(len(table.radius) for table in tables) - 1
        if points < elements:
            words = f"influence_matrix: {points} candidates along the profile are fewer than its {elements} elements"
            warnings.warn(f"{words}: give system.profile_points = {elements}", FewCandidates, stacklevel=2)
        return eqx.tree_at(lambda part: part.tables, self, tables, is_leaf=lambda part: part is None)

    def _run(self, gear: InvoluteGear, radius: Array, width: float, meets: float) -> InfluenceTable:
        low, high, tip = float(radius.min()), float(radius.max()), float(gear.tip_radius)
        low, high = (tip, high * (1 + MARGIN)) if gear.internal else (low * (1 - MARGIN), tip)
        return tooth_influence(
            gear,
            face_width=width,
            youngs_modulus=float(self.youngs_modulus),
            poissons_ratio=float(self.poissons_ratio),
            rim=float(self.rim),
            touching=(low, high),
            meeting=(0.5 * (width - meets), 0.5 * (width + meets)),
            profile_elements=self.profile_elements,
            layers=self.layers,
            cache=self.cache or None,
        )

    @property
    def line_contact(self) -> HertzLineContact:
        return HertzLineContact.of_teeth(self)

    def influence(self, places: Places) -> Float[Array, "contact contact"]:
        if self.tables is None:
            raise SceneError("influence_matrix has no tables: use compliance.made_for(...), as gj.load does")
        each = places.radius[0][0].size * places.face.shape[0]
        whole = jnp.zeros((places.pair.shape[0], each, each), places.pair.dtype)
        for table, radius, gear in zip(self.tables, places.radius, places.gears, strict=True):
            # driving flanks of the external gear face increasing angles, those of the ring that they press decreasing
            # ones; back flanks come as their mirror image
            facing = table.mirrored if gear.internal else table
            whole = whole + jax.vmap(_between, (None, 0, 0, None))(facing, radius, places.pair, places.face)
        return block_diagonal(whole)


def _between(
    table: InfluenceTable, radius: Float[Array, "pair point"], tooth: Float[Array, " pair"], face: Float[Array, " face"]
) -> Float[Array, "contact contact"]:
    """Influence of the contacts of one gear, by pair, point and place across the face."""
    rows = along_radius(table, radius.ravel())
    if face.shape[0] == 1:
        parts = jnp.diff(table.face)
        even = jnp.concatenate([parts[:1], parts[1:] + parts[:-1], parts[-1:]])[None]
        even = even / even.sum()
    else:
        width = table.face[-1] - table.face[0]
        even = across_face(table, table.face[0] + (face + 0.5) * width)
    weights = (rows[:, None, :, None] * even[None, :, None, :]).reshape(-1, table.matrix.shape[1])
    return influence_of(table, weights, jnp.repeat(tooth, radius.shape[1] * face.shape[0]))
