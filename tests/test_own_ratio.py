"""Non-circular gears with a ratio function of one's own: against a table of its values, and refusals in one line."""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.geometry.noncircular import AbstractRatio
from gearjax.typing import Array, Scalar
from gearjax.units import arcmin, deg, mm, um


class Waves(AbstractRatio):
    """A ratio with two waves, and what may be wrong with it."""

    first: Array
    second: Array
    offset: float = eqx.field(static=True, default=0.0)
    mean: float = eqx.field(static=True, default=1.0)
    wrong: str = eqx.field(static=True, default="")
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    def driven_angle(self, t):
        if self.wrong == "numpy":
            return t + 0.3 * np.sin(t)
        if self.wrong == "shape":
            return jnp.sum(t)
        if self.wrong == "whole":
            return jnp.floor(t).astype(int)
        if self.wrong == "complex":
            return jax.lax.complex(t, t)
        return self.mean * t + self.first * jnp.sin(t) + self.second * (1 - jnp.cos(2 * t)) + self.offset

    def rates(self, t):
        ratio, slope, bent = super().rates(t)
        return (1.1 * ratio if self.wrong == "rates" else ratio), slope, bent


class OwnPair(gj.AbstractNoncircularPair):
    """Gears with that ratio."""

    kind: ClassVar[str] = "own_pair"
    function: Waves
    teeth: int = eqx.field(static=True, default=48)
    module: Scalar = eqx.field(default_factory=lambda: jnp.asarray(3 * mm))
    pressure_angle: Scalar = eqx.field(default_factory=lambda: jnp.asarray(20 * deg))
    addendum: Scalar = eqx.field(default_factory=lambda: jnp.asarray(1.0))
    input_speed: Scalar = eqx.field(default_factory=lambda: jnp.asarray(10.0))
    centre_distance: Scalar | None = None
    centre_distance_error: Scalar | None = None
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)
    clearance: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        self._check()

    @property
    def ratio_function(self):
        return self.function


def own(first=0.3, second=0.05, lobes=1, **changes):
    function = Waves(jnp.asarray(first), jnp.asarray(second), **changes)
    return OwnPair(function, driver_lobes=lobes, driven_lobes=lobes)


def te(system):
    errors = {"driver": gj.Eccentricity("driver", 30 * um, 0.3), "driven": gj.Eccentricity("driven", 20 * um, 0.8)}
    return gj.transmission_error(gj.Scene(system, errors), jnp.linspace(0.0, 2 * math.pi, 181))


def test_a_function_is_as_the_table_of_its_values():
    t = 2 * math.pi * np.arange(128) / 128
    table = gj.NoncircularPair(48, 3 * mm, 1 + 0.3 * np.cos(t) + 0.1 * np.sin(2 * t), 10.0)
    np.testing.assert_allclose(te(own()).te, te(table).te, rtol=0, atol=1e-7 * arcmin)


def test_a_function_may_be_traced():
    slope = jax.jit(jax.grad(lambda first: te(own(first)).peak_to_peak))(0.3)
    difference = (te(own(0.3 + 1e-5)).peak_to_peak - te(own(0.3 - 1e-5)).peak_to_peak) / 2e-5
    assert slope == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mean": 1.1}, r"stays open: .* turns by 6\.9115038 rad, must be 2 pi / driven_lobes = 6\.2831853"),
        ({"mean": 0.5}, "stays open"),
        ({"offset": 0.2}, r"driven_angle\(0\) is 0\.2 rad, must be 0"),
        ({"first": 1.2}, "the ratio is -0.* must be above 0 everywhere"),
        ({"first": math.nan}, "is not finite"),
        ({"lobes": 2}, "has 1 and 1 lobes, the gear set has 2 and 2"),
        ({"lobes": 2, "driver_lobes": 2, "driven_lobes": 2}, "one lobe later by 0.*, must repeat"),
        ({"wrong": "rates"}, "rates gives another ratio than the slope of driven_angle"),
        ({"wrong": "numpy"}, r"must be made of functions of jax\.numpy"),
        ({"wrong": "shape"}, "must return real numbers, an array of the shape of its angles"),
        ({"wrong": "whole"}, "must return real numbers"),
        ({"wrong": "complex"}, "must return real numbers"),
        ({"first": 1.0001, "second": 0.0}, "the ratio is -0.0001 at 180 deg, must be above 0 everywhere"),
    ],
)
def test_functions_that_are_no_ratios_are_refused(changes, words):
    with pytest.raises(gj.ParameterError, match=words) as caught:
        own(**changes)
    assert "\n" not in str(caught.value)
