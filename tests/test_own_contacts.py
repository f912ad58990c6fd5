"""Errors of one of several like bodies, such as one of two discs, are seen by the contacts of that body alone."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import arcmin, deg, mm, um

TRAIN = gj.HelicalTrain([20, 18], [50, 54], [2 * mm, 3 * mm], [20 * deg], [0.0], [22 * mm, 34 * mm], 300.0, slices=1)
RV = gj.RVCycloidal(16, 60 * mm, 5 * mm, 2 * mm, 0.0, -10 * um, 90.0, discs=2)
THETA = np.linspace(0.01, 0.4, 4)


def involute(gears: int, **changes) -> gj.InvoluteRV:
    """The pair of Yang, Tang and Liang (2019) with other gears around the same ring, and little clearance."""
    sizes = {"external_shift": -0.4, "internal_shift": 0.55028, "external_addendum": 0.6328, "internal_addendum": 1.0}
    own = {"module": 0.58 * mm, "pressure_angle": 20 * deg, "centre_distance": 1.49 * mm, "input_speed": 90.0}
    points = {"pairs": 9, "profile_points": 5}
    return gj.InvoluteRV(external_teeth=236, internal_teeth=240, gears=gears, **sizes, **own, **points, **changes)


SYSTEMS = {"rv": RV, "rv, exact": dataclasses.replace(RV, clearance="exact"), "gears": involute(3), "train": TRAIN}


def errors_of(body: str) -> dict[str, gj.AbstractError]:
    """An error of each kind that acts on single teeth, lobes or flanks."""
    return {
        "sizes": gj.Sizes(body, [5 * um]),
        "outward": gj.Positions(body, [5 * um], []),
        "around": gj.Positions(body, [], [5 * um]),
        "pitch": gj.CumulativePitch(body, 5 * um, 0.3),
        "tip": gj.TipRelief(body, [5 * um], 1 * mm),
        "root": gj.RootRelief(body, [5 * um], 1 * mm),
        "slope": gj.ProfileSlope(body, [5 * um]),
        "form": gj.ProfileForm(body, [3 * um]),
        "helix": gj.HelixSlope(body, [5 * um]),
        "crowning": gj.Crowning(body, [5 * um]),
        "end": gj.EndRelief(body, [5 * um], 5 * mm),
        "measured": gj.MeasuredFlank(body, [5 * mm, 60 * mm], [2 * um, 3 * um]),
        "measured_pitch": gj.MeasuredPitch(body, [5 * um]),
    }


ON_TEETH = ("sizes", "outward", "around", "pitch")
ON_PROFILES = (*ON_TEETH, "tip", "root", "slope", "form")
KINDS = {"rv": ON_TEETH, "rv, exact": ON_TEETH, "gears": ON_PROFILES, "train": tuple(errors_of("pinion_1"))}


def moved(system, errors, theta=0.3) -> np.ndarray:
    """By how much errors change the gaps [m]."""
    scenes = (gj.Scene(system, listed) for listed in ({}, errors))
    without, with_them = (np.asarray(scene.contacts(jnp.asarray(theta)).gap) for scene in scenes)
    return with_them - without


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_errors_are_seen_where_a_run_out_of_their_body_is_seen(name):
    system = SYSTEMS[name]
    for body in [body for body in system.bodies if body not in ("throw", "sun", "planet")]:
        where = sum(np.abs(moved(system, {"of": gj.Eccentricity(body, 1 * um, at)})) for at in (0.0, 1.6)) > 1e-10
        kinds = [kind for kind in KINDS[name] if body != "pin_ring" or kind in ON_TEETH]
        change = moved(system, {kind: errors_of(body)[kind] for kind in kinds})
        assert where.any()
        assert np.abs(change[where]).max() > 1 * um
        assert np.abs(change[~where]).max(initial=0.0) < 1e-12
        thicker = moved(system, {"sizes": errors_of(body)["sizes"]})
        np.testing.assert_allclose(thicker, np.where(where, -5 * um, 0.0), rtol=1e-6, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sizes", "tip", "slope", "form"])
def test_equal_gears_at_the_same_teeth_carry_equal_loads(kind):
    """Two gears half a turn apart with an even number of teeth: each is as one gear alone."""

    def te(gears: int, torque: float | None) -> np.ndarray:
        errors = {f"of_{i}": errors_of(f"gear_{i}")[kind] for i in range(1, gears + 1)}
        scene = gj.Scene(involute(gears), errors, compliance=gj.HarmonicStiffness(2e8, [], []))
        return np.asarray(gj.transmission_error(scene, THETA, torque, extremes="samples").te)

    np.testing.assert_allclose(te(2, None), te(1, None), rtol=0, atol=1e-12)
    np.testing.assert_allclose(te(2, 200.0), te(1, 100.0), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("body", "mesh"), [("pinion_1", 0), ("wheel_1", 0), ("pinion_2", 1), ("wheel_2", 1)])
def test_thicker_teeth_turn_the_output_of_a_train_by_their_own_mesh(body, mesh):
    """Material of 10 um on the flanks of a mesh turns its wheel by 10 um over its base radius."""
    scene = gj.Scene(TRAIN, {"one": gj.Sizes(body, [10 * um])}, backlash=gj.InitialBacklash(0.0))
    base = 0.5 * (50, 54)[mesh] * (2 * mm, 3 * mm)[mesh] * np.cos(20 * deg)
    turned = 10 * um / base * (18 / 54 if mesh == 0 else 1.0)
    found = gj.transmission_error(scene, THETA, extremes="samples").te
    np.testing.assert_allclose(found, turned, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("clearance", ["linear", "exact"])
def test_backlash_closes_by_the_material_of_one_disc(clearance):
    """With more material on one disc its contacts carry alone; on both discs nothing more is closed."""

    def play(*discs: int) -> np.ndarray:
        errors = {f"of_{i}": gj.Sizes(f"disc_{i}", [5 * um]) for i in discs}
        scene = gj.Scene(dataclasses.replace(RV, clearance=clearance), errors)
        return np.asarray(gj.backlash(scene, THETA).backlash) / arcmin

    less = play() - play(1, 2)
    # the teeth of both flanks that touch first are where their lever is largest, the throw times the pins
    assert (less > 2 * 5 * um / float(RV.eccentricity * RV.pins) / arcmin * 0.99).all()
    np.testing.assert_allclose(play(1), play(1, 2), rtol=2e-2)
    np.testing.assert_allclose(play(2), play(1, 2), rtol=2e-2)
