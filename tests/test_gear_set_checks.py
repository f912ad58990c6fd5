"""What gear sets and errors of one's own return is checked, and waves that no order names are found."""

import dataclasses
import math
import warnings
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax import units
from gearjax.contact import BodyView, Layout, Pose
from gearjax.parameters import check_parameters, count, length, name, number
from gearjax.typing import Number
from gearjax.units import um


class Waves(gj.AbstractError):
    """A body whose flanks are out by a cosine."""

    kind: ClassVar[str] = "waves"
    body: str = name()
    size: Number = length(at_least=0.0)
    lobes: int = count(default=1)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view):
        return view.influence * self.size * jnp.cos(self.lobes * view.angle)


class Rack(gj.AbstractSystem):
    """Pinion and rack: three pairs one base pitch apart, whose profiles are crowned."""

    kind: ClassVar[str] = "rack"
    teeth: int = count()
    crown: Number = length(at_least=0.0)
    input_speed: Number = number(units.ANGULAR_SPEED, above=0.0)
    names_teeth: bool = eqx.field(static=True, default=True)
    fault: str = eqx.field(static=True, default="")

    @property
    def bodies(self):
        return ("pinion",)

    @property
    def orders(self):
        named = {"output": 1.0, "mesh": float(self.teeth)} | ({"tooth": float(self.teeth)} if self.names_teeth else {})
        return {key: order for key, order in named.items() if self.fault != f"no {key}"}

    @property
    def cycle(self):
        return 2 * math.pi * 3 / math.gcd(self.teeth, 3)

    def layout(self, request):
        return Layout.of_flanks(3, request.back)

    def pose(self, theta, request):
        layout = self.layout(request)
        side, pair = (jnp.asarray(part, theta.dtype) for part in (layout.side, layout.pair))
        passed = (self.teeth * theta / (2 * jnp.pi) - pair) / 3
        gap = self.crown * (3 * (passed - jnp.round(passed))) ** 2
        lever = -side[:, None] * 0.9
        views = {body: BodyView(theta, 0.35 * side, -side) for body in request.bodies}
        mesh = self.teeth * theta - 2 * jnp.pi * jnp.arange(3, dtype=theta.dtype) if request.mesh else None
        right = Pose(theta, lever, gap, views, mesh)
        faults = {  # put in afterwards, as tests check what a pose is made of
            "gap": lambda: eqx.tree_at(lambda pose: pose.gap, right, gap[:1]),
            "flat": lambda: eqx.tree_at(lambda pose: pose.jacobian, right, lever[:, 0]),
            "rows": lambda: eqx.tree_at(lambda pose: pose.jacobian, right, lever[:2]),
            "sign": lambda: Pose(theta, -lever, gap, views, mesh),
            "views": lambda: Pose(theta, lever, gap, {}, mesh),
            "mesh": lambda: Pose(theta, lever, gap, views, jnp.zeros(6, theta.dtype)),
        }
        return faults.get(self.fault, lambda: right)()


def rack(size: float = 10 * um, lobes: int = 1, backlash: bool = True, **changed) -> gj.Scene:
    given = {"teeth": 20, "crown": 4 * um, "input_speed": 30.0} | changed
    back = gj.InitialBacklash(50 * um) if backlash else None
    return gj.Scene(Rack(**given), {"mine": Waves("pinion", size, lobes)}, backlash=back)


@pytest.mark.slow
def test_named_orders_give_no_warning():
    for lobes in (1, 7, 20):
        rack(lobes=lobes)


@pytest.mark.parametrize("changed", [{"crown": 4 * um}, {"crown": 0.0, "lobes": 20}], ids=["teeth", "error"])
def test_waves_that_no_order_names_are_told(changed):
    with pytest.warns(
        gj.UnnamedOrder, match=r"rack have waves that are far faster than its fastest order \(1 cycles"
    ) as told:
        rack(names_teeth=False, **changed)
    assert told[0].filename == __file__  # the line of the caller


def test_what_was_zero_is_looked_at_again():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quiet = rack(names_teeth=False, crown=0.0, lobes=21, size=0.0)
    with pytest.warns(gj.UnnamedOrder):
        dataclasses.replace(quiet, errors={"mine": Waves("pinion", 1 * um, 21)})


@pytest.mark.slow
def test_the_warned_motion_is_wrong_and_the_named_one_right():
    """Why it is told: with the order unnamed, fixed steps miss teeth by parts of the swing."""
    parts = {
        "compliance": gj.HarmonicStiffness(2e8, jnp.zeros(0), jnp.zeros(0)),
        "inertia": gj.EquivalentMass(2.0),
        "damping": gj.DampingRatio(0.1),
        "load": gj.ConstantLoad(),
    }
    ts, swings = jnp.linspace(0.0, 0.1, 501), {}
    for named in (True, False):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", gj.UnnamedOrder)
            scene = dataclasses.replace(rack(names_teeth=named), **parts)
        motion = gj.simulate(scene, ts, 3000.0)
        truth = gj.simulate(scene, ts, 3000.0, stepper=gj.AdaptiveStep(1e-9, 1e-9))
        swings[named] = float(jnp.abs(motion.te - truth.te).max() / truth.peak_to_peak)
    assert swings[True] < 5e-3
    assert swings[False] > 0.03


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("no mesh", 'rack: orders must name "mesh"'),
        ("no output", 'rack: orders must name "output"'),
        ("gap", r"rack: gap of its pose has shape \(1,\); must be \(6,\), a gap for each contact of its layout"),
        ("flat", r"rack: the jacobian of its pose has shape \(6,\); must be \(6, 1\) or more columns"),
        ("rows", r"rack: the jacobian of its pose has shape \(2, 1\); must be \(6, 1\)"),
        ("sign", "rack: contact 0 is on a driving flank and has the lever 0.9 m/rad .* of driving flanks are negative"),
        ("views", 'rack: its pose has no view of "pinion", which carries an error'),
        ("mesh", r"rack: mesh_angle of its pose has shape \(6,\); must be \(3,\), a phase for each pair"),
    ],
)
def test_faults_of_a_pose_are_one_line(fault, words):
    with pytest.raises(gj.SceneError, match=words) as caught:
        rack(fault=fault)
    assert "\n" not in str(caught.value)


def test_traced_numbers_are_checked_for_shapes_only():
    """No look at values is possible inside a jitted function, and none is compiled into it."""

    def swing(size):
        return gj.transmission_error(rack(size=size, teeth=22, lobes=3), np.linspace(0.0, 0.3, 31)).std

    assert float(jax.jit(jax.grad(swing))(8 * um)) > 0
    with pytest.raises(gj.SceneError, match="gap of its pose"):
        jax.jit(lambda size: rack(size=size, fault="gap", teeth=23).errors["mine"].size)(8 * um)
