"""Stiffness of teeth by ISO 6336-1, method B: published numbers, the formulas written out anew, gradients, mistakes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.compliance.iso6336 import stiffness_of
from gearjax.units import deg, mm
from tests.helical_pairs import GUO_1, GUO_2, INTERNAL, SPUR

ISO_MM_UM = 1e9  # N/m^2 in one N/(mm um)
LONG = gj.BasicRack(1.25, 1.5)  # of teeth that touch over a base pitch at steep helices too
STEEP = {"teeth": (60, 120), "profile_shifts": (0.0, 0.0), "rack": LONG}


def by_hand(z, beta, x, alpha, dedendum=(1.25, 1.25), internal=False):
    """``c'`` of ISO 6336-1 [N/(mm um)], in its own signs, full load, solid discs."""
    base = np.arcsin(np.sin(beta) * np.cos(alpha))
    inverse = [np.cos(base) ** 2 * np.cos(beta) / teeth for teeth in z]
    if internal:
        inverse[1] = 0.0
    q = 0.04723 + 0.15551 * inverse[0] + 0.25791 * inverse[1] - 0.00635 * x[0] - 0.11654 * x[0] * inverse[0]
    q += -0.00193 * x[1] - 0.24188 * x[1] * inverse[1] + 0.00529 * x[0] ** 2 + 0.00182 * x[1] ** 2
    factors = [(1 + 0.5 * (1.2 - h)) * (1 - 0.02 * (20 - np.rad2deg(alpha))) for h in dedendum]
    return 0.8 / q * np.mean(factors) * np.cos(beta)


@pytest.mark.parametrize(("given", "wanted"), [(GUO_1, 1.392e9), (GUO_2, 6.445e8)])
def test_pairs_of_guo_and_fang(given, wanted):
    """Mean mesh stiffness at full load, worked out apart from gearjax."""
    stiffness = gj.iso6336_stiffness(**given)
    np.testing.assert_allclose(stiffness.mesh_alpha * given["face_width"], wanted, rtol=5e-4)


def test_low_load_of_guo_and_fang():
    """At 830 N m the first pair carries 77 N/mm; the number there is in proportion to the load, ISO's is the power of
    a quarter."""
    pull = 6181.8 / 0.075 * np.cos(20.2785 * deg)  # of the force along the line of action, that at the reference circle
    full, linear, iso = (
        gj.iso6336_stiffness(**GUO_1, **more)
        for more in ({}, {"load_per_width": pull, "low_load_exponent": 1.0}, {"load_per_width": pull})
    )
    np.testing.assert_allclose(full.single / ISO_MM_UM, 12.73, rtol=5e-4)
    np.testing.assert_allclose(linear.mesh_alpha * 0.075, 1.076e9, rtol=1e-3)
    np.testing.assert_allclose(iso.single / full.single, (pull / 1e5) ** 0.25, rtol=1e-12)
    assert float(linear.theoretical) == float(full.theoretical)


def test_example_1_of_iso_tr_6336_30():
    stiffness = gj.iso6336_stiffness(
        teeth=(17, 103),
        normal_module=8 * mm,
        normal_pressure_angle=20 * deg,
        helix_angle=15.8 * deg,
        profile_shifts=(0.145, 0.0),
        face_width=100 * mm,
        centre_distance=500 * mm,
        rack="ISO 53 D",
    )
    np.testing.assert_allclose(stiffness.mesh_alpha / ISO_MM_UM, 17.46, rtol=3e-3)


@pytest.mark.parametrize("given", [GUO_1, GUO_2, SPUR, INTERNAL])
def test_formulas_written_out_anew(given):
    stiffness = gj.iso6336_stiffness(**given, rack=("ISO 53 A", "ISO 53 D"), blank_factor=0.9)
    internal = given.get("internal", False)
    first, second = given["profile_shifts"]
    signs = first, -second if internal else second
    angles = given["helix_angle"], signs, given["normal_pressure_angle"]
    wanted = 0.9 * by_hand(given["teeth"], *angles, (1.25, 1.4), internal)
    np.testing.assert_allclose(stiffness.single / ISO_MM_UM, wanted, rtol=1e-12)
    ratio = float(stiffness.transverse_contact_ratio)
    np.testing.assert_allclose(stiffness.mesh_alpha / stiffness.single, 0.75 * ratio + 0.25, rtol=1e-12)
    np.testing.assert_allclose(stiffness.mesh_beta / stiffness.mesh_alpha, 0.85, rtol=1e-12)
    overlap = given["face_width"] * np.sin(given["helix_angle"]) / (np.pi * given["normal_module"])
    np.testing.assert_allclose(stiffness.overlap_ratio, overlap, rtol=1e-12)


def test_pressure_angle_of_the_rack_counts():
    steep = {**SPUR, "normal_pressure_angle": 25 * deg, "profile_shifts": (0.0, 0.0), "centre_distance": 79.5 * mm}
    stiffness = gj.iso6336_stiffness(**steep)
    wanted = by_hand(SPUR["teeth"], 0.0, (0.0, 0.0), 25 * deg)
    np.testing.assert_allclose(stiffness.single / ISO_MM_UM, wanted, rtol=1e-12)


def test_a_wheel_of_many_teeth_tends_to_the_internal_one():
    """Of an internal pair ``z_n2`` is infinite: with no shifts, as for a wheel of 5000 teeth."""
    shared = {**SPUR, "profile_shifts": (0.0, 0.0), "teeth": (20, 4000), "centre_distance": 6030 * mm}
    outside = gj.iso6336_stiffness(**shared)
    inside = gj.iso6336_stiffness(**{**shared, "centre_distance": 5970 * mm, "internal": True})
    gap = 0.25791 / 4000 / (0.04723 + 0.15551 / 20)
    np.testing.assert_allclose(inside.theoretical / outside.theoretical, 1 + gap, rtol=1e-9)


@pytest.mark.slow
def test_no_jump_where_low_load_begins():
    loads = jnp.asarray([0.999999e5, 1e5, 2e5])
    single = jax.vmap(lambda one: gj.iso6336_stiffness(**GUO_1, load_per_width=one).single)(loads)
    np.testing.assert_allclose(single, single[1], rtol=1e-6)
    assert float(single[0]) < float(single[1]) == float(single[2])


LIMITS = {  # what differs, whether ISO states its formulas for it
    "a common pair": ({}, True),
    "as much load": ({"load_per_width": 2e5}, True),
    "little load": ({"load_per_width": 0.9e5}, False),
    "much load": ({"load_per_width": 1.7e6}, False),
    "shift of the wheel": ({"profile_shifts": (0.1, 0.2)}, False),
    "sum of shifts": ({"profile_shifts": (-0.2, -0.35), "centre_distance": 77.8 * mm}, False),
    "contact ratio": ({"tip_diameters": (65.2 * mm, 103.6 * mm)}, False),
    "steep": ({**STEEP, "helix_angle": 45 * deg, "centre_distance": 381.838 * mm}, True),
    "too steep": ({**STEEP, "helix_angle": 46 * deg, "centre_distance": 388.680 * mm}, False),
}


@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_the_formulas_are_told(name):
    other, wanted = LIMITS[name]
    assert bool(gj.iso6336_stiffness(**{**SPUR, **other}).within_limits) is wanted


@pytest.mark.slow
def test_gradients_are_those_of_differences():
    """Under vmap and jit, of every number, tips and rack included, below 100 N/mm of load."""
    keys = ("normal_module", "normal_pressure_angle", "helix_angle", "face_width", "centre_distance")
    more = {"blank_factor": 0.95, "load_per_width": 5e4, "low_load_exponent": 0.3}
    for given in (GUO_2, INTERNAL):
        outer, inner = (60.2, 115.3) if given is GUO_2 else (47.1, 134.6)
        start = [given[key] for key in keys] + list(more.values())
        start += [*given["profile_shifts"], outer * mm, inner * mm, 1.27, 1.28]
        start = jnp.asarray(start)

        def figures(values, given=given):
            numbers = dict(zip([*keys, *more], values[:8], strict=True))
            racks = tuple(gj.BasicRack(1.0, dedendum) for dedendum in values[12:])
            other = {"profile_shifts": values[8:10], "tip_diameters": values[10:12], "rack": racks}
            found = gj.iso6336_stiffness(**{**given, **numbers, **other})
            parts = found.theoretical, found.single, found.mesh_alpha, found.mesh_beta
            return jnp.stack([*(part / 1e10 for part in parts), found.transverse_contact_ratio, found.overlap_ratio])

        sizes = jnp.maximum(jnp.abs(start), 1e-5)
        many = jnp.stack([start, start * (1 + 1e-6)])
        slopes = np.asarray(jax.jit(jax.vmap(jax.jacrev(figures)))(many))
        assert (np.abs(slopes[0]).max(0) > 0).sum() == len(start)  # nothing is lost on the way
        ways = jnp.diag(1e-5 * sizes)
        both = jax.jit(jax.vmap(lambda way, at: (figures(at + way) - figures(at - way)) / 2, (0, None)))
        for at, slope in zip(many, slopes, strict=True):
            wanted = np.asarray(both(ways, at)).T
            scale = np.abs(wanted).max(1, keepdims=True)
            np.testing.assert_allclose(slope * 1e-5 * np.asarray(sizes) / scale, wanted / scale, rtol=0, atol=1e-6)


def test_a_batch_is_what_its_pairs_are_alone():
    shifts = jnp.asarray([[0.0, 0.0], [0.2, -0.2], [0.4, -0.4]])
    batch = jax.jit(jax.vmap(lambda one: gj.iso6336_stiffness(**{**GUO_1, "profile_shifts": one})))(shifts)
    for i, one in enumerate(shifts):
        alone = gj.iso6336_stiffness(**{**GUO_1, "profile_shifts": one})
        for a, b in zip(jax.tree.leaves(batch), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-12)


EXTREMES = {
    "500 teeth": {"teeth": (20, 500), "centre_distance": 781 * mm},
    "1000 teeth in all": {"teeth": (500, 500), "centre_distance": 1501 * mm},
    "ratio 1": {"teeth": (20, 20), "centre_distance": 60.9 * mm},
    "5 teeth": {"teeth": (5, 60), "helix_angle": 30 * deg, "profile_shifts": (0.5, 0.0), "centre_distance": 114 * mm},
    "45 degrees": {"helix_angle": 45 * deg, "centre_distance": 113.3 * mm, "rack": LONG},
    "other hand": {"helix_angle": -45 * deg, "centre_distance": 113.3 * mm, "rack": LONG},
    "plastic module": {
        "normal_module": 0.1 * mm,
        "face_width": 1 * mm,
        "centre_distance": 2.68 * mm,
    },
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes(name):
    stiffness = gj.iso6336_stiffness(**{**SPUR, **EXTREMES[name]})
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(stiffness))
    assert 3 < float(stiffness.single) / ISO_MM_UM < 20
    assert 1 < float(stiffness.transverse_contact_ratio) < 2.1


@pytest.mark.slow
def test_single_precision_is_enough():
    exact = gj.iso6336_stiffness(**GUO_2)
    sizes = {key: np.float32(GUO_2[key]) for key in ("normal_module", "helix_angle", "face_width", "centre_distance")}
    with jax.enable_x64(False):
        single = gj.iso6336_stiffness(**{**GUO_2, **sizes})
    assert single.mesh_alpha.dtype == np.float32
    np.testing.assert_allclose(single.mesh_alpha, exact.mesh_alpha, rtol=1e-4)


MISTAKES = {  # what differs, the parameter named
    "module in mm": ({"normal_module": 3.0}, "normal_module"),
    "width in mm": ({"face_width": 25.0}, "face_width"),
    "width of 5 mm in mm": ({"face_width": 5.0}, "face_width"),
    "distance in mm": ({"centre_distance": 80.4}, "centre_distance"),
    "tips in mm": ({"tip_diameters": (67.2, 105.6)}, "tip_diameters"),
    "one tip in mm": ({"tip_diameters": (67.2 * mm, 105.6)}, "tip_diameters"),
    "load in N/mm": ({"load_per_width": 300.0}, "load_per_width"),
    "pressure angle in degrees": ({"normal_pressure_angle": 20.0}, "normal_pressure_angle"),
    "helix angle in degrees": ({"helix_angle": 15.0}, "helix_angle"),
    "half a tooth": ({"teeth": (20.5, 33)}, "teeth"),
    "no tooth": ({"teeth": (0, 33)}, "teeth"),
    "teeth of ISO's sign": ({"teeth": (20, -33)}, "teeth"),
    "three gears": ({"teeth": (20, 33, 40)}, "teeth"),
    "one gear": ({"teeth": 20}, "teeth"),
    "words for teeth": ({"teeth": "20"}, "teeth"),
    "wheel first": ({"teeth": (33, 20)}, "teeth"),
    "ring first": ({"teeth": (33, 20), "internal": True}, "teeth"),
    "ring of as many teeth": ({"teeth": (33, 33), "internal": True}, "teeth"),
    "one shift": ({"profile_shifts": 0.3}, "profile_shifts"),
    "shift in mm": ({"profile_shifts": (12.0, 0.0)}, "profile_shifts[0]"),
    "shift that is none": ({"profile_shifts": (0.2, None)}, "profile_shifts[1]"),
    "shift that is nan": ({"profile_shifts": (0.2, float("nan"))}, "profile_shifts[1]"),
    "negative width": ({"face_width": -25 * mm}, "face_width"),
    "a batch": ({"face_width": np.asarray([0.02, 0.03])}, "face_width"),
    "no such rack": ({"rack": "ISO 53"}, "rack"),
    "three racks": ({"rack": ("ISO 53 A",) * 3}, "rack"),
    "blank of no stiffness": ({"blank_factor": 0.0}, "blank_factor"),
    "exponent": ({"low_load_exponent": -1.0}, "low_load_exponent"),
    "internal by a word": ({"internal": "yes"}, "internal"),
    "no distance": ({"centre_distance": None}, "centre_distance"),
    "teeth jam": ({"centre_distance": 79.0 * mm}, "centre_distance"),
    "inside the base circles": ({"centre_distance": 60.0 * mm}, "centre_distance"),
    "far apart": ({"centre_distance": 90.0 * mm}, "centre_distance"),
    "no contact ratio": ({"tip_diameters": (64.2 * mm, 102.4 * mm)}, "centre_distance"),
    "no contact ratio, helical": ({**GUO_2, "tip_diameters": (57.8 * mm, 112.9 * mm)}, "centre_distance"),
    "apart, never tight": ({"profile_shifts": (-1.0, -1.0), "centre_distance": 82 * mm}, "centre_distance"),
    "ring's centre distance": ({**INTERNAL, "centre_distance": 50 * mm}, "centre_distance"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_end_in_one_line(name):
    other, key = MISTAKES[name]
    with pytest.raises(gj.ParameterError) as caught:
        gj.iso6336_stiffness(**{**SPUR, **other})
    words = str(caught.value)
    assert words.startswith(key)
    assert "\n" not in words
    assert "nan mm" not in words


def test_new_numbers_compile_nothing_anew():
    keys = ("face_width", "blank_factor", "load_per_width", "low_load_exponent")
    gj.iso6336_stiffness(**{**GUO_1, **dict(zip(keys, (0.07, 0.9, 7e4, 0.25), strict=True))})
    before = stiffness_of._cached._cache_size()
    gj.iso6336_stiffness(**{**GUO_1, **dict(zip(keys, (0.06, 0.8, 8e4, 0.3), strict=True))})
    assert stiffness_of._cached._cache_size() == before


def test_no_tight_distance_is_named_where_there_is_none():
    """Shifts so negative that the teeth have backlash at every centre distance."""
    with pytest.raises(gj.ParameterError, match=r"increase a tip diameter or the profile shifts$"):
        gj.iso6336_stiffness(**{**SPUR, **MISTAKES["apart, never tight"][0]})
