"""Compliance of teeth by finite elements, from an influence table of each gear."""

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
from gearjax.influence.table import gear_hash
from gearjax.parameters import check_parameters, count, file_name, length, number
from gearjax.typing import Array, Float, Number
from gearjax.units import mm

APART = 0.05  # share of the span of nodes by which contacts may lie beyond the nodes
FEWEST_POINTS = 3  # along the profile: a single nodal force would show the size of the elements, not the teeth
MARGIN = 1e-6  # share of a radius by which nodes are placed beyond the contacts


class InfluenceMatrix(AbstractToothCompliance):
    """Teeth of both gears by finite elements, condensed once to the nodes of their flanks (Yang, Tang, Liang 2019).

    Each gear has an `InfluenceTable`. It comes from the package's own finite elements (`tooth_influence`, which needs
    the extra ``fem``), whose result can be kept in a folder for the next time, or from a file of another program.
    Between the nodes of the table the influence is interpolated, by cubic splines along the profile, so that it changes
    smoothly as the gears turn. The gear set needs several candidates along the profile: its ``profile_points`` should
    be about the number of elements. With a single candidate across the face, the force of each candidate is uniform
    over the face.

    `made_for` provides the tables for a gear set; a configuration calls it when it is read. The tables do not change
    while a study varies numbers of the gear set, and a scene with other gears refuses them. If there are fewer
    candidates along the profile than elements, `made_for` warns (`gearjax.FewCandidates`), because loads of single
    pairs then have errors of some per cent.

    Args:
        youngs_modulus: Young's modulus of both gears [Pa].
        poissons_ratio: Poisson's ratio of both gears [-].
        external_width: face width of the external gear [m]; the narrower gear is in the middle of the wider gear.
        internal_width: face width of the internal gear [m]; the narrower gear is in the middle of the wider gear.
        rim: depth under the root circle at which a gear is held [m]; it has a decisive influence.
        profile_elements: number of elements along the part of the profile that may touch.
        layers: number of elements across the part of the face where both gears meet.
        external_file: file with the table of the external gear from another program (`save_influence`); give both files
            or none. In a configuration the path starts at the folder of the configuration.
        internal_file: file with the table of the internal gear from another program; give both files or none.
        cache: folder where tables of the package's own finite elements are kept; without it, they are not kept. In a
            configuration the path starts at the folder of the configuration.
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
        points = radii[0].shape[-1]
        self._check_points(points)
        if self.tables is not None and [t.made_for for t in self.tables] == [gear_hash(gear) for gear in gears]:
            return self
        if self.external_file:
            files = zip((self.external_file, self.internal_file), gears, strict=True)
            tables = tuple(read_influence(file, gear) for file, gear in files)
        else:
            widths = float(self.external_width), float(self.internal_width)
            each = zip(gears, radii, widths, strict=True)
            tables = tuple(self._run(gear, radius, width, min(widths)) for gear, radius, width in each)
        self._check_reach(tables, radii)
        elements = min(len(table.radius) for table in tables) - 1
        if points < elements:
            words = f"influence_matrix: {points} candidates along the profile are fewer than its {elements} elements"
            warnings.warn(f"{words}: give system.profile_points = {elements}", FewCandidates, stacklevel=2)
        return eqx.tree_at(lambda part: part.tables, self, tables, is_leaf=lambda part: part is None)

    def check(self, places: Places) -> None:
        tables = self._made
        points, faces = places.radius[0].shape[-1], places.face.shape[0]
        self._check_points(points)
        for table, gear in zip(tables, places.gears, strict=True):
            table.check_gear(gear)
        self._check_reach(tables, places.radius)
        for name, given, nodes in (
            ("profile_points", points, max(len(table.radius) for table in tables)),
            ("face_points", faces, max(len(table.face) for table in tables)),
        ):
            if given > nodes:
                words = f"must be at most {nodes}, the nodes of influence_matrix: with more, the matrix is singular"
                raise ParameterError(f"system.{name}", given, words)

    @property
    def _made(self) -> tuple[InfluenceTable, InfluenceTable]:
        if self.tables is None:
            raise SceneError("influence_matrix has no tables: use compliance.made_for(...), as gj.load does")
        return self.tables

    def _check_points(self, points: int) -> None:
        if points < FEWEST_POINTS:
            words = f"influence_matrix needs at least {FEWEST_POINTS} candidates along the profile of each pair"
            raise ParameterError("system.profile_points", points, words)

    def _check_reach(self, tables: tuple[InfluenceTable, ...], radii: tuple[Array, Array]) -> None:
        """Refuse tables whose nodes do not reach to all contacts: contacts beyond them would count as at the edge."""
        shared = min(float(self.external_width), float(self.internal_width))
        for side, table, own in zip(("external", "internal"), tables, radii, strict=True):
            low, high, face = float(own.min()), float(own.max()), float(table.face[-1] - table.face[0])
            begin, end = float(table.radius[0]), float(table.radius[-1])
            room = APART * (high - low)
            if not (begin <= low + room and end >= high - room):
                raise SceneError(
                    f"influence_matrix: nodes of the {side} gear reach from {begin / mm:.6g} to {end / mm:.6g} mm of "
                    f"radius, its contacts from {low / mm:.6g} to {high / mm:.6g} mm"
                )
            if not abs(face - shared) <= APART * shared:
                raise SceneError(
                    f"influence_matrix: nodes of the {side} gear reach over {face / mm:.6g} mm of face, the gears "
                    f"share {shared / mm:.6g} mm"
                )

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
        tables = self._made
        each = places.radius[0][0].size * places.face.shape[0]
        whole = jnp.zeros((places.pair.shape[0], each, each), places.pair.dtype)
        for table, radius, gear in zip(tables, places.radius, places.gears, strict=True):
            # driving flanks of the external gear face increasing angles, the flanks of the ring under them face
            # decreasing angles; back flanks are given as their mirror image
            facing = table.mirrored if gear.internal else table
            whole = whole + jax.vmap(_between, (None, 0, 0, None))(facing, radius, places.pair, places.face)
        return block_diagonal(whole)


def _between(
    table: InfluenceTable, radius: Float[Array, "pair point"], tooth: Float[Array, " pair"], face: Float[Array, " face"]
) -> Float[Array, "contact contact"]:
    """Influence of the contacts of one gear [m/N], in the order pair, point, place across the face."""
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
