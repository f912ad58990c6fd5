"""Scenes with supports the whole way: configurations, files, figures, populations, studies, the command."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import gearjax as gj
from gearjax import plot, results
from gearjax.tolerance import Work
from gearjax.typing import Scalar
from tests.rv import LINEAR, system
from tests.test_supports import SCENES, Sharing, pair, planets

# the whole way -------------------------------------------------------------------------------------------------

SUPPORTS = """
[supports.disc_1]
x = "2e8 N/m"
y = "2.6e8 N/m"
[supports.disc_2]
y = "160 N/um"
"""


@pytest.fixture
def text(rv_text) -> str:
    return rv_text.replace(', "dynamic"', "").replace("samples = 801", "samples = 81") + SUPPORTS


@pytest.mark.slow
def test_from_a_configuration_to_files_and_figures(text, tmp_path):
    scene = gj.loads(text)
    assert float(scene.supports["disc_2"].y) == 1.6e8
    cases = list(results.run_cases(scene))
    results.save(scene, cases, text, tmp_path)
    written = [path.name for path in plot.save_figures(scene, cases, tmp_path)]
    assert {"support_displacements.png", "bearing_forces.png"} <= set(written)
    with xr.open_dataset(tmp_path / "results.nc", engine="scipy") as stored:
        moved = stored["static_784_Nm_moved"]
        assert [name.decode() if isinstance(name, bytes) else str(name) for name in moved["coordinate"].values] == [
            "disc_1.x",
            "disc_1.y",
            "disc_2.y",
        ]
        np.testing.assert_array_equal(moved.values, cases[-1].result.moved)
        held = stored["static_784_Nm_bearing_force"]  # a disc rests on its crank in proportion to its displacement
        first, second = scene.supports["disc_1"], scene.supports["disc_2"]
        stiff = [float(one) for one in (first.x, first.y, second.y)]
        np.testing.assert_allclose(held.values, moved.values * stiff, rtol=1e-12)


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ('[supports.disc_3]\ny = "2e8 N/m"', 'supports = "disc_3"'),
        ('[supports.disc_1]\nz = "2e8 N/m"', "supports.disc_1.z"),
        ("[supports.disc_1]", "must be given"),
        ('[supports.disc_1]\ny = "2e8 N*m"', "supports.disc_1.y"),
        ('[supports.disc_1]\ny = "0 N/m"', "at least 1 N/m"),
        ("[supports]\ndisc_1 = 3", "must be a section: [supports.disc_1]"),
    ],
)
def test_wrong_supports_are_refused_in_a_line(text, added, words):
    with pytest.raises(gj.GearjaxError) as caught:
        gj.loads(text.replace(SUPPORTS, "\n" + added + "\n"))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_not_done_with_supports_is_refused():
    with pytest.raises(gj.SceneError, match='clearance = "linear"'):
        gj.Scene(system(clearance="exact"), {}, compliance=LINEAR, supports={"disc_1": gj.Support(y=1e8)})
    with pytest.raises(gj.SceneError, match="use contact"):
        pair(contact=gj.SoftplusContact(1e-7))
    with pytest.raises(gj.SceneError, match=r"not positive definite \(smallest eigenvalue -1e-09"):
        pair(compliance=Sharing(shared=6e-9))
    heavy = pair(supports={}, inertia=gj.EquivalentMass(1.0), load=gj.ConstantLoad())
    with pytest.raises(gj.SceneError, match="independent springs"):
        gj.simulate(heavy, np.linspace(0, 0.1, 11), 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_populations_are_the_analyses_one_by_one(name):
    """A stiffness of the supports varies too."""
    scene = dataclasses.replace(SCENES[name](), run=None)
    body, error = next(iter(scene.supports)), next(iter(scene.errors))
    varied = {f"supports.{body}.y": gj.Uniform(1e8, 4e8), f"errors.{error}.phase": gj.UniformPhase()}
    theta = jnp.linspace(0.0, 0.5, 41)
    population = gj.Tolerances(scene, varied)
    measures = gj.Measure.named("static.mean@20Nm"), gj.Measure.named("no_load.mean")
    work = Work(population, measures, number=6, theta=theta, extremes="samples")
    rows = work.inputs(0, 6)
    values, codes = work.evaluate(rows)
    assert not np.asarray(codes).any()
    for row, found in zip(np.asarray(rows), values, strict=True):
        again = population.with_values(jnp.asarray(row))
        assert found[0] == pytest.approx(float(gj.transmission_error(again, theta, 20.0).mean), rel=1e-9)
        assert found[1] == pytest.approx(float(gj.transmission_error(again, theta).mean), rel=1e-9, abs=1e-15)


@pytest.mark.slow
def test_a_stiffness_is_searched_for_like_any_other_number():
    """The mean TE is highest with the stiffest supports."""
    scene = dataclasses.replace(planets(), run=None)
    paths = [f"supports.planet_{i}.y" for i in (1, 2)]
    theta = np.linspace(0.0, 0.5, 41)
    search = {"where": paths, "bounds": dict.fromkeys(paths, (1e8, 4e8)), "starts": 2, "steps": 30}

    def loss(one: gj.Scene) -> Scalar:
        return -1e6 * gj.transmission_error(one, theta, 20.0).mean

    found = gj.minimise(loss, scene, theta=theta, **search)
    np.testing.assert_allclose(found.best, 4e8, rtol=1e-2)


@pytest.mark.slow
def test_the_command_runs(text, tmp_path, capsys):
    from tests.test_cli import command

    path = tmp_path / "supported.toml"
    path.write_text(text, encoding="utf-8")
    code, out, _ = command(capsys, "run", path, "--out", tmp_path / "out", "--json")
    assert code == 0
    assert json.loads(out)["cases"][-1]["metrics"]["mean_arcmin"] < -2.0
    assert command(capsys, "run", tmp_path / "out" / "results.nc", "--json")[0] == 0
