"""Loads of the involute RV reducer by every compliance, against laws of mechanics, other solvers, and limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import Request
from gearjax.influence.table import gear_hash
from gearjax.systems import flank_radii
from gearjax.units import mm, um
from tests.conftest import ROOT
from tests.involute import STEEL, angle_of, per_pair, system


def test_one_stiffness_for_each_pair_is_the_closed_form(rng):
    """At random angles and torques, by trying every number of pairs that carry."""
    own = system(pairs=13)
    scene = gj.Scene(own, compliance=gj.HarmonicStiffness(mean=2e8, relative_amplitudes=[], phases=[]))
    radius = float(own.pair.external.base_radius)
    for theta, torque in zip(rng.uniform(0, own.cycle, 4), (1e-3, 5.0, 100.0, 400.0), strict=True):
        found = gj.transmission_error(scene, jnp.asarray([theta]), torque=torque)
        gaps = np.sort(np.asarray(own.pose(jnp.asarray(theta), Request()).gap))
        approach = next(
            at
            for carry in range(1, len(gaps) + 1)
            if (at := (torque / radius / 2e8 + gaps[:carry].sum()) / carry) <= (*gaps, np.inf)[carry]
        )
        assert -float(found.te[0]) * radius == pytest.approx(approach, rel=1e-12)


def test_published_loads_by_one_stiffness():
    """The reference's best fit of one stiffness for all pairs: 2.0e5 N/mm at the share 0.25 of the path, two digits."""
    own = system(pairs=9)
    scene = gj.Scene(own, compliance=gj.HarmonicStiffness(mean=2.0e8, relative_amplitudes=[], phases=[]))
    theta = angle_of(own, 0.25)
    found = gj.transmission_error(scene, jnp.asarray([theta]), torque=100.0)
    loads = per_pair(own, theta, found.forces[0])
    np.testing.assert_allclose(loads[loads > 0], [40.3, 275.5, 374.5, 377.6, 337.0, 149.9], atol=1.0)
    assert loads.sum() == pytest.approx(1554.9, abs=0.02)


def test_elastic_teeth_give_what_finite_elements_give():
    """Loads of `InfluenceMatrix` with the rim of 0.8 mm and of 2 mm, an even load across the face (slow test below)."""
    known = {
        0.8: [62.2, 245.8, 376.8, 404.8, 313.3, 152.0, 0.0],
        2.0: [89.9, 248.5, 354.9, 377.3, 304.6, 167.8, 11.8],
    }
    own = system(pairs=9, profile_points=5)
    theta = angle_of(own, 0.3417)
    for (rim, loads), part in zip(known.items(), (0.02, 0.04), strict=True):
        scene = gj.Scene(own, compliance=gj.ElasticTeeth(**STEEL, rim=rim * mm))
        found = gj.transmission_error(scene, jnp.asarray([theta]), torque=100.0)
        mine = per_pair(own, theta, found.forces[0])
        first = int(np.flatnonzero(mine)[0])
        np.testing.assert_allclose(mine[first : first + 7], loads, atol=part * max(loads))


def test_elastic_teeth_are_symmetric_definite_and_pass_reciprocity(rng):
    """The matrix of a scene at random angles; a wider ring and a thicker rim only change it as they should."""
    own = system(pairs=5, profile_points=4, face_points=5)
    for theta in rng.uniform(0, 1, 2):
        parts = {}
        for name, changes in {"plain": {}, "rim": {"rim": 1 * mm}, "narrow": {"internal_width": 6.5 * mm}}.items():
            scene = gj.Scene(own, compliance=gj.ElasticTeeth(**(STEEL | changes)))
            influence = np.asarray(scene.contacts(jnp.asarray(theta), "mean").springs.influence)
            np.testing.assert_allclose(influence, influence.T, rtol=1e-12)
            assert np.linalg.eigvalsh(influence)[0] > 0
            parts[name] = influence.sum()
        assert parts["rim"] < parts["plain"] < parts["narrow"]


def test_an_even_load_across_the_face_is_what_many_slices_carry():
    """Forces of one pair over equally wide gears: the same compliance, with one place across the face and with many."""
    wide = STEEL | {"internal_width": 6.5 * mm}
    totals = []
    for slices in (1, 21, 41):
        own = system(pairs=1, profile_points=3, face_points=slices)
        scene = gj.Scene(own, compliance=gj.ElasticTeeth(**wide))
        influence = np.asarray(scene.contacts(jnp.asarray(0.3), "mean").springs.influence)
        share = np.full(slices, 1.0)
        share[[0, -1]] = 0.5 if slices > 1 else 1.0
        share = np.tile(share / share.sum(), 3)
        totals.append(share @ influence @ share)
    even, coarse, fine = totals
    assert fine == pytest.approx(even, rel=3e-3)
    assert abs(fine - even) < 0.3 * abs(coarse - even)  # the second order of straight lines


def test_gradients_of_the_loaded_error_are_those_of_differences():
    """With respect to centre distance, shift, a tooth's place and modulus, under jit and vmap over angles."""
    own = system(pairs=9, profile_points=3)
    theta = jnp.sort(jnp.asarray([angle_of(own, share) for share in (0.7, 0.45, 0.2)]))

    def error(numbers):
        distance, shift, tooth, modulus = numbers
        changed = system(pairs=9, profile_points=3, centre_distance=distance, external_shift=shift)
        places = jnp.zeros(236).at[16].set(tooth)
        errors = {"pitch": gj.Positions(body="gear_1", outward=jnp.zeros(0), around=places)}
        scene = gj.Scene(changed, errors, compliance=gj.ElasticTeeth(**(STEEL | {"youngs_modulus": modulus})))
        return gj.transmission_error(scene, theta, torque=100.0).te

    at = jnp.asarray([1.4995 * mm, -0.4, 0.5 * um, 2.06e11])
    slopes = jax.jit(jax.jacrev(error))(at)
    value = jax.jit(error)
    for column, step in enumerate([1e-9, 1e-7, 1e-9, 1e6]):
        way = np.zeros(4)
        way[column] = step
        difference = (8 * (value(at + way) - value(at - way)) - (value(at + 2 * way) - value(at - 2 * way))) / (
            12 * step
        )
        scale = np.abs(difference).max()
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-6, atol=1e-6 * scale)


def test_loads_balance_at_extremes():
    """Torques from none to that of the paper, one candidate, and the torque turned around."""
    own = system(pairs=9)
    elastic = gj.ElasticTeeth(**STEEL)
    theta, radius = jnp.asarray([0.01]), float(own.pair.external.base_radius)
    for torque in (0.0, 1e-9, 1.0, 100.0):
        found = gj.transmission_error(gj.Scene(own, compliance=elastic), theta, torque=torque)
        assert float(found.forces.sum()) * radius == pytest.approx(torque, rel=1e-9, abs=1e-15)
        assert int(found.result[0]) == 0
    one = gj.transmission_error(gj.Scene(system(pairs=1), compliance=elastic), theta, torque=100.0)
    assert float(one.forces.sum()) * radius == pytest.approx(100.0, rel=1e-12)
    roomy = gj.Scene(own, backlash=gj.InitialBacklash(initial=20 * um), compliance=elastic)
    both = [gj.transmission_error(roomy, theta, torque=torque) for torque in (100.0, -100.0)]
    lost = float(both[1].te[0] - both[0].te[0])
    assert lost > float(gj.backlash(roomy, theta).backlash[0]) > 0
    with pytest.raises(gj.GearjaxError, match="list a \\[backlash\\]"):
        gj.transmission_error(gj.Scene(own, compliance=elastic), theta, torque=-1.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"external_teeth": 240}, "external_teeth = 240: must be below internal_teeth"),
        ({"centre_distance": 1.0 * mm}, "must be above the difference of the base radii"),
        ({"pairs": 201}, "pairs = 201"),
        ({"sun_teeth": 22}, "a first stage needs"),
        ({"external_addendum": 3.0}, "pointed teeth"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(changes, words):
    with pytest.raises(gj.GearjaxError) as caught:
        system(**changes)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_gear_sets_have_no_places_for_elastic_teeth():
    with pytest.raises(gj.GearjaxError, match="needs the places of contacts on their teeth"):
        gj.Scene(gj.load(ROOT / "configs/two_kv/wang_2020.toml").system, compliance=gj.ElasticTeeth(**STEEL))


def test_a_single_candidate_is_too_few_for_finite_elements():
    matrix = gj.InfluenceMatrix(**STEEL, rim=0.8 * mm)
    with pytest.raises(gj.GearjaxError, match="at least 3 candidates along the profile"):
        matrix.made_for(*flank_radii(system()))
    with pytest.raises(gj.GearjaxError, match="has no tables"):
        gj.Scene(system(profile_points=3), compliance=matrix)


def test_fewer_candidates_than_elements_are_told(monkeypatch):
    """Read from files: four elements along the profile, and three candidates."""
    own = system(profile_points=3)
    gears, radii = flank_radii(own)
    tables = []
    for gear, radius in zip(gears, radii, strict=True):
        nodes = np.linspace(float(radius.min()), float(radius.max()), 5)
        tables.append(gj.InfluenceTable(nodes, np.array([0.0, 6.5 * mm]), 1e-9 * np.eye(10)[None], gear_hash(gear)))
    matrix = gj.InfluenceMatrix(**STEEL, rim=0.8 * mm, external_file="one.npz", internal_file="other.npz")
    monkeypatch.setattr("gearjax.compliance.influence_matrix.read_influence", lambda *_: tables.pop(0))
    with pytest.warns(gj.FewCandidates, match=r"3 candidates .* its 4 elements: give system.profile_points = 4"):
        matrix.made_for(gears, radii)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewCandidates")  # nine candidates of ten elements
def test_published_loads_by_finite_elements():
    """Table 5 of the paper within 1 N rms, the phase and the rim fitted; six pairs of teeth, none on the others."""
    published = [58.6, 244.2, 379.7, 407.8, 315.1, 149.5]
    own = system(pairs=9, profile_points=9, face_points=14)
    theta = angle_of(own, 0.3417)
    for rim, bound in ((0.8, 1.5), (0.77, 1.0)):
        matrix = gj.InfluenceMatrix(**STEEL, rim=rim * mm).made_for(*flank_radii(own))
        found = gj.transmission_error(gj.Scene(own, compliance=matrix), jnp.asarray([theta]), torque=100.0)
        loads = per_pair(own, theta, found.forces[0])
        assert (loads > 0).sum() == 6
        assert loads.sum() == pytest.approx(1554.9, abs=0.02)
        assert np.sqrt(np.mean((loads[loads > 0] - published) ** 2)) < bound
        even = system(pairs=9, profile_points=9)
        loads = per_pair(
            even, theta, gj.transmission_error(gj.Scene(even, compliance=matrix), jnp.asarray([theta]), 100.0).forces[0]
        )
        if rim == 0.8:  # what elastic teeth are compared with above
            np.testing.assert_allclose(loads[loads > 0], [62.2, 245.8, 376.8, 404.8, 313.3, 152.0], atol=0.1)
