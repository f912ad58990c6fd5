"""What public functions are given and cannot use is refused in one line, by name, before anything is computed."""

import dataclasses
import inspect
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy import stats

import gearjax as gj
from gearjax import arguments
from gearjax.checks import one_angle

THETA = np.linspace(0.0, 3.0, 31)
PHASE = "errors.planet_1.phase"
AMPLITUDE = "errors.planet_1.amplitude"
OTHERS = {  # arguments that a function needs besides those that are tried
    "theta": THETA,
    "ts": np.linspace(0.0, 0.01, 11),
    "torque": 100.0,
    "torques": [10.0, 20.0],
    "rated_torque": 100.0,
    "te": None,
    "result": None,
    "period": 0.1,
    "speeds": [10.0, 20.0],
    "loss": "no_load_amplitude",
    "where": [PHASE],
    "step": 0.1,
    "bounds": {},
    "distributions": {},
    "body": "planet_1",
    "measured": gj.Measurement(THETA, te=1e-4 * THETA),
    "folder": Path(tempfile.gettempdir()) / "gearjax_joint",
}
FUNCTIONS = {name: f for name in gj.__all__ if inspect.isfunction(f := getattr(gj, name))}
PUBLIC = {"Tolerances": gj.Tolerances, **FUNCTIONS}
OF_A_SCENE = {name: f for name, f in PUBLIC.items() if "scene" in inspect.signature(f).parameters}


@pytest.fixture(autouse=True)
def _as_users_have_it():
    """Types are looked at by tests alone: what users see is what gearjax itself refuses."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def taking(argument: str) -> list[str]:
    """Public functions of a scene that have an argument."""
    return [name for name, f in OF_A_SCENE.items() if argument in inspect.signature(f).parameters]


def call(name: str, scene, **given):
    """A public function with good arguments, but for those that are given."""
    function = OF_A_SCENE[name]
    needed = {
        key: OTHERS[key]
        for key, parameter in inspect.signature(function).parameters.items()
        if parameter.default is inspect.Parameter.empty and key != "scene"
    }
    return function(**{"scene": scene, **needed, **given})


def refuses(words: str, function, *args, **given) -> None:
    """One line of gearjax, and no warning of anybody else."""
    with pytest.raises(gj.GearjaxError, match=words) as caught:
        function(*args, **given)
    assert "\n" not in str(caught.value)


def test_all_functions_of_a_scene_are_looked_at():
    assert len(OF_A_SCENE) >= 14
    assert {"transmission_error", "simulate", "minimise", "compensate", "Tolerances", "shooting"} <= set(OF_A_SCENE)


@pytest.mark.parametrize("wrong", ["configs/two_kv/wang_2020.toml", gj.units, None, 3.0])
@pytest.mark.parametrize("name", sorted(OF_A_SCENE))
def test_what_is_no_scene_is_refused(name, wrong):
    words = r"is a path: give gj\.load\(path\)" if isinstance(wrong, str) else "must be a Scene"
    refuses(f"scene = .*: {words}", call, name, wrong)


WRONG_ANGLES = {
    "not finite": ([0.0, np.nan, 1.0], r"\[1\] = nan: must be finite"),
    "infinite": ([0.0, 1.0, np.inf], r"\[2\] = inf: must be finite"),
    "text": (["a", "b"], "must be a real number"),
    "words": ("0 to 10", "must be a real number"),
    "complex": (THETA + 1j, "must be a real number"),
    "truth": ([False, True], "must be a real number"),
    "ragged": ([[1.0, 2.0], [3.0]], "must be a real number"),
    "empty": ([], "has shape"),
    "rows": (np.ones((3, 2)), "has shape"),
    "one number": (1.0, "has shape"),
    "falling": ([1.0, 0.5], "must increase"),
    "equal": ([1.0, 1.0], "must increase"),
}


@pytest.mark.parametrize("kind", WRONG_ANGLES)
@pytest.mark.parametrize("name", sorted({*taking("theta"), *taking("ts")}))
def test_angles_and_times_that_cannot_be(scene, name, kind):
    argument = "theta" if name in taking("theta") else "ts"
    wrong, words = WRONG_ANGLES[kind]
    refuses(f"{argument}.*{words}", call, name, scene, **{argument: wrong})


@pytest.mark.parametrize("wrong", [np.nan, np.inf, "100 N*m", 1j, 1e300, True])
@pytest.mark.parametrize("name", sorted({*taking("torque"), *taking("rated_torque")}))
def test_torques_that_cannot_be(scene, name, wrong):
    argument = "torque" if name in taking("torque") else "rated_torque"
    refuses(f"{argument} = .*must be", call, name, scene, **{argument: wrong})


def test_shapes_of_one_number(scene):
    refuses(r"torque = \(3,\): is a shape: must be one number", gj.simulate, scene, OTHERS["ts"], np.ones(3))
    refuses(r"torques\[1\] = nan", gj.torsion, scene, THETA, [1.0, np.nan])


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("simulate", {"settle": np.nan}, "settle = nan: must be finite"),
        ("simulate", {"stepper": 1e-5}, "stepper = 1e-05: must be FixedStep"),
        ("shooting", {"period": 0.0}, "period = 0: must be above 0"),
        ("shooting", {"steps": 8.5}, r"steps = 8\.5: must be a whole number"),
        ("shooting", {"guess": np.ones(3), "period": 15.8}, r"guess = \(3,\): is a shape"),
        ("harmonic_balance", {"harmonics": 0}, "harmonics = 0: must be at least 1"),
        ("fourier_series", {"static": 3.0}, "static = 3.0: must be a scene"),
        ("speed_sweep", {"speeds": [-1.0]}, "speeds = -1: must be above 0"),
        ("speed_sweep", {"speeds": []}, r"speeds = \(0,\): is a shape"),
        ("speed_sweep", {"order": "crnk"}, 'order = "crnk": did you mean "crank"'),
        ("waterfall", {"order": "crnk"}, 'order = "crnk": did you mean "crank"'),
        ("waterfall", {"steps": 24, "harmonics": 8}, "at least 32 for these harmonics"),
        ("speed_sweep", {"steps": 100}, "multiple of 8"),
        ("minimise", {"loss": 3.0}, "loss = 3.0: must be a name"),
        ("minimise", {"loss": [1.0]}, "loss = .*: must be a name"),
        ("minimise", {"where": 3}, "where = 3: must be paths"),
        ("minimise", {"where": [["x"]]}, "where = .*: must be paths"),
        ("minimise", {"starts": 2.5}, r"starts = 2\.5: must be a whole number"),
        ("minimise", {"starts": [["a"]]}, "starts = .*: must be a real number"),
        ("minimise", {"bounds": [1.0]}, "bounds = .*: must be pairs by path"),
        ("minimise", {"bounds": {PHASE: "all"}}, "bounds of errors.planet_1.phase = .*pair of numbers"),
        ("grid_search", {"step": "10 deg"}, 'step = "10 deg": must be a real number'),
        ("grid_search", {"step": {PHASE: np.nan}}, "step of errors.planet_1.phase = nan: must be finite"),
        ("local_sensitivity", {"at": ["a"]}, "at = .*: must be a real number"),
        ("local_sensitivity", {"deviations": ()}, "deviations = .*: must be at least one"),
        ("minimise", {"key": -1}, "key = -1"),
        ("minimise", {"temperatures": (0.1, -1.0)}, "temperatures = .*: must be above 0, two numbers"),
        ("minimise", {"where": [PHASE + "s"], "bounds": {PHASE: (0.0, 1.0)}}, "where = .*phases.*: is no number"),
        ("grid_search", {"step": 2 * np.pi / 6e12}, r"gives 6e\+12 levels, more than 1e\+08"),
        ("contact_pressure", {"te": THETA}, "te = .*: must be a result of transmission_error"),
        ("meshing_impact", {"torque": -1.0}, "torque = -1: must be above 0"),
        ("meshing_impact", {"torque": 1.0, "stiffness": "hard"}, "stiffness = .*: must be a real number"),
        ("face_load", {"result": THETA}, "result = .*: must be a result of transmission_error or simulate"),
        ("bearing_forces", {"result": THETA}, "result = .*: must be a result of transmission_error or simulate"),
        ("Tolerances", {"distributions": {AMPLITUDE: stats.norm(1e-5, 1e-6)}}, "rv_continuous_frozen.*is of scipy"),
        ("Tolerances", {"distributions": {AMPLITUDE: 1e-5}}, r"amplitude = 1e-05: must be a distribution"),
        ("Tolerances", {"distributions": [AMPLITUDE]}, "distributions = .*: must be by path"),
    ],
)
def test_other_arguments(scene, name, given, words):
    refuses(words, call, name, scene, **given)


@pytest.mark.parametrize("order", [0, -1.0, np.nan, 1e300, [1.0, 2.0]])
def test_orders_that_cannot_be(scene, order):
    refuses("order = ", lambda: gj.minimise(gj.Term("no_load_order", order=order), scene, where=[PHASE], starts=1))


def test_orders_beyond_what_the_angles_tell(scene):
    few = np.linspace(0.0, scene.system.cycle, 801)  # some ten for each of its 79 turns
    refuses("order = 401.0: there are too few input angles: they resolve at most 400", gj.minimise,
            gj.Term("no_load_order", order=401.0), scene, where=[PHASE], theta=few)  # fmt: skip


@pytest.mark.parametrize("turn", [0.0, -1.0, np.nan, 1e300, "output"])
def test_turns_of_a_spectrum(turn):
    theta = np.linspace(0.0, 6.0, 64)
    refuses("turn = ", gj.order_spectrum, np.sin(theta), theta, turn=turn)
    refuses(r"values\[0\] = nan", gj.order_spectrum, np.full(64, np.nan), theta)


def test_populations(scene):
    for function, given in (
        (gj.sensitivities, {"measure": "no_load.std"}),
        (gj.matched_assembly, {"measure": "no_load.std", "where": (PHASE,)}),
        (gj.allocate, {"measure": gj.Measure("no_load", "std", limit=1.0), "required": 0.9, "costs": {}}),
    ):
        refuses("tolerances = .*: must be Tolerances", function, scene, **given)
    for sample in ("configs/two_kv/wang_2020.toml", scene):
        refuses("sample = .*: must be Tolerances", gj.monte_carlo, sample, "no_load.std")
    own = gj.Tolerances(scene, {AMPLITUDE: gj.Rayleigh(1e-6)})
    refuses(r"n = 2\.5: must be a whole number", gj.monte_carlo, own, "no_load.std", n=2.5)
    refuses(r"measure = 3\.0: must be a name", gj.monte_carlo, own, [3.0])
    refuses("theta must increase", gj.monte_carlo, own, "no_load.std", theta=[1.0, 0.0])
    refuses(r"devices = \[\]: is empty", gj.monte_carlo, own, "no_load.std", devices=[], theta=[0.0, 1.0])
    for result, words in (
        (lambda _: None, '"None"'),
        (lambda _: np.zeros(3), r'"array of shape \(3,\)"'),
        (lambda _: {"one": np.zeros(2)}, "must be one real number, 'one' too"),
        (lambda _: "text", 'measure = "str"'),
        (lambda _: {"one": "text"}, "must be one real number, 'one' too"),
    ):
        refuses(words, gj.monte_carlo, own, result, n=4)
    refuses('loss = "array of shape', gj.minimise, lambda _: jnp.ones(2), scene, where=PHASE)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (lambda: gj.Eccentricity("planet_1", np.nan, 0.0), "amplitude = nan"),
        (lambda: gj.Eccentricity("planet_1", "10 um", 0.0), 'amplitude = "10 um": must be a number, in SI'),
        (lambda: gj.TipRelief("gear_1", [[1e-6, 2e-6]], 1e-3), "amount = .*: must be a list of numbers, not of lists"),
        (lambda: gj.HarmonicStiffness(1e8, [[0.1]], [0.1]), "relative_amplitudes = .*: must be a list of numbers, not"),
        (lambda: gj.InitialBacklash(1j), "initial = 1j: must be a number, in SI"),
        (
            lambda: gj.Eccentricity("driver", np.array([1e-6, 2e-6]), 0.0),
            r"amplitude = .*: has shape \(2,\), must be one",
        ),
        (
            lambda: gj.EllipticPair(47, 3e-3, np.array([0.1, 0.2]), 10.0),
            r"eccentricity = .*: has shape \(2,\), must be one number",
        ),
        (lambda: gj.FixedStep("1 us"), 'step = "1 us": must be a number of seconds, such as 1e-6'),
        (lambda: gj.AdaptiveStep(None), "rtol = None: must be a tolerance, such as 1e-8"),
        (lambda: gj.Normal("1 um", 1e-6), 'mean = "1 um": must be a number'),
        (lambda: gj.Normal(0.0, None), "std = None: must be a number"),
        (lambda: gj.Measure("no_load", "std", limit=np.nan), "limit = nan"),
        (lambda: gj.Measure("static", "std", torque="100"), 'torque = "100"'),
        (lambda: gj.Term("static_std", torque=np.nan), "torque = nan"),
        (lambda: gj.Term("no_load_std", weight=np.inf), "weight = inf"),
        (lambda: gj.Run(np.nan, 10, ("no_load",)), "run.duration = nan"),
        (lambda: gj.Run("3 s", 10, ("no_load",)), 'run.duration = "3 s"'),
        (lambda: gj.Run(3.0, 1, ("no_load",)), "run.samples = 1"),
        (lambda: gj.Run(3.0, 10, ("no_laod",)), 'run.analyses = "no_laod": did you mean "no_load"'),
        (lambda: gj.Run(3.0, 10, ("static",), (np.inf,)), "run.torques"),
        (lambda: gj.Run(3.0, 10, ("dynamic",), (1.0,), settle=3.0), "run.settle = 3.0: must be below"),
        (lambda: gj.Scene("configs/two_kv/wang_2020.toml"), r"system = .*: is a path: give gj\.load\(path\)"),
        (lambda: gj.export_profile("disc.toml", "disc.dxf"), r"of = .*: is a path: give gj\.load\(path\)"),
    ],
)
def test_parts(part, words):
    refuses(words, part)


def test_unknown_names_are_those_of_python(scene):
    with pytest.raises(TypeError, match="unexpected keyword"):
        gj.transmission_error(scene, THETA, torqe=1.0)


@pytest.mark.parametrize("degrees", [np.arange(0.0, 361.0), np.linspace(0.0, 720.0, 145), np.arange(0, 40, 2)])
def test_degrees_are_warned_of(degrees):
    with pytest.warns(UserWarning, match=r"in radians: give degrees as theta \* gj\.units\.deg"):
        arguments.angles("theta", degrees)
    arguments.angles("theta", degrees * gj.units.deg)  # any warning would be an error


def test_degrees_given_to_a_function_are_warned_of(scene):
    with pytest.warns(UserWarning, match="in radians"):
        gj.transmission_error(scene, np.arange(0.0, 31.0))


def test_whole_radians_of_a_turn_are_not():
    arguments.angles("theta", np.arange(12.0))
    arguments.angles("theta", [5.0])


def test_traced_values_pass(scene):
    te = jax.jit(lambda theta, torque: gj.transmission_error(scene, theta, torque).te)(jnp.asarray(THETA), 100.0)
    np.testing.assert_allclose(te, gj.transmission_error(scene, THETA, 100.0).te, rtol=1e-12)
    with pytest.raises(gj.ParameterError, match=r"theta = .*real number"):
        jax.jit(lambda theta: gj.transmission_error(scene, theta).te)(THETA + 1j)


@pytest.mark.slow
def test_named_measures_of_scenes_that_a_function_draws(scene):
    """The same as a function that measures, and as a population that draws the same numbers."""

    def sample(key):
        size = 1e-5 * (1 + jax.random.uniform(key, dtype=float))
        wheel = dataclasses.replace(scene.errors["planet_1"], amplitude=size)
        return dataclasses.replace(scene, errors={**scene.errors, "planet_1": wheel})

    theta = np.linspace(0.0, scene.system.cycle, 201)
    named = gj.monte_carlo(sample, ["no_load.peak_to_peak", "static.mean@100Nm"], n=20, theta=theta)
    ours = gj.monte_carlo(sample, lambda s: gj.transmission_error(s, jnp.asarray(theta)).peak_to_peak, n=20)
    np.testing.assert_allclose(named.column("no_load.peak_to_peak"), ours.values[:, 0], rtol=1e-9)
    assert named.names == ("no_load.peak_to_peak", "static.mean@100Nm")
    assert not named.failed.size
    assert (named.column("static.mean@100Nm") < -1e-4).all()
    limited = gj.monte_carlo(sample, gj.Measure("no_load", "peak_to_peak", limit=1.0), n=20, theta=theta)
    assert limited.share_within("no_load.peak_to_peak").value == 1.0


def test_named_measures_of_something_else():
    words = r'measure = "no_load.std": is for a scene, but sample returns a \w+: give a function of it'
    refuses(words, gj.monte_carlo, lambda key: jax.random.uniform(key), "no_load.std")


def test_a_truncated_normal_takes_std():
    ours = gj.TruncatedNormal(1.5e-4, 5e-6, 1.35e-4, 1.65e-4)
    assert ours == gj.TruncatedNormal(mean=1.5e-4, std=5e-6, low=1.35e-4, high=1.65e-4)
    assert ours == gj.TruncatedNormal(mean=1.5e-4, scale=5e-6, low=1.35e-4, high=1.65e-4)  # as it was named before
    refuses("scale = 5e-06: is the former name of std", gj.TruncatedNormal, mean=1.5e-4, std=5e-6, scale=5e-6,
            low=1.35e-4, high=1.65e-4)  # fmt: skip


@pytest.mark.parametrize("wrong", ["0.3", b"0.3", None, [0.1, 0.2], {"theta": 0.3}, np.inf])
def test_one_angle_is_a_finite_number(wrong):
    with pytest.raises(gj.ParameterError, match=r"^theta = .*: must be one finite angle in rad$"):
        one_angle("theta", wrong, jnp.float64)


@pytest.mark.parametrize("right", [1, 1.0, np.float32(1.0), np.array(1), jnp.asarray(1)])
def test_one_angle_has_the_precision_of_its_scene(right):
    angle = one_angle("theta", right, jnp.float64)
    assert angle.dtype == jnp.float64
    assert float(angle) == 1.0
