"""Teeth of an involute RV reducer that overlap are told where its back flanks are not modelled, as where they are."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import Request
from gearjax.tolerance.interference import clashes
from gearjax.units import deg, mm, um
from tests.involute import system
from tests.test_cli import command

SPRINGS = gj.HarmonicStiffness(mean=2e8, relative_amplitudes=[], phases=[])
TURN = np.linspace(0.0, 2 * np.pi, 241)  # of the crank, by whole teeth: one pair of each side is on its line
ROOMY = {"centre_distance": 1.497 * mm}  # 3.7 um between the flanks


def run_out(own: gj.InvoluteRV, share: float) -> float:
    """Of the ring, as a share of what closes the room between both flanks when it points along the throw [m]."""
    return share * 0.5 * float(own.pair.backlash / np.sin(own.pair.operating_pressure_angle))


def eccentric(share: float, **others) -> gj.Scene:
    own = system(**ROOMY)
    ring = gj.Eccentricity(body="ring", amplitude=run_out(own, share), phase=0.0)
    return gj.Scene(own, {"ring": ring}, **others)


def tooth_ahead(own: gj.InvoluteRV, theta: float, by: float) -> tuple[gj.Positions, int]:
    """One tooth of the external gear stands ahead: the one in the middle of the driving flanks that may touch."""
    tooth = int(np.sort(np.asarray(own.candidates(jnp.asarray(theta), False).tooth[0]))[own.pairs // 2])
    around = jnp.zeros(own.external_teeth).at[tooth % own.external_teeth].set(by)
    return gj.Positions(body="gear_1", outward=jnp.zeros(0), around=around), tooth % own.external_teeth


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.1, 2.0])
def test_a_run_out_beyond_half_the_room_is_told_with_how_much(share):
    """Along the throw it closes both flanks by its part across them; rigid flanks share what is missing."""
    scene = eccentric(share)
    pair = scene.system.pair
    room = float(pair.backlash)
    wanted = run_out(scene.system, share) * float(np.sin(pair.operating_pressure_angle)) - room / 2
    te = gj.transmission_error(scene, TURN)
    assert float(te.interference.overlap.max()) == pytest.approx(wanted, abs=1e-10)
    worst = int(te.interference.worst)
    assert TURN[worst] == pytest.approx(np.pi, abs=0.03)
    np.testing.assert_array_equal(te.result, np.where(np.asarray(te.interference.overlap) > 1e-12, 2, 0))
    assert 0 < int((te.result == 2).sum()) < TURN.size
    words = te.interference.told(scene)
    assert f"by up to {wanted / um:.3g} um (the " in words
    assert f"flank of pair {int(te.interference.contact[worst]) % 15 + 1} of 15 on gear_1, input angle" in words
    np.testing.assert_allclose(gj.interference(scene, TURN).overlap, te.interference.overlap, rtol=1e-12)


def test_what_fits_is_quiet():
    scene = eccentric(0.9)
    te = gj.transmission_error(scene, TURN)
    assert not np.asarray(te.result).any()
    assert te.interference.told(scene) is None
    assert float(te.interference.overlap.max() / float(scene.system.pair.backlash)) == pytest.approx(-0.05, abs=1e-4)


@pytest.mark.slow
def test_single_precision_is_quiet_within_its_rounding():
    """Overlaps keep the precision of the scene, by which they are told from rounding (0.5 um)."""
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), eccentric(2.0))
    te = gj.transmission_error(single, jnp.asarray(TURN, jnp.float32))
    assert te.interference.overlap.dtype == te.te.dtype == jnp.float32
    known = gj.interference(eccentric(2.0), TURN).overlap
    np.testing.assert_allclose(te.interference.overlap, known, atol=0.05 * um)
    np.testing.assert_array_equal(te.result == 2, te.interference.overlap > 4 * np.finfo(np.float32).eps)


@pytest.mark.slow
def test_a_tooth_ahead_is_told_by_what_gaps_of_both_flanks_say():
    """In numpy: the smallest gaps of both sides, of ideal gears and of that tooth, have a negative sum."""
    own = system(**ROOMY)
    theta = 0.01
    error, tooth = tooth_ahead(own, theta, 10 * um)
    scene = gj.Scene(own, {"teeth": error})
    found = gj.transmission_error(scene, np.array([theta])).interference
    at = own.candidates(jnp.asarray(theta), True)
    gap = np.asarray(own.pose(jnp.asarray(theta), Request(back=True)).gap).reshape(2, own.pairs)
    cosine = 1 / np.sqrt(1 + np.asarray(at.points.roll[0])[..., 0] ** 2)  # of a step around along the flank's normal
    moved = np.where(np.asarray(at.tooth) % own.external_teeth == tooth, 10 * um * cosine, 0.0)
    gap = gap - np.array([[1.0], [-1.0]]) * moved
    missing = -(gap[0].min() + gap[1].min()) / 2
    assert missing > 1 * um
    assert float(found.overlap[0]) == pytest.approx(missing, abs=1e-12)
    contact = int(found.contact[0])
    assert contact % own.pairs == (np.argmin(gap[0]) if contact < own.pairs else np.argmin(gap[1]))


@pytest.mark.slow
@pytest.mark.parametrize("reference", [None, gj.ZeroAtStart()])
def test_it_is_the_interference_of_flanks_that_are_modelled(reference):
    """Back flanks without more room than the gears give them: the same overlaps, contacts and angles."""
    alone = eccentric(1.5, reference=reference)
    both = eccentric(1.5, reference=reference, backlash=gj.InitialBacklash(initial=0.0))
    found, known = gj.transmission_error(alone, TURN), gj.backlash(both, TURN)
    np.testing.assert_allclose(found.interference.overlap, known.interference.overlap, rtol=1e-12)
    np.testing.assert_array_equal(found.interference.contact, known.interference.contact)
    np.testing.assert_array_equal(found.result, known.result)
    told = gj.transmission_error(both, TURN)
    np.testing.assert_array_equal(told.result, known.result)
    roomy = eccentric(1.5, reference=reference, backlash=gj.InitialBacklash(initial=10 * um))
    assert not np.asarray(gj.transmission_error(roomy, TURN).result).any()


@pytest.mark.slow
def test_under_torque_it_is_told_where_no_back_flank_carries_it():
    """The loads are those of the driving flanks alone, which the result's code is about."""
    theta = TURN[::30]
    alone = eccentric(2.0, compliance=SPRINGS)
    found = gj.transmission_error(alone, theta, torque=50.0, extremes="samples")
    np.testing.assert_allclose(found.interference.overlap, gj.interference(alone, theta).overlap, rtol=1e-12)
    assert "um (the " in found.interference.told(alone)
    assert not np.asarray(found.result).any()
    pressed = eccentric(2.0, compliance=SPRINGS, backlash=gj.InitialBacklash(initial=0.0))
    assert gj.transmission_error(pressed, theta, torque=50.0, extremes="samples").interference is None


@pytest.mark.slow
def test_batches_tell_it_too():
    scene, theta = eccentric(1.0), TURN[::20]
    sizes = jnp.asarray([run_out(scene.system, share) for share in (0.5, 2.0)])

    def of(size):
        ring = gj.Eccentricity(body="ring", amplitude=size, phase=0.0)
        return gj.transmission_error(gj.Scene(scene.system, {"ring": ring}), theta)

    found = jax.vmap(of)(sizes)
    assert found.interference.overlap.shape == (2, theta.size)
    assert np.asarray(found.result == 2).any(axis=1).tolist() == [False, True]


@pytest.mark.slow
def test_populations_tell_it_too():
    scene = eccentric(0.5)
    varied = gj.Tolerances(scene, {"errors.ring.amplitude": gj.Uniform(0.0, 10 * um)})
    rows = np.array([[run_out(scene.system, share)] for share in (0.5, 2.0, 0.9)])
    found = clashes(varied, rows, TURN)
    assert found is not None
    assert (found.looked_at, found.interfering, found.sample) == (3, 1, 1)
    known = gj.interference(eccentric(2.0), TURN).overlap.max()
    assert found.overlap == pytest.approx(float(known), rel=1e-9)


def test_a_gear_set_without_room_of_its_own_has_nothing_to_tell(scene):
    """That of a 2K-V is an effect that is modelled or not."""
    bare = gj.Scene(scene.system, scene.errors)
    assert gj.transmission_error(bare, TURN).interference is None
    with pytest.raises(gj.SceneError, match=r'"interference" needs \[backlash\]'):
        gj.interference(bare, TURN)


CONFIG = """
[system]
kind = "involute_rv"
external_teeth = 236
internal_teeth = 240
module = "0.58 mm"
pressure_angle = "20 deg"
external_shift = -0.4
internal_shift = 0.55028
external_addendum = 0.6328
internal_addendum = 1.0
centre_distance = "1.497 mm"
input_speed = "885 rpm"

[errors.ring]
kind = "eccentricity"
body = "ring"
amplitude = "SIZE um"
phase = "0 deg"

[compliance]
kind = "harmonic_stiffness"
mean = "2e8 N/m"
relative_amplitudes = []
phases = []

[run]
duration = "0.0677966 s"
samples = 401
analyses = ["ANALYSIS"]
torques = ["50 N*m"]
"""


@pytest.mark.slow
@pytest.mark.parametrize("analysis", ["no_load", "static"])
def test_the_command_line_tells_it_as_with_back_flanks(capsys, tmp_path, analysis):
    path = tmp_path / "jam.toml"
    told = []
    for more in ("", '\n[backlash]\ninitial = "0 um"\n'):
        path.write_text(CONFIG.replace("SIZE", "6").replace("ANALYSIS", analysis) + more, encoding="utf-8")
        code, out, err = command(capsys, "run", path, "--json")
        assert code == 0
        notes = [line for line in err.splitlines() if line.startswith("warning: ")]
        told.append((notes, json.loads(out)["interference"]))
    (notes, entry), known = told
    assert (notes, entry) == known
    assert len(notes) == 1
    assert notes[0].startswith("warning: interference: rigid bodies overlap at ")
    pair = system(**ROOMY).pair
    wanted = 6 * np.sin(float(pair.operating_pressure_angle)) - float(pair.backlash) / um / 2
    assert entry["overlap_um"] == pytest.approx(wanted, abs=5e-3)  # somewhat more between these teeth
    assert f"by up to {entry['overlap_um']:.3g} um" in notes[0]
    assert entry["contact"].endswith("of 15 on gear_1")
    assert entry["input_angle_deg"] == pytest.approx(np.pi / deg, abs=2)
    assert 0.1 < entry["share_of_angles"] < 0.9


@pytest.mark.slow
def test_the_command_line_is_quiet_where_the_teeth_fit(capsys, tmp_path):
    path = tmp_path / "fits.toml"
    path.write_text(CONFIG.replace("SIZE", "2").replace("ANALYSIS", "no_load"), encoding="utf-8")
    code, out, err = command(capsys, "run", path, "--json")
    assert code == 0
    assert "warning" not in err
    assert "interference" not in json.loads(out)
