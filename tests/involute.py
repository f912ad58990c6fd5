"""The reducer of Yang, Tang and Liang (2019) for tests, its gears as curves, and where its pairs stand."""

import jax.numpy as jnp
import numpy as np

import gearjax as gj
from gearjax.units import deg, mm
from tests.internal_gears import Curves

FIRST = {"sun_teeth": 22, "planet_teeth": 60, "first_stage_module": 1.25 * mm}
STEEL = {"youngs_modulus": 2.06e11, "poissons_ratio": 0.3, "external_width": 6.5 * mm, "internal_width": 14 * mm}


def system(**changes) -> gj.InvoluteRV:
    """That of Yang, Tang and Liang (2019), Table 1."""
    numbers = {
        "external_teeth": 236,
        "internal_teeth": 240,
        "module": 0.58 * mm,
        "pressure_angle": 20 * deg,
        "external_shift": -0.4,
        "internal_shift": 0.55028,
        "external_addendum": 0.6328,
        "internal_addendum": 1.0,
        "centre_distance": 1.5 * mm,
        "input_speed": 92.7,
    }
    return gj.InvoluteRV(**(numbers | changes))


_drawn: dict[int, tuple[gj.InvoluteRV, Curves]] = {}


def curves_of(own: gj.InvoluteRV) -> Curves:
    """The gears of a system as curves, worked out once: their numbers are arrays, which take longer than the gaps."""
    if id(own) not in _drawn:
        _drawn[id(own)] = own, Curves(own.pair)
    return _drawn[id(own)][1]


def angle_of(own: gj.InvoluteRV, share: float) -> float:
    """Input angle at which a pair stands at a share of its path of contact [rad]."""
    begin, end = own.pair.path
    space = float(own.pair.space_of_roll(begin + share * (end - begin)))
    return (-space % (2 * np.pi / own.internal_teeth)) / own.orders["crank"]


def per_pair(own: gj.InvoluteRV, theta: float, forces) -> np.ndarray:
    """Loads of the pairs by falling tooth number, those of the paper rising."""
    tooth = np.asarray(own.candidates(jnp.asarray(theta), False).tooth[0])
    return np.asarray(forces).reshape(own.pairs, -1).sum(axis=1)[np.argsort(-tooth)]
