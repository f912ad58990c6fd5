"""Extremes between samples of gear sets whose every equilibrium takes long: what a population has is what each has."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.config.studies import loads_tolerance
from gearjax.results.tolerance import _missed
from gearjax.studies.select import numbers
from gearjax.tolerance import Work
from gearjax.tolerance.measures import Measures
from gearjax.units import um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, TEETH, scene_of

HELICAL = ROOT / "configs" / "helical" / "guo_2018_tolerance.toml"
KEY = "errors.pinion.amplitude"
KEY_OF_RV, SPREAD = "errors.gear_1.amplitude", '{kind = "rayleigh", scale = "6 um"}'
COUPLED = dataclasses.replace(TEETH, coupling_length=1.5)


def population(compliance):
    scene = scene_of(GUO_1, {"pinion": gj.Eccentricity("pinion", 5 * um, 0.4)}, compliance, slices=10)
    return scene, gj.Tolerances(scene, {KEY: gj.Uniform(2 * um, 9 * um)})


def peak_to_peak(scene, amplitude, theta, extremes):
    pinion = dataclasses.replace(scene.errors["pinion"], amplitude=jnp.asarray(amplitude))
    own = dataclasses.replace(scene, errors={"pinion": pinion})
    return float(gj.transmission_error(own, theta, torque=830.0, extremes=extremes).peak_to_peak)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
@pytest.mark.parametrize("compliance", [TEETH, COUPLED], ids=["slices", "coupled slices"])
def test_a_population_has_the_extremes_that_are_asked_for(compliance):
    scene, tolerances = population(compliance)
    theta = np.linspace(0.0, 2 * np.pi / 19, 13)
    measure = gj.Measure("static", "peak_to_peak", torque=830.0)
    inputs = Work(tolerances, [measure], number=3, seed=0, theta=theta).inputs(0, 3)
    found = {}
    for extremes in (None, "samples", "between"):
        study = gj.monte_carlo(tolerances, [measure], n=3, key=0, theta=theta, extremes=extremes)
        found[extremes] = study.column(measure.name)
        own = [peak_to_peak(scene, row[0], theta, extremes) for row in np.asarray(inputs)]
        np.testing.assert_allclose(found[extremes], own, rtol=1e-9)
    np.testing.assert_array_equal(found[None], found["samples"])
    assert (found["between"] > (1 + 1e-4) * found["samples"]).all()


@pytest.mark.parametrize(("word", "chosen"), [(None, "samples"), ('"between"', "between"), ('"samples"', "samples")])
def test_the_default_of_a_section_is_that_of_the_analysis(word, chosen):
    given = "" if word is None else f"extremes = {word}"
    text = HELICAL.read_text(encoding="utf-8").replace('extremes = "samples"', given)
    assert loads_tolerance(text, HELICAL.parent)[2].extremes == chosen


@pytest.mark.slow
def test_springs_known_at_the_samples_give_the_extremes_of_samples_alone():
    """Coupled teeth: their matrices are worked out once for a population, but at the samples only."""
    scene = gj.load(ROOT / "configs" / "involute_rv" / "yang_2019.toml")
    path = next(name for name in numbers(scene) if name.startswith("errors."))
    tolerances = gj.Tolerances(scene, {path: gj.Uniform(1 * um, 2 * um)})
    for measure, extremes, known in (
        (gj.Measure("static", "peak_to_peak", torque=500.0), None, True),
        (gj.Measure("static", "peak_to_peak", torque=500.0), "between", False),
        (gj.Measure("no_load", "peak_to_peak"), None, False),
    ):
        measures = Measures([measure], tolerances, np.linspace(0.0, 0.1, 5), extremes)
        assert (measures.pressed is not None) == known
        assert (measures.together == 1) == (extremes == "between")
        assert measures.extremes == ("samples" if known else "between")


@pytest.mark.slow
def test_a_study_of_coupled_teeth_does_not_look_between_the_samples():
    """Its command would take minutes for one line; the study says that its extremes are those of the samples."""
    example = ROOT / "configs" / "involute_rv" / "yang_2019.toml"
    study = f'[tolerance]\nsamples = 8\nmeasures = ["static.peak_to_peak@100Nm"]\n"{KEY_OF_RV}" = {SPREAD}\n'
    section = loads_tolerance(example.read_text(encoding="utf-8") + study, example.parent)[2]
    assert section.extremes == "samples"
    work = Work(section.tolerances, section.measures, number=8, seed=0, theta=np.linspace(0.0, 0.1, 5))
    assert _missed(section, work) == {}
