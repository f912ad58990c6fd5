"""Influence of teeth by finite elements: the element, tables, points between nodes."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skfem
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

import gearjax as gj
from gearjax.geometry.involute import InvoluteGear
from gearjax.influence import teeth as room
from gearjax.influence.element import stiffness
from gearjax.influence.outline import outline
from gearjax.influence.table import smallest_eigenvalue
from gearjax.units import mm

YOUNG, POISSON = 2.06e11, 0.3


def gear_of(teeth=40, module=1 * mm, shift=0.2, *, internal=False) -> InvoluteGear:
    parts = (jnp.asarray(value) for value in (module, np.deg2rad(20), shift, 0.9, 1.25))
    return InvoluteGear(teeth, *parts, internal=internal)


def table_of(gear, scale=1.0, **changed):
    tip = float(gear.tip_radius)
    inner = tip + (1.2 if gear.internal else -1.2) * mm * scale
    chosen = {
        "face_width": 3 * mm * scale,
        "rim": 1 * mm * scale,
        "touching": (inner, tip),
        "youngs_modulus": YOUNG,
        "poissons_ratio": POISSON,
        "profile_elements": 4,
        "layers": 2,
        "thickness_elements": 2,
        "space_elements": 1,
        "teeth": 5,
    }
    return gj.tooth_influence(gear, **chosen | changed)


@pytest.fixture(scope="module")
def gear():
    return gear_of()


@pytest.fixture(scope="module")
def table(gear):
    return table_of(gear)


# the element


def held(matrix, places, fixed, given, load):
    """Displacements where those of some nodes are given."""
    free = np.ones(places.size, dtype=bool)
    free[places[:, fixed]] = False
    moved = given.copy()
    inner = matrix[free][:, free].tocsc()
    moved[free] = spsolve(inner, (load - matrix @ np.where(free, 0.0, given))[free])
    return moved


def test_constant_strains_of_distorted_elements_are_exact(rng):
    mesh = skfem.MeshHex.init_tensor(*[np.linspace(0, 1, 4)] * 3)
    inside = ((mesh.p > 0.01) & (mesh.p < 0.99)).all(axis=0)
    mesh = skfem.MeshHex(mesh.p + 0.08 * inside * rng.uniform(-1, 1, mesh.p.shape), mesh.t)
    matrix, places = stiffness(mesh, YOUNG, POISSON)
    exact = np.zeros(places.size)
    exact[places] = rng.normal(size=(3, 3)) @ mesh.p
    found = held(matrix, places, ~inside, exact, np.zeros(places.size))
    assert inside.sum() == 8
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


def test_rigid_motions_need_no_force(rng):
    mesh = skfem.MeshHex.init_tensor(*[np.linspace(0, 1, 3)] * 3)
    mesh = skfem.MeshHex(mesh.p + 0.05 * rng.uniform(-1, 1, mesh.p.shape), mesh.t)
    matrix, places = stiffness(mesh, YOUNG, POISSON)
    turn = rng.normal(size=3)
    motion = np.zeros(places.size)
    motion[places] = rng.normal(size=(3, 1)) + np.cross(turn, mesh.p.T).T
    assert np.abs(matrix @ motion).max() < 1e-12 * YOUNG * np.abs(motion).max()


def bent(mesh_of_beam, poisson=0.0) -> float:
    """Deflection of a cantilever of length 10, width and height 1, over that of Timoshenko's beam."""
    matrix, places = stiffness(mesh_of_beam, 1.0, poisson)
    end = mesh_of_beam.p[0] > 10 - 1e-9
    load = np.zeros(places.size)
    load[places[2, end]] = 1 / end.sum()
    moved = held(matrix, places, mesh_of_beam.p[0] < 1e-9, np.zeros(places.size), load)
    shear = 5 / 6 * 0.5 / (1 + poisson)
    return moved[places[2, end]].mean() / (10**3 / (3 / 12) + 10 / shear)


def test_one_layer_of_elements_bends_as_a_beam():
    grid = np.linspace(0, 10, 11), np.linspace(0, 1, 2), np.linspace(0, 1, 2)
    beam = skfem.MeshHex.init_tensor(*grid)
    assert bent(beam) == pytest.approx(1, abs=0.01)
    assert bent(beam, 0.3) == pytest.approx(1, abs=0.03)


def test_skewed_elements_bend_as_a_beam_does():
    beam = skfem.MeshHex.init_tensor(np.linspace(0, 10, 21), np.linspace(0, 1, 2), np.linspace(0, 1, 3))
    skewed = beam.p + np.stack([0.1 * np.sin(np.pi * beam.p[0] / 5) * (beam.p[2] - 0.5), *np.zeros_like(beam.p[:2])])
    assert bent(skfem.MeshHex(skewed, beam.t)) == pytest.approx(1, abs=0.03)


# tables


@pytest.mark.parametrize("internal", [False, True])
def test_a_table_is_symmetric_and_positive_definite(internal):
    gear = gear_of(60, internal=internal)
    table = table_of(gear)
    assert table.matrix.shape == (3, 15, 15)
    assert table.radius.shape == (5,)
    assert table.face.shape == (3,)
    np.testing.assert_array_equal(table.matrix[0], table.matrix[0].T)
    assert np.linalg.eigvalsh(table.matrix[0])[0] > 0
    assert smallest_eigenvalue(np.asarray(table.matrix)) > 0
    own, next_tooth, after = (np.abs(block).max() for block in table.matrix)
    assert own > 20 * next_tooth > 20 * after
    # forces press into the material, so that a force moves its own point with it
    assert (np.diagonal(table.matrix[0]) > 0).all()


def test_a_force_on_the_next_tooth_acts_as_on_a_tooth_behind(gear, table, monkeypatch):
    """Reciprocity, from another solution: the row is put off by a tooth, so that another one is loaded."""
    meshed = room._meshed

    def put_off(*given, **named):
        mesh = meshed(*given, **named)
        return mesh._replace(flank=np.roll(mesh.flank, -1, axis=0), axes=np.roll(mesh.axes, -1))

    monkeypatch.setattr(room, "_meshed", put_off)
    other = table_of(gear, teeth=9)
    monkeypatch.undo()
    long = table_of(gear, teeth=9)
    for distance in range(2):
        block = np.asarray(long.matrix[distance])
        largest = np.abs(block).max()
        np.testing.assert_allclose(other.matrix[distance], block, atol=0.01 * largest)
        np.testing.assert_allclose(table.matrix[distance], block, atol=0.01 * largest)


@pytest.mark.parametrize("internal", [False, True])
def test_ahead_is_towards_increasing_polar_angles(internal, monkeypatch):
    """One force, solved for apart, with normals from differences along the flank."""
    gear, meshes, meshed = gear_of(60, internal=internal), [], room._meshed
    monkeypatch.setattr(room, "_meshed", lambda *given, **named: meshes.append(meshed(*given, **named)) or meshes[-1])
    table = table_of(gear)
    mesh = meshes[0]
    matrix, places = stiffness(mesh.mesh, YOUNG, POISSON)
    step = 1e-4 * mm

    def inwards(tooth, radius):
        ends = np.array([radius - step, radius + step])
        angle = mesh.axes[tooth] + np.asarray(gear.half_angle(jnp.asarray(ends)))
        x, y = np.diff(ends * np.cos(angle))[0], np.diff(ends * np.sin(angle))[0]
        return np.array([y, -x]) / np.hypot(x, y)

    at, load = mesh.flank[2, 1, 0], np.zeros(places.size)
    load[places[:2, at]] = inwards(2, float(table.radius[1]))
    moved = held(matrix, places, mesh.fixed, np.zeros(places.size), load)
    own, ahead = (
        [
            inwards(tooth, float(radius)) @ moved[places[:2, node]]
            for radius, nodes in zip(table.radius, mesh.flank[tooth], strict=True)
            for node in nodes
        ]
        for tooth in (2, 3)
    )
    assert mesh.axes[3] > mesh.axes[2]
    force = len(table.face)  # node of the second radius, at one end of the face
    np.testing.assert_allclose(own, table.matrix[0, force], rtol=1e-6, atol=1e-15)
    difference = np.abs(np.asarray(ahead) - table.matrix[1, force]).max()
    assert difference < 0.05 * np.abs(np.asarray(ahead) - table.matrix[1, :, force]).max()


def test_lengths_and_stiffness_scale_as_they_must(table):
    twice = table_of(gear_of(module=2 * mm), scale=2.0, youngs_modulus=3 * YOUNG)
    np.testing.assert_allclose(twice.matrix, table.matrix / 6, rtol=1e-9)
    np.testing.assert_allclose(twice.radius, 2 * table.radius)


def spread(table) -> float:
    """Mean displacement under a pressure that is equal everywhere, per force."""
    share = np.outer(np.gradient(np.asarray(table.radius)), np.gradient(np.asarray(table.face)))
    share[[0, -1]] /= 2
    share[:, [0, -1]] /= 2
    share = share.ravel() / share.sum()
    return float(share @ table.matrix[0] @ share)


@pytest.mark.slow
def test_finer_meshes_converge(gear):
    coarse, middle, fine = (
        spread(table_of(gear, teeth=3, distances=0, profile_elements=4 * n, layers=n, thickness_elements=2 * n))
        for n in (1, 2, 3)
    )
    assert coarse == pytest.approx(fine, rel=0.02)
    assert middle == pytest.approx(fine, rel=0.01)


def test_a_deeper_rim_and_a_weaker_fillet_yield_more(gear, table):
    assert spread(table_of(gear, rim=2 * mm)) > 1.02 * spread(table)
    assert spread(table_of(gear, fillet=0.0)) > spread(table)


def test_a_wider_face_than_the_mate_supports_the_teeth(gear, table):
    wide = table_of(gear, face_width=6 * mm, meeting=(1 * mm, 4 * mm))
    np.testing.assert_allclose(wide.face, table.face, atol=1e-12)
    assert spread(wide) < spread(table)
    assert wide.matrix[0, 0, 0] < table.matrix[0, 0, 0]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"rim": 0.0}, "tooth_influence.rim = 0.0: has to be above 0"),
        ({"poissons_ratio": 0.5}, "from 0 to below 0.5"),
        ({"meeting": (0.0, 9 * mm)}, "between 0 and 0.003 m"),
        ({"teeth": 4}, "must be odd"),
        ({"teeth": 3, "distances": 2}, "from 0 to 1, with 3 teeth"),
        ({"profile_elements": 2}, "tooth_influence.profile = 2: must be at least 3"),
        ({"touching": (19 * mm, 21.1 * mm)}, "end of the fillet"),
        ({"touching": (20 * mm, 22 * mm)}, "towards the tip"),
        ({"fillet": 3 * mm}, "does not fit"),
    ],
)
def test_what_makes_no_mesh_is_refused_in_one_line(gear, changed, message):
    with pytest.raises(gj.GearjaxError, match=message) as caught:
        table_of(gear, **changed)
    assert "\n" not in str(caught.value)


def test_without_scikit_fem_the_extra_is_named(gear, monkeypatch):
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(gj.GearjaxError, match=r"needs the extra fem: pip install 'gearjax\[fem\]'"):
        table_of(gear)


def test_an_outline_meets_its_radii_and_the_root_circle(gear):
    radii = np.linspace(20 * mm, float(gear.tip_radius), 6)
    shape = outline(gear, radii, rim=1 * mm, fillet=0.2 * mm, space_elements=2)
    np.testing.assert_allclose(shape.radius[shape.touching], radii)
    np.testing.assert_allclose(shape.angle[shape.touching], gear.half_angle(jnp.asarray(radii)), atol=1e-12)
    assert (np.diff(shape.radius) > 0).all()
    assert (np.diff(shape.angle) < 0).all()
    assert shape.space_radius[0] == shape.radius[0]
    assert shape.space_angle[0] == shape.angle[0]
    assert shape.space_radius[-1] == pytest.approx(float(gear.root_radius))
    assert shape.space_angle[-1] == pytest.approx(np.pi / gear.teeth)


# points between nodes


@pytest.mark.slow
def test_at_the_nodes_the_table_is_given_back(table):
    radii, faces = len(table.radius), len(table.face)
    radius, face = np.repeat(table.radius, faces), np.tile(table.face, radii)
    tooth = jnp.repeat(jnp.array([4, 5, 6, 9]), radii * faces)
    found = gj.influence_between(table, jnp.tile(radius, 4), jnp.tile(face, 4), tooth)
    blocks = np.asarray(found).reshape(4, radii * faces, 4, radii * faces)
    for one in range(3):
        for other in range(3):
            block = np.asarray(table.matrix)[abs(one - other)]
            expected = block if other >= one else block.T  # from one to the other, which is ahead
            np.testing.assert_allclose(blocks[one, :, other], expected, rtol=1e-12, atol=1e-22)
    assert not blocks[0, :, 3].any()


@pytest.mark.slow
def test_a_grid_is_what_its_points_are(table, rng):
    radius = jnp.asarray(rng.uniform(table.radius[0], table.radius[-1], (4, 6)))
    faces = len(table.face)
    tooth = jnp.repeat(jnp.arange(4), 6 * faces)
    points = jnp.repeat(radius.ravel(), faces), jnp.tile(table.face, 24), tooth
    grid = jax.jit(gj.influence_on_grid)(table, radius)
    np.testing.assert_allclose(grid, gj.influence_between(table, *points), rtol=1e-10, atol=1e-20)
    np.testing.assert_allclose(grid, grid.T, rtol=1e-12, atol=1e-24)
    mirrored = gj.influence_on_grid(table.mirrored, radius[::-1])
    turned = np.asarray(mirrored).reshape(4, 6 * faces, 4, 6 * faces)[::-1, :, ::-1].reshape(grid.shape)
    np.testing.assert_allclose(grid, turned, rtol=1e-12, atol=1e-24)


@pytest.mark.slow
def test_between_nodes_stand_a_spline_and_straight_lines(table, rng):
    radius, face = rng.uniform(table.radius[0], table.radius[-1], 8), rng.uniform(0, table.face[-1], 8)
    found = gj.influence_between(table, jnp.asarray(radius), jnp.asarray(face), jnp.zeros(8, int))
    along = CubicSpline(table.radius, np.eye(len(table.radius)))(radius)
    across = np.stack([np.interp(face, table.face, unit) for unit in np.eye(len(table.face))], axis=1)
    weights = (along[:, :, None] * across[:, None]).reshape(8, -1)
    expected = weights @ np.asarray(table.matrix[0]) @ weights.T
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * expected.max())


@pytest.mark.slow
def test_points_beyond_the_nodes_count_as_on_their_edge(table):
    beyond = jnp.array([float(table.radius[0]) - 1 * mm, float(table.radius[-1]) + 1 * mm])
    edges = jnp.stack([table.radius[0], table.radius[-1]])
    face, tooth = jnp.zeros(2), jnp.array([0, 1])
    np.testing.assert_allclose(
        gj.influence_between(table, beyond, face - 1 * mm, tooth), gj.influence_between(table, edges, face, tooth)
    )


@pytest.mark.slow
def test_derivatives_by_the_radius_agree_with_differences(table, rng):
    radius = jnp.asarray(rng.uniform(table.radius[0], table.radius[-1], (3, 2)))
    force = jnp.asarray(rng.normal(size=6 * len(table.face)))

    @jax.jit
    def energy(radius):
        return force @ gj.influence_on_grid(table, radius) @ force

    slope = jax.grad(energy)(radius)
    step = 1e-5 * mm
    for place in np.ndindex(radius.shape):
        change = jnp.zeros_like(radius).at[place].set(step)
        difference = (energy(radius + change) - energy(radius - change)) / (2 * step)
        assert slope[place] == pytest.approx(float(difference), rel=1e-6, abs=1e-6 * float(jnp.abs(slope).max()))
    many = jax.vmap(energy)(jnp.stack([radius, radius + step]))
    np.testing.assert_allclose(many, [energy(radius), energy(radius + step)], rtol=1e-12)
