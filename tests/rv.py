"""The RV reducer of Hu et al. (2020) as an independent study of the paper has it: designs, errors, and its results."""

import dataclasses

import numpy as np

import gearjax as gj
from gearjax.units import mm, um

TORQUE = 784.0
DESIGNS = {  # shifting and isometric modification, change of the pin radius [um]
    "conjugate": (0.0, 0.0, 0.0),
    "initial": (-43.7, -22.0, 0.0),
    "modified": (-26.6, -22.0, 0.0),
    "modified, smaller pin": (-26.6, -22.0, -27.9),
}
LINEAR = gj.HarmonicStiffness(1.6465e8, [], [])
HU = gj.HuLineContact(2.06e11, 0.3, 11 * mm)
HERTZ = gj.HertzLineContact(2.06e11, 0.3, 11 * mm)
PLACES = 2 * np.pi * np.arange(40) / 40


def system(design: str = "initial", discs: int = 2, **changes) -> gj.RVCycloidal:
    shifting, isometric, _ = DESIGNS[design]
    given = {
        "pins": 40,
        "pin_circle": 76 * mm,
        "pin_radius": 3 * mm,
        "eccentricity": 1.5 * mm,
        "isometric_modification": isometric * um,
        "shifting_modification": shifting * um,
        "input_speed": 120.0,
        "discs": discs,
    }
    return gj.RVCycloidal(**{**given, **changes})


def errors(discs: int = 2) -> dict:
    """Error set H of the study."""
    outward = 1.5 * np.cos(PLACES) + np.cos(3 * PLACES + 0.5)
    around = 2 * np.sin(PLACES + 0.3) + np.sin(5 * PLACES + 1)
    found = {
        "pins": gj.Positions("pin_ring", um * outward, um * around),
        "throw": gj.Eccentricity("throw", 2.5 * um, 0.0),
    }
    for disc in range(1, discs + 1):
        found[f"run_out_{disc}"] = gj.Eccentricity(f"disc_{disc}", 2 * um, 0.0)
        found[f"pitch_{disc}"] = gj.CumulativePitch(f"disc_{disc}", 2.5 * um, 0.0)
    return found


def scene(design: str = "initial", discs: int = 2, *, with_errors: bool = False, compliance=LINEAR, **changes):
    smaller = DESIGNS[design][2]
    listed = errors(discs) if with_errors else {}
    if smaller:
        listed["size"] = gj.Sizes("pin_ring", [smaller * um])
    return gj.Scene(system(design, discs, **changes), listed, compliance=compliance)


def angles(turns: int = 1, per_turn: int = 320) -> np.ndarray:
    """Crank angles of whole turns."""
    return np.arange(per_turn * turns) * (2 * np.pi / per_turn)


def share(discs: int) -> float:
    """Torque of the study on one disc or two."""
    return TORQUE * (0.55 if discs == 1 else 1.0)


def with_errors(scene: gj.Scene, **listed) -> gj.Scene:
    return dataclasses.replace(scene, errors={**scene.errors, **listed})


@dataclasses.dataclass(frozen=True)
class Accepted:
    """Results of the study: angles in arcmin, force in N; of interfering designs no unloaded peak-to-peak."""

    design: str
    with_errors: bool
    discs: int
    law: str
    peak_to_peak: float
    mean: float
    unloaded: float | None
    backlash: tuple[float, float]
    force: float
    engaged: tuple[int, int]


ACCEPTED = (
    Accepted("conjugate", False, 1, "linear", 0.000548013, 0.263075, 0.0, (0.0, 0.0), 737.846, (19, 20)),
    Accepted("initial", False, 1, "linear", 0.00905685, 0.824554, 0.0081549, (0.569966, 0.572763), 1517.14, (7, 8)),
    Accepted("modified", False, 1, "linear", 0.00245789, 0.164744, None, (-0.665401, -0.66419), 1395.6, (18, 20)),
    Accepted(
        "modified, smaller pin", False, 1, "linear", 0.00764075, 1.85469, 0.0081725, (2.61549, 2.6183), 1532.46, (7, 8)
    ),
    Accepted("initial", False, 2, "linear", 0.00636968, 0.789559, 0.0081549, (0.569966, 0.572763), 1414.38, (14, 16)),
    Accepted("conjugate", False, 1, "line", 0.00230257, 0.249655, 0.0, (0.0, 0.0), 748.221, (19, 20)),
    Accepted("initial", False, 1, "line", 0.00443153, 0.800062, 0.0081549, (0.569966, 0.572763), 1508.64, (7, 8)),
    Accepted("initial", False, 2, "line", 0.00541193, 0.768021, 0.0081549, (0.569966, 0.572763), 1405.32, (14, 16)),
    Accepted("initial", True, 1, "linear", 0.341054, 0.838376, 0.420777, (0.209381, 0.553852), 1795.01, (6, 9)),
    Accepted("modified", True, 1, "linear", 0.16606, 0.188613, None, (-2.09471, -0.718013), 2018.11, (8, 23)),
    Accepted(
        "modified, smaller pin", True, 1, "linear", 0.343058, 1.86824, 0.420772, (2.25508, 2.59952), 1815.0, (6, 9)
    ),
    Accepted("initial", True, 2, "linear", 0.0326816, 0.79994, 0.216528, (0.209381, 0.386529), 2036.2, (13, 16)),
    Accepted("modified", True, 2, "linear", 0.0374948, 0.168869, None, (-2.09471, -0.895764), 2031.3, (26, 40)),
    Accepted(
        "modified, smaller pin", True, 2, "linear", 0.0322031, 1.82917, 0.21661, (2.25508, 2.43219), 2055.47, (12, 16)
    ),
    Accepted("initial", True, 1, "line", 0.341095, 0.811278, 0.420777, (0.209381, 0.553852), 1882.69, (6, 9)),
    Accepted("initial", True, 2, "line", 0.0315236, 0.775306, 0.216528, (0.209381, 0.386529), 2142.96, (12, 16)),
)
