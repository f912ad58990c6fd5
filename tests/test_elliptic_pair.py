"""Elliptic and other non-circular pairs: transmission error by exact geometry, forces, energy, motion, gradients."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import gearjax as gj
from gearjax.units import arcmin, um
from tests.elliptic import ALPHA, MODULE, TEETH, E, Ellipses

OWN = Ellipses()
THETA = np.linspace(0.0, 2 * math.pi, 33)
DRIVER, DRIVEN = (0.3, 1.1)  # phases


def pair(**changes) -> gj.EllipticPair:
    given = {"teeth": TEETH, "module": MODULE, "eccentricity": E, "input_speed": 20.0} | changes
    return gj.EllipticPair(**given)


def scene(amplitudes=(30 * um, 20 * um), system=None, **slots) -> gj.Scene:
    names = ("driver", "driven")
    errors = {
        name: gj.Eccentricity(name, amplitude, phase)
        for name, amplitude, phase in zip(names, amplitudes, (DRIVER, DRIVEN), strict=True)
    }
    return gj.Scene(pair(**(system or {})), errors, **slots)


MOVING = {
    "backlash": gj.InitialBacklash(60 * um),
    "compliance": gj.HarmonicStiffness(3e8, [0.15], [0.2]),
    "inertia": gj.MomentOfInertia(0.01),
    "damping": gj.DampingRatio(0.05, "always"),
    "load": gj.ConstantLoad(),
}


class TestExactly:
    @pytest.mark.slow
    @pytest.mark.parametrize(("size", "bound"), [(50 * um, 1e-11), (3e-3, 2e-8)])
    def test_both_flanks_against_three_unknowns(self, size, bound):
        """Bounds in arcmin, of errors of 7 and 400 arcmin."""
        system = {"clearance": "exact", "centre_distance_error": size / 2}
        play = gj.backlash(scene((size, 0.7 * size), system, backlash=gj.InitialBacklash(0.0)), THETA)
        errors = (size, DRIVER), (0.7 * size, DRIVEN), size / 2
        for edge, side in ((play.lower, 1), (play.upper, -1)):
            wanted = [OWN.exact(t, *errors, side=side) for t in THETA]
            np.testing.assert_allclose(edge, wanted, atol=bound * arcmin)

    @pytest.mark.slow
    @pytest.mark.parametrize("size", [30 * um, 500 * um])
    def test_generated_teeth_rolled_together(self, size):
        """Flanks as curves of points, from tip to tip: the driven gear is turned until they touch."""
        te = gj.transmission_error(scene((size, size), {"clearance": "exact"}), THETA[3:20:4]).te
        wanted = [rolled(t, (size, DRIVER), (size, DRIVEN)) for t in THETA[3:20:4]]
        np.testing.assert_allclose(te, wanted, atol=1e-6 * arcmin)

    @pytest.mark.slow
    def test_ideal_teeth_have_no_error(self):
        assert np.abs([rolled(t, (0.0, 0.0), (0.0, 0.0)) for t in THETA[1:30:7]]).max() < 1e-8 * arcmin
        for clearance in ("linear", "exact"):
            ideal = gj.Scene(pair(clearance=clearance))
            assert float(jnp.abs(gj.transmission_error(ideal, THETA).te).max()) < 1e-15

    @pytest.mark.slow
    @pytest.mark.parametrize(("e", "bound"), [(0.2, 2e-3), (E, 2e-3), (0.7, 3e-3)])
    def test_first_order(self, e, bound):
        """``q = (e1 sin(t1 + p1 + a) + e2 sin(t2 + p2 - a) - dc sin a) / (r2 cos a)``, near the exact one."""
        own, size = Ellipses(e), 50 * um
        system = {"eccentricity": e, "centre_distance_error": 10 * um}
        linear, exact = (
            gj.transmission_error(scene((size, size), system | {"clearance": clearance}), THETA)
            for clearance in ("linear", "exact")
        )
        slant = ALPHA + own.psi(THETA)
        gap = size * np.sin(THETA + DRIVER + slant) + size * np.sin(own.t2(THETA) + DRIVEN - slant)
        wanted = (gap - 10 * um * np.sin(slant)) / (own.r2(THETA) * np.cos(slant))
        np.testing.assert_allclose(linear.te, wanted, atol=1e-15)
        largest = float(jnp.abs(exact.te).max())
        assert 1e-5 < float(jnp.abs(linear.te - exact.te).max()) / largest < bound

    @pytest.mark.slow
    def test_ratio_error(self):
        """It is the derivative of the transmission error, and zero on the mean: both gears are back after a turn."""
        theta = np.linspace(0.0, 2 * math.pi, 257)
        for clearance in ("linear", "exact"):
            gears = scene((50 * um, 50 * um), {"clearance": clearance})
            ratio, te = gj.ratio_error(gears, theta), gj.transmission_error(gears, theta).te
            assert abs(float(ratio.error[:-1].mean())) < 1e-12
            np.testing.assert_allclose(ratio.ideal, OWN.ratio(theta), rtol=1e-12)
            # derivative of the trigonometric polynomial through the samples
            lines = np.fft.rfft(np.asarray(te[:-1]))
            slope = np.fft.irfft(1j * np.arange(len(lines)) * lines, 256)
            np.testing.assert_allclose(ratio.error[:-1], slope, atol=1e-10 * float(ratio.peak_to_peak) + 1e-13)

    @pytest.mark.slow
    @pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
    def test_studies_take_exact_geometry(self):
        """Populations and grids are quick where contacts touch to first order; here they are not."""
        gears = scene((500 * um, 400 * um), {"clearance": "exact"}, **MOVING)
        theta = np.linspace(0.0, 2 * math.pi, 61)
        population = gj.Tolerances(gears, {"errors.driver.phase": gj.Discrete((DRIVER, DRIVER + 1.0), (0.5, 0.5))})
        measures = ["no_load.peak_to_peak", "static.peak_to_peak@15Nm"]
        study = gj.monte_carlo(population, measures, n=4, theta=theta, extremes="samples", sampler="monte_carlo")
        known = {}
        for phase in (DRIVER, DRIVER + 1.0):
            turned = {**gears.errors, "driver": gj.Eccentricity("driver", 500 * um, phase)}
            own = dataclasses.replace(gears, errors=turned)
            swings = [
                float(jnp.ptp(gj.transmission_error(own, theta, torque, extremes="samples").te))
                for torque in (None, 15.0)
            ]
            known[phase] = swings
        for row in np.asarray(study.values):
            assert min(np.abs(row / np.array(swings) - 1).max() for swings in known.values()) < 1e-9
        where = ["errors.driver.phase", "errors.driven.phase"]
        grid = gj.grid_search("no_load_peak_to_peak", gears, where=where, step=math.pi / 2, theta=theta)
        values = {}
        for one in (0.0, 90.0, 180.0, 270.0):
            for other in (0.0, 90.0, 180.0, 270.0):
                errors = {
                    "driver": gj.Eccentricity("driver", 500 * um, math.radians(one)),
                    "driven": gj.Eccentricity("driven", 400 * um, math.radians(other)),
                }
                own = dataclasses.replace(gears, errors=errors)
                values[one, other] = float(gj.transmission_error(own, theta).peak_to_peak)
        assert float(grid.objective) == pytest.approx(min(values.values()), rel=1e-6)

    @pytest.mark.slow
    def test_first_order_of_the_ratio(self):
        theta = np.linspace(0.0, 2 * math.pi, 257)
        linear, exact = (
            gj.ratio_error(scene((50 * um, 50 * um), {"clearance": clearance}), theta).error
            for clearance in ("linear", "exact")
        )
        assert float(jnp.abs(linear - exact).max() / jnp.abs(exact).max()) < 2e-3


def rolled(t: float, driver: tuple[float, float], driven: tuple[float, float]) -> float:
    """Transmission error of teeth that are curves of points: at each distance from the driven gear's own axis, how far
    it has to turn until its flank is at the driver's; the most of it, of all teeth near contact."""
    (e1, p1), (e2, p2) = driver, driven
    at_pitch = float(OWN.arc(t))
    turned, ideal = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]), float(OWN.t2(t))
    # the driven gear turns about its axis, which stands still; its teeth are about a centre that goes round with it
    axis = np.array([2 * OWN.a, 0.0])
    least = []
    for tooth in range(-1, 3):
        crossing = (round(at_pitch / (math.pi * MODULE)) + tooth - 1) * math.pi * MODULE
        inside = np.interp(crossing, OWN.arc(np.linspace(-1, 8, 4000)), np.linspace(-1, 8, 4000))
        spread = inside + np.linspace(-0.16, 0.16, 2401)
        one, other = OWN.flank(0, 1, spread, crossing), OWN.flank(1, 1, spread, crossing)
        one, other = (shape[:, _within(shape, gear, inside)] for gear, shape in ((0, one), (1, other)))
        place = turned @ (one + e1 * np.array([[math.cos(p1)], [math.sin(p1)]])) - axis[:, None]
        own = other + e2 * np.array([[math.cos(p2)], [-math.sin(p2)]])
        curve = CubicSpline(*_rising(np.hypot(*own), np.arctan2(own[1], -own[0])))
        far, angle = np.hypot(*place), np.arctan2(place[1], -place[0])
        met = (far > curve.x[0]) & (far < curve.x[-1])
        if met.sum() > 20:
            # clockwise turn of the driven gear, which raises its flank in these axes
            turns = angle[met] - curve(far[met])
            best = int(np.argmax(turns))
            if 2 < best < len(turns) - 3:
                around = slice(best - 3, best + 4)
                coefficients = np.polyfit(np.arange(-3, 4), turns[around], 4)
                top = np.roots(np.polyder(coefficients))
                top = top[np.isreal(top)].real
                top = top[np.argmin(np.abs(top))]
                least.append(float(np.polyval(coefficients, top)))
    off = max(least) - ideal
    return off - 2 * math.pi * round(off / (2 * math.pi))


def _within(shape: np.ndarray, gear: int, inside: float) -> np.ndarray:
    """Points of a flank between heights of 1.0 modules above and 0.9 below the pitch curve, to first order."""
    radius = (OWN.r1 if gear == 0 else OWN.r2)(inside)
    slope = math.cos(float(OWN.psi(inside)))
    height = (np.hypot(*shape) - radius) * slope
    return (height < 1.3 * MODULE) & (height > -1.2 * MODULE)


def _rising(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(x)
    return x[order], y[order]


class TestForces:
    @pytest.mark.slow
    def test_a_circular_pair_is_a_spur_pair(self):
        """Without eccentricity of the pitch curve all is as of another system's spur gears, levers and run-outs."""
        slots = MOVING | {"damping": gj.DampingRatio(0.05)}
        own = scene(system={"eccentricity": 0.0, "centre_distance_error": None}, **slots)
        spur = gj.HelicalPair(TEETH, TEETH, MODULE, 20 * gj.units.deg, 0.0, 0.02, 20.0, slices=1, pairs=2)
        names = {"driver": "pinion", "driven": "wheel"}
        errors = {name: dataclasses.replace(own.errors[name], body=body) for name, body in names.items()}
        wheel = errors["driven"]  # whose phase is counted from the other side of its axis
        errors["driven"] = dataclasses.replace(wheel, phase=wheel.phase + math.pi)
        other = dataclasses.replace(own, system=spur, errors=errors)
        for function in (gj.transmission_error, gj.backlash):
            one, two = function(own, THETA), function(other, THETA)
            for name in ("te",) if function is gj.transmission_error else ("lower", "upper"):
                np.testing.assert_allclose(getattr(one, name), getattr(two, name), atol=1e-12 * 3e-4)

    @pytest.mark.slow
    @pytest.mark.parametrize("torque", [15.0, -15.0])
    @pytest.mark.parametrize(("clearance", "size"), [("linear", 0.0), ("exact", 300 * um)])
    def test_virtual_work(self, clearance, size, torque):
        """A lever is the change of the true distance with the output at a held input: with it the force takes the
        torque. At a held output the same force takes from the input what the output gets."""
        moving = MOVING | {"backlash": gj.InitialBacklash(600 * um)}
        gears = scene((size, size), {"clearance": clearance}, **moving)
        te = gj.transmission_error(gears, THETA, torque)
        assert int(te.result.max()) == 0
        side = 1 if torque > 0 else -1
        forces = np.asarray(te.forces)
        assert (forces[:, 0 if side > 0 else 1] > 0).all()
        assert (forces[:, 1 if side > 0 else 0] == 0).all()
        errors, step = ((size, DRIVER), (size, DRIVEN)), 1e-5
        for place in (2, 9, 17, 28):
            t, force = THETA[place], forces[place].max()
            # to first order levers are those of the ideal position
            at = OWN.t2(t) + (float(te.te[place]) if clearance == "exact" else 0.0)

            def apart(t: float, angle: float) -> float:
                return OWN.distance(t, angle, *errors, side=side)

            lever = (apart(t, at + step) - apart(t, at - step)) / (2 * step)
            assert force * lever == pytest.approx(torque, rel=1e-8)
            if clearance == "exact":  # the overlap is what the force presses the springs by
                overlap = -apart(t, at) - (0.0 if side > 0 else 600 * um)
                assert force == pytest.approx(3e8 * overlap, rel=1e-6)
            else:
                taken = (apart(t + step, at) - apart(t - step, at)) / (2 * step)
                assert -force * taken == pytest.approx(torque * OWN.ratio(t), rel=1e-8)

    @pytest.mark.slow
    def test_a_support_gives_way(self):
        """The overlap is shared with the bearings: ``q = q0 - T / J^2 (1 / k + sum J_s^2 / k_s)``."""
        gears = scene(**MOVING)
        soft = dataclasses.replace(gears, supports={"driver": gj.Support(x=1e8, y=2e8), "driven": gj.Support(y=3e8)})
        free = gj.transmission_error(gears, THETA).te
        found = gj.transmission_error(soft, THETA, 15.0)
        te = found.te
        slant = ALPHA + OWN.psi(THETA)
        lever = OWN.r2(THETA) * np.cos(slant)
        gives = 1 / 3e8 + np.sin(slant) ** 2 / 1e8 + np.cos(slant) ** 2 * (1 / 2e8 + 1 / 3e8)
        np.testing.assert_allclose(te, free - 15.0 / lever**2 * gives, atol=1e-14)
        # the force pushes the gears apart, the driver back and the driven gear ahead
        force = 15.0 / lever
        assert found.coordinates == ("output", "driven.y", "driver.x", "driver.y")
        moved = force * np.cos(slant) / 3e8, -force * np.sin(slant) / 1e8, -force * np.cos(slant) / 2e8
        np.testing.assert_allclose(found.moved, np.stack(moved, axis=1), rtol=1e-9)
