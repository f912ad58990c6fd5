"""The oscillator with clearance and a stiffness that alternates, alone and behind twelve coordinates.

    x'' + 2 zeta x' + (1 + kappa cos W t) g(x) = F,     g(x) = x for x > 0, 0 for -b < x < 0, x + b below

in time per natural frequency; b is out of reach. Numbers of an independent program for zeta = 0.05, kappa = 0.2, F = 1:
folds at W = 0.8344 and 0.9069, peak of the alternating part 1.477 at 0.837, 1.44290291 at 0.85 on the high branch.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import Layout
from gearjax.parameters import angle, check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar
from gearjax.units import ANGULAR_SPEED, deg, mm

STIFFNESS, MOMENT, ARM, TORQUE = 2e8, 4e-3, 40 * mm, 20.0
RATE = math.sqrt(STIFFNESS * ARM**2 / MOMENT)  # natural frequency with the teeth closed [rad/s]
STATIC = TORQUE / (STIFFNESS * ARM**2)  # [rad]
TEETH, ZETA, KAPPA = 20, 0.05, 0.2
WAYS = ("x", "y", "z", "rx", "ry", "rz")
BASE = {"pinion": 25 * mm, "wheel": ARM}


class TwistedPair(AbstractSystem):
    """One pair of helical teeth whose wheels may move in all directions: a line of action, and its moments."""

    kind: ClassVar[str] = "twisted_pair"
    teeth: int = count(default=TEETH)
    arm: Number = length(above=0.0, default=ARM)
    helix_angle: Number = angle(default=9 * deg)
    pressure_angle: Number = angle(default=20 * deg)
    input_speed: Number = number(ANGULAR_SPEED, above=0.0, default=100.0)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("pinion", "wheel")

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {"pinion": WAYS, "wheel": WAYS[:5]}

    @property
    def orders(self) -> Mapping[str, float]:
        return {"output": 0.625, "mesh": float(self.teeth)}

    @property
    def cycle(self) -> float:
        return 2 * math.pi

    def layout(self, request: gj.Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: gj.Request) -> gj.Pose:
        layout = self.layout(request)
        columns = [-jnp.asarray(layout.side, theta.dtype) * self.arm]
        columns += [self._column(*name.split("."), layout) for name in request.coordinates]
        mesh = (self.teeth * theta)[None] if request.mesh else None
        return gj.Pose(theta, jnp.stack(columns, axis=1), jnp.zeros((len(layout.side),), theta.dtype), {}, mesh)

    def _column(self, body: str, way: str, layout: Layout) -> Float[Array, " contact"]:
        """Along the normal, and its moment about the centre, the contact on the base circle."""
        side = jnp.asarray(layout.side, self.arm.dtype)
        sine, cosine = jnp.sin(self.pressure_angle), jnp.cos(self.pressure_angle)
        along, across = jnp.cos(self.helix_angle), jnp.sin(self.helix_angle)
        sign = 1.0 if body == "pinion" else -1.0
        radius = BASE[body]
        ways = {
            "x": sine * along + 0 * side,
            "y": side * cosine * along,
            "z": -side * across,
            "rx": side * radius * sine * across,
            "ry": radius * cosine * across + 0 * side,
            "rz": side * radius,
        }
        return sign * ways[way]


def oscillator(stiff: float | None, ratio: float, zeta: float = ZETA, kappa: float = KAPPA) -> gj.Scene:
    """The oscillator at a mesh frequency over the natural one; eleven more coordinates with supports, or none."""
    own = TwistedPair(input_speed=ratio * RATE / TEETH)
    given = {
        "compliance": gj.HarmonicStiffness(STIFFNESS, [kappa], [0.0]),
        "backlash": gj.InitialBacklash(1000 * STATIC * ARM),
        "load": gj.ConstantLoad(),
        "inertia": gj.MomentOfInertia(MOMENT),
        "damping": gj.DampingRatio(math.sqrt(2) * zeta, "always"),
    }
    if stiff is None:
        return gj.Scene(own, **given)
    turning = stiff * 1e-3  # the same about the axes, on arms of some centimetres
    whole = {"x": stiff, "y": stiff, "z": stiff, "rx": turning, "ry": turning}
    whole |= {f"{way}_damping": size * 1e-7 for way, size in whole.items()}
    supports = {"pinion": gj.Support(**whole, rz=turning, rz_damping=turning * 1e-7), "wheel": gj.Support(**whole)}
    inertia = {"pinion": gj.BodyInertia(0.5, 2e-4, 2e-4), "wheel": gj.BodyInertia(1.5, transverse=2e-3)}
    return gj.Scene(own, supports=supports, body_inertia=inertia, **given)


def period(ratio: float) -> float:
    return 2 * math.pi / (ratio * RATE)


COORDINATES = {"alone": None, "twelve": 1e15}


def test_twelve_coordinates():
    assert len(oscillator(1e15, 0.85).coordinates) == 12
    assert len(oscillator(None, 0.85).coordinates) == 1


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("body", ["pinion", "wheel"])
def test_each_direction_adds_its_spring(body, way):
    """Under a static torque: force times the square of its arm along the motion, over the stiffness, in series."""
    if (body, way) == ("wheel", "rz"):
        with pytest.raises(gj.ParameterError, match=r"supports\.wheel\.rz"):
            gj.Scene(TwistedPair(), supports={body: gj.Support(rz=1e6)})
        return
    rigid = oscillator(None, 0.5)
    stiffness, theta = 1e6, np.array([0.2, 1.9])
    soft = dataclasses.replace(rigid, supports={body: gj.Support(**{way: stiffness})})
    force, radius = TORQUE / ARM, BASE[body]
    sine, cosine = (f(math.radians(20)) for f in (math.sin, math.cos))
    along, across = math.cos(math.radians(9)), math.sin(math.radians(9))
    normal = np.array([sine * along, cosine * along, -across])  # at the point of the base circle that it touches
    place = np.array([-cosine, sine, 0.0]) * radius
    if way.startswith("r") and way != "rz":
        moment = np.cross(place, normal)
        arm = {"rx": radius * sine * across, "ry": radius * cosine * across}[way]
        assert abs(moment["xyz".index(way[1])]) == pytest.approx(arm, rel=1e-12)
    else:
        arm = radius if way == "rz" else normal["xyz".index(way)]
    te = gj.transmission_error(soft, theta, TORQUE)
    added = te.te - gj.transmission_error(rigid, theta, TORQUE).te
    np.testing.assert_allclose(added, -force * arm**2 / stiffness / ARM, rtol=1e-9)
    np.testing.assert_allclose(abs(te.moved[:, 0]), abs(force * arm / stiffness), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", COORDINATES)
def test_the_high_branch(name):
    """Shooting and harmonic balance at W = 0.85; multipliers whose product is exp(-4 pi zeta / W)."""
    scene, time = oscillator(COORDINATES[name], 0.85), period(0.85)
    down = gj.speed_sweep(scene, TORQUE, np.array([0.95, 0.9, 0.87, 0.85]) * RATE / TEETH, periods=200, steps=256)
    found = gj.shooting(scene, TORQUE, time, steps=4096, guess=down.ends[-1])
    assert int(found.result) == 0
    assert bool(found.stable)
    assert float(found.std) / STATIC == pytest.approx(1.442903, rel=1e-5)
    assert float(found.te.min()) / STATIC < -1.5
    assert float(found.te.max()) > 0, "teeth part"
    if name == "alone":
        product = float(jnp.prod(found.multipliers).real)
        assert product == pytest.approx(math.exp(-4 * math.pi * ZETA / 0.85), rel=1e-5)
        np.testing.assert_allclose(abs(found.multipliers), 0.6910, rtol=1e-3)
    guess = found.te if name == "alone" else found.q
    balance = gj.harmonic_balance(scene, TORQUE, time, harmonics=32, samples=1024, guess=guess)
    assert int(balance.result) == 0
    assert float(balance.std) / STATIC == pytest.approx(1.442903, rel=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", COORDINATES)
def test_jumps_of_sweeps(name):
    """Down between 0.84 and 0.83, up between 0.90 and 0.91; the peak before the jump."""
    ratios = np.arange(80, 96) / 100
    scene = oscillator(COORDINATES[name], 0.85)
    up, down = (
        gj.speed_sweep(scene, TORQUE, order * RATE / TEETH, periods=150, steps=128) for order in (ratios, ratios[::-1])
    )
    rising, falling = np.asarray(up.std) / STATIC, np.asarray(down.std)[::-1] / STATIC
    assert ratios[np.argmax(np.diff(rising))] == pytest.approx(0.90)
    assert ratios[np.argmax(np.diff(falling))] == pytest.approx(0.83)
    assert falling.max() == pytest.approx(1.475, abs=5e-3)
    apart = (ratios > 0.835) & (ratios < 0.905)
    assert (falling[apart] > 1.4 * rising[apart]).all()
    np.testing.assert_allclose(falling[~apart], rising[~apart], rtol=2e-3)


@pytest.mark.slow
def test_supports_of_finite_stiffness_shift_it_in_proportion():
    """Twelve coordinates tend to one; what is left falls with the compliance of the supports."""
    exact = gj.shooting(oscillator(None, 1.3), TORQUE, period(1.3), steps=512).std
    off = []
    for stiff in (1e12, 1e13):
        found = gj.shooting(oscillator(stiff, 1.3), TORQUE, period(1.3), steps=512)
        assert int(found.result) == 0
        off.append(float(abs(found.std / exact - 1)))
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.1)
    assert off[1] < 1e-3


@pytest.mark.slow
def test_the_receptance_leaves_contacts_alone():
    """Harmonic balance of twelve coordinates searches for the two flanks only: the solver's matrix has their size."""

    def sizes(scene: gj.Scene) -> set[int]:
        from tests.test_batches import jaxprs_in_params

        def of(jaxpr) -> set[int]:
            shapes = {var.aval.shape for eqn in jaxpr.eqns for var in eqn.outvars if hasattr(var.aval, "shape")}
            found = {shape[0] for shape in shapes if len(shape) == 2 and shape[0] == shape[1]}
            for eqn in jaxpr.eqns:
                for inner in jaxprs_in_params(eqn.params):
                    found |= of(getattr(inner, "jaxpr", inner))
            return found

        balance = jax.make_jaxpr(lambda torque: gj.harmonic_balance(scene, torque, period(0.9), harmonics=16).te)
        return of(balance(TORQUE).jaxpr)

    assert 2 * 33 in sizes(oscillator(1e15, 0.9))
    assert 12 * 33 not in sizes(oscillator(1e15, 0.9))
