"""Analytic compliance of involute teeth at points along profile and face: beam, foundation and contact.

For each gear, the approach at one place of the profile under a force at another place is the sum of:

- beam: bending, shear and compression of the tooth from the beginning of its fillet, 0.2 modules from the root circle,
  over the sections that both forces load, ``M_a M_b / (E' I) + N_a N_b / (E' A)`` (Weber and Banaschek 1953). If the
  thickness t grows towards the root, inclined bending stresses carry a part of the shear force. With ``q = Q / t``,
  ``m = M t' / t^2`` and ``n = nu / (1 - nu)`` equilibrium gives the shear stress ``1.5 q (1 - y^2) + m (4.5 y^2 -
  1.5)``. With the transverse stress the energy is ``t (1.2 q_a q_b / G - (0.6 / G + 1.2 n / E') (q_a m_b + q_b m_a) +
  (1.8 / G - 1.2 n / E') m_a m_b)``. For a straight beam this is 1.2 q^2, for a wedge loaded at its apex it agrees with
  Carothers' solution;
- bulging: a force compresses the fibres beside it, which bulge and bend the tooth. At a distance x towards the tip or
  the root this adds ``1.2 n |x| / (E' t)``, the term by which the deflection of an infinite strip under pressure
  exceeds the deflection of a beam with 1.2 Q^2;
- foundation: an elastic layer on rigid ground (`layer_compliance`), as deep as the rim, which also couples
  neighbouring teeth. The rim is bent around the gear; the depth of the layer is chosen so that a uniform shear shifts
  it as far as the rim. Without a rim the foundation is a half-plane, ``cos b_a cos b_b / E' (18 / pi u_a u_b / s^2 +
  (1 - 2 nu) / (1 - nu) (u_a + u_b) / s + 4.8 / pi (1 + (1 - nu) / 2.4 tan b_a tan b_b))`` with the lever u of each
  force, its inclination b and the thickness s of the tooth at its root (Weber and Banaschek 1953);
- contact: an infinite strip as thick as the tooth, pressed on one side, minus its deflection as a beam. Fourier
  integrals give ``2 / (pi E')`` times 0.60, 0.28, 0.13 and 0.03 at distances of 0.3, 0.5, 0.7 and 1 times h, half of
  the thickness; the integral over all places is ``0.366 t / E'``. The function ``1 / (pi E') exp(-(x / (0.8 h))^2)
  ln(1 + (a h / x)^2)`` has the same integral and these values within 0.05. Near the force it becomes Weber and
  Banaschek's ``2 / (pi E') (ln(h / x) - 1 / (2 (1 - nu)))``, which determines a. At the tip, as at a free end, the
  function is mirrored.

No stiffness is fitted. In gears with few teeth difference, the flanks lie on each other over all of the profile that
they share. A single candidate of a pair has a uniform pressure there; several candidates have one part of the profile
each. Across the face, beam and foundation deflect as an elastic layer whose deflection v decays over a length l
(``v - l^2 v''``, free ends), and each contact compresses its own slice only. For beams l is the coupling length. For
neighbouring teeth l is the rim depth if that is larger, and for the foundation under the loaded tooth the geometric
mean of both. This choice follows finite elements of one ring with a rim of 2 mm.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.compliance.base import AbstractToothCompliance
from gearjax.compliance.elastic_layer import layer_compliance
from gearjax.compliance.line_contact import HertzLineContact
from gearjax.contact import Places, even_parts
from gearjax.contact.springs import block_diagonal
from gearjax.geometry.involute import InvoluteGear
from gearjax.kernels import once
from gearjax.parameters import check_parameters, count, known_beside, length, number, with_known
from gearjax.typing import Array, Float, Number, Scalar

NODES = 8  # nodes of Gauss' quadrature from the root to a load
SHEAR = 1.2  # shear correction factor of a rectangular section
FILLET = 0.2  # height of the fillet, in modules
SHORTEST = 1e-9  # m, shortest strip of contact
FADING = 0.8  # distance, in half thicknesses, over which the contact deflection beside a force decays
# distances, in lengths of a strip, whose logarithm is the mean of ln |x - x'| and of ln (x + x') over the strip
ITSELF, MIRRORED = math.exp(-1.5), 4 * math.exp(-1.5)
MOST_NEIGHBOURS = 20
DEEPEST = 0.9  # greatest depth of an external gear's rim, as a share of its root radius


class ElasticTeeth(AbstractToothCompliance):
    """Involute teeth as beams on an elastic foundation, with the contact between their flanks.

    The candidates of a pair are coupled; with ``neighbours``, candidates of neighbouring pairs are coupled too. By
    finite elements, a uniform load moves the next pair by 3 % (rim of 1.4 modules) or 5 % (rim of 3.4 modules) of the
    deflection of the loaded pair, and the pair after that by 0.6 % or 3.4 %. Without neighbours, the candidates of each
    pair are a small block of their own, which is solved several times as fast. A single candidate of a pair has a
    uniform pressure over the profile that both teeth share.

    Accuracy, with two neighbours and nine candidates along the profile: loads above an eighth of the largest load are
    within 5 % of the finite elements of `InfluenceMatrix`, and all loads within 1.4 % of the largest. This was checked
    on the pair of Yang, Tang and Liang (2019) with a rim of 0.8 mm and of 2 mm, and on 60 teeth in 64 of 2 mm module
    with a rim of 6 mm. With five candidates, small loads at the ends of contact have an error of up to 10 % of their
    own value; finite elements with five candidates lose as much. Without neighbours, loads of about a quarter of the
    largest are up to 13 % too small and smaller loads by more, all within 4 % of the largest.

    Args:
        youngs_modulus: Young's modulus E of both gears [Pa].
        poissons_ratio: Poisson's ratio nu of both gears [-].
        external_width: face width of the external gear [m]; contacts extend over the narrower gear.
        internal_width: face width of the internal gear [m]; contacts extend over the narrower gear.
        coupling_length: length l over which deflections decay across the face, in modules [-].
        rim: depth under the root circle at which the gears are held [m]; without it, the teeth are on a half-plane.
        neighbours: number of teeth to each side that a loaded tooth moves through the rim.
    """

    kind: ClassVar[str] = "elastic_teeth"
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13, example="206 GPa")
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.49, example=0.3)
    external_width: Number = length(at_least=1e-6, at_most=10.0, example="6.5 mm")
    internal_width: Number = length(at_least=1e-6, at_most=10.0, example="14 mm")
    coupling_length: Number = number(units.RATIO, above=0.0, at_most=100.0, default=1.5)
    rim: Number | None = length(at_least=1e-6, at_most=10.0, default=None, example="0.8 mm")
    neighbours: int = count(at_least=0, at_most=MOST_NEIGHBOURS, default=0)

    known_layers: tuple[Float[Array, "distance 3 3"], Float[Array, "distance 3 3"]] | None = known_beside()

    def __check_init__(self):
        check_parameters(self)
        if self.neighbours and self.rim is None:
            raise ParameterError(
                "neighbours", self.neighbours, "neighbouring teeth deflect each other through the rim: give rim too"
            )

    def choices(self) -> Mapping[str, "ElasticTeeth"]:
        if self.rim is None:
            return {}
        numbers = range(min(self.neighbours + 2, MOST_NEIGHBOURS + 1))
        return {f"neighbours = {n}": dataclasses.replace(self, neighbours=n) for n in numbers}

    @property
    def line_contact(self) -> HertzLineContact:
        return HertzLineContact.of_teeth(self)

    @property
    def precomputes(self) -> bool:
        return True

    def precomputed(self, places: Places) -> "ElasticTeeth":
        return self if self.rim is None else with_known(self, known_layers=self._layers(places))

    def influence(self, places: Places) -> Float[Array, "contact contact"]:
        return block_diagonal(self.blocks(places))

    def blocks(self, places: Places) -> Float[Array, "block own own"]:
        points = _points(places.gears[0], places.radius[0]), _points(places.gears[1], places.radius[1])
        own = jax.vmap(jax.vmap(lambda of_pair, shared: self._pair(places, of_pair, shared)))(points, places.shared)
        if self.neighbours:
            beside = jax.vmap(lambda of_block, pair: self._beside(places, of_block, pair))(points, places.pair)
            blocks = jax.vmap(block_diagonal)(own) + beside
        else:
            blocks = own.reshape(-1, *own.shape[2:])  # each pair of teeth is one block
        return 0.5 * (blocks + jnp.swapaxes(blocks, 1, 2))  # exactly symmetric, also in single precision

    def _pair(
        self, places: Places, points: tuple["_Points", "_Points"], shared: Scalar
    ) -> Float[Array, "contact contact"]:
        """Approach per force of the contacts of one pair [m/N]; contacts in the order point, place across the face."""
        number, face = points[0].arm.shape[0], places.face.shape[0]
        width = jnp.minimum(self.external_width, self.internal_width)
        slices = jnp.diag(1 / (width * even_parts(face, width.dtype)))
        whole = jnp.zeros((number, face, number, face), shared.dtype)
        widths, layers = (self.external_width, self.internal_width), self._layers(places)
        for gear, of_gear, own, layer in zip(places.gears, points, widths, layers, strict=True):
            short, ground = self._reach(gear)
            middle = jnp.sqrt(short * ground)  # of the foundation under the loaded tooth
            for along, across in (
                (self._beam(gear, of_gear), _across(places.face * width, width, own, short)),
                (self._foundation(gear, of_gear, layer), _across(places.face * width, width, own, middle)),
                (self._contact(gear, of_gear, shared), slices),
            ):
                whole = whole + along[:, None, :, None] * across[None, :, None, :]
        return whole.reshape(number * face, number * face)

    def _beside(
        self, places: Places, points: tuple["_Points", "_Points"], pair: Array
    ) -> Float[Array, "contact contact"]:
        """Approach per force of contacts on neighbouring teeth [m/N], in the order pair, point, place on the face."""
        face, size = places.face.shape[0], points[0].arm.size
        width = jnp.minimum(self.external_width, self.internal_width)
        tooth = jnp.repeat(pair, size // pair.shape[0])
        ahead = tooth[None, :] - tooth[:, None]
        whole = jnp.zeros((size, face, size, face), pair.dtype)
        widths, layers = (self.external_width, self.internal_width), self._layers(places)
        for gear, of_gear, own, layer in zip(places.gears, points, widths, layers, strict=True):
            assert layer is not None  # only with a rim do teeth move their neighbours
            at_root = of_gear.at_root
            along = jnp.zeros((size, size), pair.dtype)
            for distance in range(1, self.neighbours + 1):
                moved = at_root @ layer[distance] @ at_root.T
                along = along + jnp.where(ahead == distance, moved, 0.0) + jnp.where(ahead == -distance, moved.T, 0.0)
            across = _across(places.face * width, width, own, self._reach(gear)[1])
            whole = whole + along[:, None, :, None] * across[None, :, None, :]
        return whole.reshape(size * face, size * face)

    def _reach(self, gear: InvoluteGear) -> tuple[Scalar, Scalar]:
        """Lengths over which a deflection decays across the face, of a tooth and of the rim [m]."""
        short = self.coupling_length * gear.module
        return short, short if self.rim is None else jnp.maximum(short, self.rim)

    def _beam(self, gear: InvoluteGear, points: "_Points") -> Float[Array, "point point"]:
        """Beam: approach per force for a unit of width [m2/N]."""
        arm, across, along, side = points.arm, points.across, points.along, points.along * points.half
        turned, leant, moved, pressed = (part[:, None] for part in self._below(gear, arm))
        # both loads act in the sections from the root to the lower load, that of the row
        other = across[None, :] * (arm[None, :] - arm[:, None]) - side[None, :]  # moment of the higher load there
        mixed = across[:, None] * other - side[:, None] * across[None, :]
        both, lengthwise = across[:, None] * across[None, :], along[:, None] * along[None, :]
        whole = both * moved + mixed * leant - side[:, None] * other * turned + lengthwise * pressed
        # a load is no lower than itself, which rounding must not decide (`_apart`)
        lower = (arm[:, None] < arm[None, :]) | np.eye(arm.shape[0], dtype=bool)
        beside = self._bulge * _apart(arm) / jnp.maximum(points.half[:, None], points.half[None, :])
        return jnp.where(lower, whole, whole.T) + 0.5 * both * beside

    def _below(self, gear: InvoluteGear, arm: Float[Array, " point"]) -> Float[Array, "4 point"]:
        """Deflections at each load for a unit of width, by the sections between the root and the load.

        They are the turn under a unit moment, its shift, which is the turn under a unit force across the tooth, the
        shift under that force, and the shift along the tooth under a unit force along it [1/N, m/N, m2/N, m2/N].

        Args:
            gear: the gear.
            arm: height of each load above the root [m].
        """
        nodes, weights = (jnp.asarray(part, arm.dtype) for part in np.polynomial.legendre.leggauss(NODES))
        beneath, step = 0.5 * (1 - nodes)[None] * arm[:, None], 0.5 * weights[None] * arm[:, None]
        at = gear.section(root_of(gear))[0] + _outwards(gear) * (arm[:, None] - beneath)
        inwards = jnp.full_like(at, -_outwards(gear))
        thick, grows = once(*jax.jvp(lambda radius: 2 * gear.half_thickness(radius), (at,), (inwards,)))
        modulus, rigidity = self.line_contact.plane_modulus, self.youngs_modulus / (2 * (1 + self.poissons_ratio))
        # energy of a moment, of a moment with a force across the tooth, of that force; inclined stresses carry a part
        inclined = grows / thick**2
        turned = 12 / (modulus * thick**3) + (1.5 * SHEAR / rigidity - self._bulge) * inclined**2 * thick
        leant = -(0.5 * SHEAR / rigidity + self._bulge) * inclined
        sheared, pressed = SHEAR / (rigidity * thick), 1 / (modulus * thick)
        leans, moves = turned * beneath + leant, turned * beneath**2 + 2 * leant * beneath + sheared
        return (jnp.stack([turned, leans, moves, pressed]) * step[None]).sum(axis=-1)

    @property
    def _bulge(self) -> Scalar:
        """Factor of the deflections by fibres that bulge beside a force [1/Pa]."""
        return SHEAR * self.poissons_ratio / (1 - self.poissons_ratio) / self.line_contact.plane_modulus

    def _layers(self, places: Places) -> tuple[Array, Array] | tuple[None, None]:
        """Compliance of the rim of each gear (`_layer`), if there is one."""
        if self.rim is None:
            return None, None
        first, second = places.gears
        return self.known_layers or (self._layer(first, self.rim), self._layer(second, self.rim))

    def _layer(self, gear: InvoluteGear, held: Scalar) -> Float[Array, "distance 3 3"]:
        """Compliance of the rim between the root of a tooth and the roots of the teeth ahead (`layer_compliance`)."""
        sign, root = (-1.0 if gear.internal else 1.0), gear.root_radius
        rim = held if gear.internal else jnp.minimum(held, DEEPEST * root)
        depth = 0.5 * sign * root * ((root / (root - sign * rim)) ** 2 - 1)
        # forces on driving teeth act towards decreasing angles on the external gear, towards increasing ones on the
        # ring
        pitch = -sign * 2 * math.pi / gear.teeth * root
        apart = pitch * jnp.arange(self.neighbours + 1, dtype=pitch.dtype)
        thick = 2 * gear.section(root_of(gear))[1]
        return layer_compliance(apart, thick, depth, self.line_contact.plane_modulus, self.poissons_ratio)

    def _foundation(
        self, gear: InvoluteGear, points: "_Points", layer: Float[Array, "distance 3 3"] | None
    ) -> Float[Array, "point point"]:
        """Foundation under the loaded tooth: approach per force for a unit of width [m2/N]."""
        at_root = points.at_root
        if layer is not None:
            return at_root @ layer[0] @ at_root.T
        thick, nu = 2 * gear.section(root_of(gear))[1], self.poissons_ratio
        cross = (1 - 2 * nu) / (1 - nu) / thick
        zero = jnp.zeros_like(cross)
        shift, turn = jnp.full_like(cross, 4.8 / math.pi), 18 / math.pi / thick**2
        sunk = jnp.full_like(cross, 2 / math.pi) * (1 - nu)
        rows = [[shift, cross, zero], [cross, turn, zero], [zero, zero, sunk]]
        half_plane = jnp.stack([jnp.stack(row) for row in rows])
        return at_root @ half_plane @ at_root.T / self.line_contact.plane_modulus

    def _contact(self, gear: InvoluteGear, points: "_Points", shared: Scalar) -> Float[Array, "point point"]:
        """Contact: approach per force for a unit of width [m2/N]."""
        half, length, number = points.half, points.length, points.half.shape[0]
        # places are scaled by the thickness of the tooth, which keeps the matrix positive definite
        strip = shared if number == 1 else jnp.abs(length[-1] - length[0])
        strip = jnp.maximum(strip * even_parts(number, strip.dtype), SHORTEST) / half
        end, tip = gear.section(gear.tip_radius)[1], _length(gear, gear.tip_radius)
        place = gear.from_tip(length, tip) / jnp.sqrt(half * end)
        own, apart, mirrored = np.eye(number, dtype=bool), _apart(place), place[:, None] + place[None, :]
        apart = jnp.where(own, ITSELF * strip[:, None], jnp.maximum(apart, SHORTEST / half[:, None]))
        mirrored = jnp.where(own, jnp.maximum(mirrored, MIRRORED * strip[:, None]), mirrored)
        near = jnp.exp(-1 / (1 - self.poissons_ratio))
        # both factors have positive definite matrices, so that their product has one too
        one, other = (jnp.exp(-((at / FADING) ** 2)) * jnp.log1p(near / (at * at)) for at in (apart, mirrored))
        return (one + other) / (math.pi * self.line_contact.plane_modulus)


def _outwards(gear: InvoluteGear) -> float:
    """Sign of the way from the root of a tooth to its tip: the root of an internal gear is outside."""
    return -1.0 if gear.internal else 1.0


class _Points(NamedTuple):
    """Points on the flanks of one gear at which forces act, as arrays of any one shape.

    Args:
        arm: height above the root of the tooth, where its fillet begins [m].
        half: half of the tooth's thickness [m].
        across, along: components of a unit force on the flank, across the tooth and along it [-].
        length: length of the involute from the base circle [m].
    """

    arm: Array
    half: Array
    across: Array
    along: Array
    length: Array

    @property
    def at_root(self) -> Float[Array, "point 3"]:
        """Shear force, moment and normal force at the root per force at each point [-], [m], [-]."""
        arm, half, across, along, _ = (part.ravel() for part in self)
        return jnp.stack([across, across * jnp.abs(arm) - along * half, along], axis=-1)


def _points(gear: InvoluteGear, radius: Array) -> _Points:
    """Points of the flanks of a gear, given by their radii [m]."""
    (height, half, slant), foot = gear.section(radius), gear.section(root_of(gear))[0]
    parts = _outwards(gear) * (height - foot), half, jnp.cos(slant), jnp.sin(slant), _length(gear, radius)
    return _Points(*once(*parts))


def _length(gear: InvoluteGear, radius: Array) -> Array:
    """Length of an involute from the base circle to a radius of any shape [m]."""
    return 0.5 * gear.base_radius * gear.roll_at(radius) ** 2


def _apart(place: Float[Array, " point"]) -> Float[Array, "point point"]:
    """Distances between all pairs of places.

    The distance of a place from itself is exactly zero, and so is its derivative. With the absolute value alone,
    compiled gradients would be wrong there: XLA calculates a place once for each kernel, and the difference of two such
    results has the sign of their rounding.
    """
    return jnp.where(np.eye(place.shape[0], dtype=bool), 0.0, jnp.abs(place[:, None] - place[None, :]))


def _across(place: Float[Array, " face"], loaded: Scalar, width: Scalar, reach: Scalar) -> Float[Array, "face face"]:
    """Deflection across the face: `even_across` for a single place, `deflection_across` for several [1/m]."""
    if place.shape[0] == 1:
        return even_across(loaded, width, reach)[None, None]
    return deflection_across(place, width, reach)


def deflection_across(place: Float[Array, " face"], width: Scalar, reach: Scalar) -> Float[Array, "face face"]:
    """Deflection at each place across a face per force at each other place, as a factor per unit of width [1/m].

    The factor multiplies the deflection of a unit of width under a uniform load. It is that of an elastic layer whose
    deflection decays over a length l: ``cosh(low / l) cosh(high / l) / (l sinh(w / l))``. Here ``low`` is the distance
    from the lower place to the lower end of the face, ``high`` the distance from the higher place to the higher end.

    Args:
        place: places across the face, counted from its middle [m].
        width: face width w of the tooth [m].
        reach: length l [m].
    """
    middle, apart = 0.5 * (place[:, None] + place[None, :]), _apart(place)
    low, high = 0.5 * (width - apart) + middle, 0.5 * (width - apart) - middle
    # these exponentials do not overflow, unlike cosh and sinh
    decay = jnp.exp(-apart / reach)
    grown = decay * (1 + jnp.exp(-2 * low / reach)) * (1 + jnp.exp(-2 * high / reach))
    return 0.5 * grown / (reach * -jnp.expm1(-2 * width / reach))


def even_across(loaded: Scalar, width: Scalar, reach: Scalar) -> Scalar:
    """Mean deflection under a uniform load on the middle part of a tooth, as a factor per unit of width [1/m].

    It is the counterpart of `deflection_across` for one force that is spread over the loaded part. It is one over the
    width if the whole tooth is loaded, and smaller if the tooth is wider than the loaded part.
    """
    half, beside = 0.5 * loaded / reach, 0.5 * (width - loaded) / reach
    # 1 - (2 l / w) sinh(half) sinh(beside) / sinh(half + beside)
    spread = -jnp.expm1(-2 * half) * jnp.expm1(-2 * beside) / jnp.expm1(-2 * (half + beside))
    return (1 - 0.5 * spread / half) / loaded


def root_of(gear: InvoluteGear) -> Scalar:
    """Radius where the fillet of a tooth begins, not below the base circle of an external gear [m]."""
    fillet = FILLET * gear.module
    if gear.internal:
        return gear.root_radius - fillet
    return jnp.maximum(gear.root_radius + fillet, gear.first_radius)
