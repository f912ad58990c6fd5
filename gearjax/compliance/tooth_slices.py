"""Analytic compliance of the teeth of a helical or spur pair, in slices that are independent or coupled along the face.

A slice is a spur tooth in the transverse section. Under a force per width at a point of its profile it deflects by

- bending, shear and compression of the tooth above its root circle, by energy (Weber and Banaschek 1953; Yang and
  Lin 1987);
- the foundation: on an external gear the ring under the tooth, ``cos^2 a (L (u/s)^2 + M u/s + P (1 + Q tan^2 a))`` with
  the polynomials of Sainsot, Velex and Duverger (2004); on an internal gear a half-plane (Weber and Banaschek);
- contact: a constant ``4 (1 - nu^2) / (pi E)`` (Yang and Sun 1985), or Hertzian contact between the flanks and the
  middles of the teeth, whose stiffness grows with the force (Weber and Banaschek).

The sum is the compliance in the transverse section; along the normal of the flanks it is ``cos^2 beta_b`` times the
sum. The root of an external gear is that of straight flanks, or has the fillet that its rack cuts (`RootFillet`). A
straight root is thinner. Its foundation deflects 1.1 to 1.4 times as much as the elastic layer of `ElasticTeeth` on a
rim of the same depth with 33 teeth and more; with 19 teeth, twice as much.

If the slices are coupled along the face, tooth and foundation deflect as an elastic layer whose deflection v decays
over a length l (``v - l^2 v''`` with free ends).
"""

import dataclasses
import math
from collections.abc import Mapping
from functools import partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.compliance.along_face import factors_along
from gearjax.compliance.base import AbstractSliceCompliance
from gearjax.compliance.line_contact import HertzLineContact
from gearjax.contact import CoupledSprings, Faces, LinearSprings, LineSprings, Slices, Springs, join_springs
from gearjax.geometry.involute import InvoluteGear
from gearjax.geometry.root_fillet import RootFillet
from gearjax.kernels import once
from gearjax.parameters import check_parameters, known_beside, length, name, number, with_known
from gearjax.typing import Array, Float, Number, Scalar

PLACES_ALONG = 20
NODES = 12  # nodes of Gauss' quadrature in each part of a tooth
PLACES = np.cos(np.pi * (np.arange(PLACES_ALONG) + 0.5) / PLACES_ALONG)
"""Chebyshev points along the path of contact, from -1 to 1, at which the teeth are calculated."""
TO_SERIES = np.cos(np.arange(PLACES_ALONG)[:, None] * np.arccos(PLACES)) * 2 / PLACES_ALONG
TO_SERIES[0] *= 0.5
"""Matrix from the values at these points to the coefficients of the Chebyshev polynomials."""
SHEAR = 1.2  # shear correction factor of a rectangular section
LEAST_SHARE = 1e-6  # smallest share of a slice on the path of contact that is divided by
UNTOLD = 3.0  # root diameter over bore if no bore is given: a foundation of medium stiffness
MOST_SOLID = 7.0  # highest root diameter over bore for which the polynomials of the foundation are valid
SAINSOT = np.array(
    [
        [-5.574e-5, -1.9986e-3, -2.3015e-4, 4.7702e-3, 0.0271, 6.8045],
        [60.111e-5, 28.100e-3, -83.431e-4, -9.9256e-3, 0.1624, 0.9086],
        [-50.952e-5, 185.50e-3, 0.0538e-4, 53.300e-3, 0.2895, 0.9236],
        [-6.2042e-5, 9.0889e-3, -4.0964e-4, 7.8297e-3, -0.1472, 0.6904],
    ]
)
"""Coefficients A to F of L, M, P and Q, ``A / theta^2 + B h^2 + C h / theta + D / theta + E h + F`` (Sainsot et al.
2004, table 1). Here theta is the half angle of the tooth at its root, and h is root radius over bore radius."""


class ToothSlices(AbstractSliceCompliance):
    """Analytic compliance of teeth that are cut into slices across the face.

    A smaller bore makes the foundation softer: for the pair of Guo and Fang (2018) 1.6 times, from bores of the root
    diameter over 1.5 to bores of the root diameter over 4. The bore of an internal gear has no influence.

    Args:
        youngs_modulus: Young's modulus E of both gears [Pa].
        poissons_ratio: Poisson's ratio nu of both gears [-].
        contact: contact stiffness of the flanks: ``"constant"``, or ``"hertz"``, which grows with the force.
        root: root of external gears: ``"straight"``, where flanks reach the root circle without a fillet, or
            ``"fillet"``, as their rack cuts it. Teeth with fillets are stiffer.
        coupling_length: length l over which deflections decay along the face, in normal modules [-]; without it, the
            slices are independent.
        pinion_bore: diameter at which each pinion is held [m]; without it, a third of its root diameter.
        wheel_bore: diameter at which each wheel is held [m]; without it, a third of its root diameter. An internal gear
            needs none.

    Raises:
        ParameterError: a value is not physical, or coupled slices have Hertz' contact.
    """

    kind: ClassVar[str] = "tooth_slices"
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13, example="206 GPa")
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.49, example=0.3)
    contact: str = name(default="constant", names=("constant", "hertz"))
    root: str = name(default="straight", names=("straight", "fillet"))
    coupling_length: Number | None = number(units.RATIO, above=0.0, at_most=100.0, default=None, example=1.5)
    pinion_bore: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="40 mm")
    wheel_bore: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="60 mm")

    known_bodies: tuple[Float[Array, " place"], ...] | None = known_beside()

    def __check_init__(self):
        check_parameters(self)
        if self.couples and self.contact == "hertz":
            words = 'is for uncoupled slices: leave out coupling_length, or use contact = "constant"'
            raise ParameterError("contact", self.contact, words)

    def choices(self) -> Mapping[str, "ToothSlices"]:
        if not self.couples:
            return {}
        return {"slices apart": dataclasses.replace(self, coupling_length=None), "coupled slices": self}

    @property
    def couples(self) -> bool:
        return self.coupling_length is not None

    @property
    def linear(self) -> bool:
        return self.contact == "constant" and not self.couples

    @property
    def line_contact(self) -> HertzLineContact:
        return HertzLineContact(self.youngs_modulus, self.poissons_ratio, jnp.ones_like(self.youngs_modulus))

    def check(self, slices: Slices) -> None:
        for key, gear in zip(("pinion_bore", "wheel_bore"), slices.pair.gears, strict=True):
            bore, root = getattr(self, key), 2 * float(gear.root_radius)
            if bore is not None and not gear.internal and float(bore) > 0.95 * root:
                words = f"must be below the root diameter, {root / units.mm:.6g} mm, by 5 % or more"
                raise ParameterError(f"compliance.{key}", f"{float(bore) / units.mm:.6g} mm", words)
        for fillet, rack in zip(self._fillets(slices), slices.pair.racks, strict=True):
            room = math.inf if fillet is None else float(fillet.most_rounding / slices.pair.normal_module)
            if float(rack.fillet_radius) > room * (1 + 1e-9):
                words = f'is more than the tip of the rack has room for, {room:.4g} normal modules (root = "fillet")'
                raise ParameterError("fillet_radius", float(rack.fillet_radius), words)

    @property
    def precomputes(self) -> bool:
        return True

    def precomputed(self, slices: tuple[Slices, ...]) -> "ToothSlices":
        return with_known(self, known_bodies=tuple(self._along_path(mesh) for mesh in slices))

    def of_meshes(self, slices: tuple[Slices, ...]) -> Springs:
        bodies = self.known_bodies or (None,) * len(slices)
        springs = [self._springs(mesh, body) for mesh, body in zip(slices, bodies, strict=True)]
        return join_springs(springs, slices[0].share.shape[0])

    def springs(self, slices: Slices) -> Springs:
        return self._springs(slices, None)

    def _springs(self, slices: Slices, along_path: Float[Array, " place"] | None) -> Springs:
        normal = jnp.cos(slices.pair.base_helix_angle) ** 2
        width = slices.pair.face_width / slices.share.shape[-1]
        along_path = self._along_path(slices) if along_path is None else along_path
        middle, half = _middle_and_half(slices)
        body = normal * _series(along_path, (slices.roll[0] - middle) / half)
        pressed = normal * 4 / (math.pi * self.line_contact.plane_modulus)
        if self.coupling_length is not None:
            return CoupledSprings(self._coupled(slices, body, pressed / width))
        if self.contact == "constant":
            return LinearSprings((slices.share * width / (body + pressed)).ravel())
        return self._hertz(slices, body, normal, width)

    def _along_path(self, slices: Slices) -> Float[Array, " place"]:
        """Compliance of tooth and foundation of both gears in the transverse section along the path of contact, as
        coefficients of Chebyshev polynomials [m2/N].

        It is a smooth function of the length of roll, interpolated by a polynomial through its values at some points of
        the path of contact, which do not depend on the input angle.
        """
        middle, half = _middle_and_half(slices)
        first = middle + half * jnp.asarray(PLACES, middle.dtype)
        rolls = first, slices.pair.other_roll(first)
        bores = self.pinion_bore, self.wheel_bore
        values = [
            self.body(gear, roll / gear.base_radius, bore, fillet)
            for gear, roll, bore, fillet in zip(slices.pair.gears, rolls, bores, self._fillets(slices), strict=True)
        ]
        return jnp.asarray(TO_SERIES, middle.dtype) @ (values[0] + values[1])

    def _fillets(self, slices: Slices) -> tuple[RootFillet | None, ...]:
        """Fillets of both gears, where they have some."""
        if self.root == "straight":
            return None, None
        module = slices.pair.normal_module
        return tuple(
            None if gear.internal else RootFillet(gear, rack.fillet_radius * module)
            for gear, rack in zip(slices.pair.gears, slices.pair.racks, strict=True)
        )

    def body(self, gear: InvoluteGear, roll: Array, bore: Scalar | None, fillet: RootFillet | None = None) -> Array:
        """Compliance of tooth and foundation of one gear: deflection in the transverse section per force per width
        [m2/N].

        Args:
            gear: the gear in the transverse section.
            roll: roll angles at which forces act, any shape [rad].
            bore: diameter of the bore [m].
            fillet: fillet at the root; without it, the root is straight.
        """
        whole = self._tooth(gear, roll, fillet) + self._foundation(gear, roll, bore, fillet)
        return whole / self.line_contact.plane_modulus

    def _tooth(self, gear: InvoluteGear, roll: Array, fillet: RootFillet | None = None) -> Array:
        height, half, slant = gear.section(gear.radius_at(roll))
        if fillet is not None:
            return self._filleted(gear, fillet, (height, half, slant))
        foot, sign = _foot(gear), -1.0 if gear.internal else 1.0
        arm = sign * (height - foot)
        # flanks are straight below the base circle: each of the two parts of the integral has a smooth integrand
        middle = jnp.clip(sign * (gear.base_radius * jnp.cos(gear.half_angle(gear.first_radius)) - foot), 0.0, arm)
        parts = (0.0 * arm, middle), (middle, arm)
        low, high = (_energy(gear, foot, ends, (arm, half, slant), self._rigidity) for ends in parts)
        return low + high

    def _filleted(self, gear: InvoluteGear, fillet: RootFillet, force: tuple[Array, Array, Array]) -> Array:
        """Bending, shear and compression of a tooth with a fillet, as the sum over fillet and involute."""
        height, half, slant = force
        nodes, weights = _gauss(height.ndim, height.dtype)
        thick, level, rise = fillet.sections(0.5 * (1 + nodes))
        at = height[..., None] - level, half[..., None], slant[..., None]
        below = (_bent(2 * thick, at, self._rigidity) * rise * 0.5 * weights).sum(axis=-1)
        foot = fillet.at(gear.pressure_angle)[1]
        arm = height - foot
        return below + _energy(gear, foot, (0.0 * arm, arm), (arm, half, slant), self._rigidity)

    @property
    def _rigidity(self) -> Scalar:
        """``E' / G`` [-]."""
        return 2 / (1 - self.poissons_ratio)

    def _foundation(
        self, gear: InvoluteGear, roll: Array, bore: Scalar | None, fillet: RootFillet | None = None
    ) -> Array:
        height, half, slant = gear.section(gear.radius_at(roll))
        root = _root_angle(gear) if fillet is None else fillet.root_angle
        foot, thick = gear.root_radius * jnp.cos(root), 2 * gear.root_radius * jnp.sin(root)
        if fillet is not None:  # Sainsot et al. count along the root circle
            foot, thick = gear.root_radius, 2 * gear.root_radius * root
        sign = -1.0 if gear.internal else 1.0
        lever = (sign * (height - foot) - half * jnp.tan(slant)) / thick
        if gear.internal:
            nu = self.poissons_ratio
            turned = 18 / math.pi * lever**2 + 2 * (1 - 2 * nu) / (1 - nu) * lever
            return jnp.cos(slant) ** 2 * (turned + 4.8 / math.pi * (1 + (1 - nu) / 2.4 * jnp.tan(slant) ** 2))
        hollow = UNTOLD if bore is None else jnp.minimum(2 * gear.root_radius / bore, MOST_SOLID)
        of = [
            a / root**2 + b * hollow**2 + c * hollow / root + d / root + e * hollow + f
            for a, b, c, d, e, f in SAINSOT.tolist()
        ]
        bent = of[0] * lever**2 + of[1] * lever + of[2] * (1 + of[3] * jnp.tan(slant) ** 2)
        return jnp.cos(slant) ** 2 * bent

    def _coupled(self, slices: Slices, body: Array, pressed: Scalar) -> Faces:
        """Influence of the slices of each pair of teeth on each other.

        A slice that is partly on the path of contact is loaded there alone.
        """
        assert self.coupling_length is not None  # only coupled slices come here
        width, reach = slices.pair.face_width, self.coupling_length * slices.pair.normal_module
        share = jnp.maximum(slices.share, LEAST_SHARE)
        along = partial(factors_along, width=width, reach=reach)
        own, low, high = once(*jax.vmap(jax.vmap(along))(slices.across, share))
        body, root = once(body, jnp.sqrt(body))
        number = share.shape[-1]
        parts = once(body * own + pressed / share, root * low, root * high)
        own, low, high = (part.reshape(-1, number) for part in parts)
        return Faces(own, low, high, fall=jnp.broadcast_to(width / number / reach, share[..., 0].shape).ravel())

    def _hertz(self, slices: Slices, body: Array, normal: Scalar, width: Scalar) -> LineSprings:
        """Springs with the approach ``slope F (level - ln F)`` of Hertzian contact, tooth and foundation together.

        Tooth and foundation are linear in F and only add to ``level``.
        """
        depth = 1.0
        for gear, roll in zip(slices.pair.gears, slices.roll, strict=True):
            _, half, slant = gear.section(gear.radius_at(roll / gear.base_radius))
            depth = depth * half / jnp.cos(slant)
        line = width * jnp.maximum(slices.share, LEAST_SHARE)
        nu, modulus = self.poissons_ratio, self.line_contact.plane_modulus
        # forces and widths are those of the transverse section; the normal forces are larger by 1 / cos beta_b
        cosine = jnp.sqrt(normal)
        curvature = slices.curvature / cosine
        level = jnp.log(0.5 * math.pi * modulus * depth * curvature * line / cosine) - nu / (1 - nu)
        slope = normal * 2 / (math.pi * modulus * line)
        level = level + body / line / slope
        return LineSprings(slope.ravel(), level.ravel())


def _energy(
    gear: InvoluteGear,
    foot: Scalar,
    ends: tuple[Array, Array],
    force: tuple[Array, Array, Array],
    rigidity: Scalar,
) -> Array:
    """Deflection by bending, shear and compression of a part of a tooth, times ``E'``, per force per width [-].

    Args:
        gear: the gear in the transverse section.
        foot: distance of the root section from the gear's axis [m].
        ends: heights of both ends of the part above the root [m].
        force: height of the force above the root, its distance from the middle of the tooth [m], and its inclination
            [rad].
        rigidity: ``E' / G`` [-].
    """
    arm, half, slant = force
    nodes, weights = _gauss(arm.ndim, arm.dtype)
    step = 0.5 * (ends[1] - ends[0])[..., None]
    level = ends[0][..., None] + step * (1 + nodes)
    thick = 2 * gear.half_thickness(foot - level if gear.internal else foot + level)
    at = arm[..., None] - level, half[..., None], slant[..., None]
    return (_bent(thick, at, rigidity) * step * weights).sum(axis=-1)


def _bent(thick: Array, force: tuple[Array, Array, Array], rigidity: Scalar) -> Array:
    """Deflection of a section per height, times ``E'``, per force per width [1/m].

    Args:
        thick: thickness of the tooth there [m].
        force: height of the force above the section, its distance from the middle of the tooth [m], and its inclination
            [rad].
        rigidity: ``E' / G`` [-].
    """
    above, half, slant = force
    across, along = jnp.cos(slant), jnp.sin(slant)
    moment = across * above - along * half
    return 12 * moment**2 / thick**3 + (SHEAR * rigidity * across**2 + along**2) / thick


def _gauss(axes: int, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Nodes and weights of Gauss' quadrature from -1 to 1 on a last axis behind some others."""
    shape = (*[1] * axes, NODES)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return jnp.asarray(nodes, dtype).reshape(shape), jnp.asarray(weights, dtype).reshape(shape)


def _middle_and_half(slices: Slices) -> tuple[Scalar, Scalar]:
    """Middle of the path of contact and half of its length, as lengths of roll of the pinion [m]."""
    path = slices.pair.contact_path
    return 0.5 * (path.begin + path.end), 0.5 * (path.end - path.begin)


def _series(factors: Float[Array, " place"], x: Array) -> Array:
    """Sum of Chebyshev polynomials of x, which is from -1 to 1, by Clenshaw's recurrence."""
    after, later = jnp.zeros_like(x), jnp.zeros_like(x)
    for i in range(len(PLACES) - 1, 0, -1):
        after, later = 2 * x * after - later + factors[i], after
    return x * after - later + factors[0]


def _root_angle(gear: InvoluteGear) -> Scalar:
    """Half of the angle of a tooth at its root circle [rad]; flanks below the base circle are radial."""
    return gear.half_angle(jnp.maximum(gear.root_radius, gear.first_radius))


def _foot(gear: InvoluteGear) -> Scalar:
    """Distance of the root section from the gear's axis [m]."""
    return gear.root_radius * jnp.cos(_root_angle(gear))
