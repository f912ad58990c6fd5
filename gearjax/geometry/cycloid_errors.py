"""Geometric transmission error of a cycloidal stage, by closed formulas for the contact with the longest lever.

The contributions to the error follow Hu, Li, Zhu and Cui (2020), eqs. 5-17. They are derived from the gaps of the two
contacts whose lever is the whole rolling radius (``cos u = K1``). The module also has their sensitivities (Table 2) and
the compensation model (eq. 27). Errors are lengths [m] by name, see `FACTORS`. Transmission errors are in rad, positive
if the output may lag.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from gearjax.checks import ParameterError, nearest
from gearjax.geometry.cycloid import Cycloid, touch
from gearjax.typing import Array, ArrayLike, Scalar

FACTORS = {
    "pin_circle": "radius of the circle of pin centres (eq. 7)",
    "pin_radius": "radius of the pins (eq. 8)",
    "groove_clearance": "clearance between a pin and its groove (eq. 9)",
    "run_out": "radial run-out F_r1 of the disc (eq. 10)",
    "pin_position": "circumferential position of the pins (eq. 11)",
    "isometric": "isometric modification of the profile (eqs. 5 and 13)",
    "shifting": "shifting modification of the profile (eqs. 6 and 13)",
    "cumulative_pitch": "cumulative pitch F_p of the disc (eq. 12)",
    "throw": "eccentricity of the crank (eq. 13)",
}
"""The errors of Table 2, in the order of that table."""


def geometric_error(disc: Cycloid, errors: Mapping[str, ArrayLike]) -> Scalar:
    """Lag of the output due to modification and errors: travel between both flanks [rad].

    It is the sum over both flanks of gap over lever of the contacts at ``cos u = K1``. The run-out counts on one flank
    only, because it closes one gap while it opens the other.

    Args:
        disc: the disc, including its modifications.
        errors: deviations by name, from `FACTORS` [m].

    Raises:
        ParameterError: the name of an error is unknown.
    """
    for name in errors:
        if name not in FACTORS:
            raise ParameterError("errors", name, nearest(name, FACTORS))
    zero = jnp.zeros_like(disc.throw)
    given = {name: jnp.asarray(errors.get(name, zero), disc.throw.dtype) for name in FACTORS}
    disc = disc._replace(
        isometric=disc.isometric + given["isometric"],
        shifting=disc.shifting + given["shifting"],
        throw=disc.throw + given["throw"],
    )
    # place of the longest lever; its displacement by the shifting has only a second-order effect
    short = disc._replace(shifting=jax.lax.stop_gradient(disc.shifting)).modified_short_width
    at = touch(short, jnp.arccos(short))
    gap = disc.isometric + (given["pin_circle"] - disc.shifting) * at.outward
    gap = gap - given["pin_radius"] + 0.5 * given["groove_clearance"] + 0.25 * given["run_out"]
    gap = gap + short * at.lever * (given["pin_position"] - 0.5 * given["cumulative_pitch"])
    return 2 * gap / (disc.rolling_radius * at.lever)


def printed_coefficients(disc: Cycloid) -> dict[str, Scalar]:
    """Error coefficients divided by ``1 / (a z_c)``, the diagonal of A (Hu et al. 2020, eq. 24).

    The coefficient of the throw is ``2 |k_n|`` in rad/mm, as printed in the paper.
    """
    short = disc.modified_short_width
    side = jnp.sqrt(1 - short * short)
    values = 2 * side, -2.0, 1.0, 0.5, 2 * short, 2.0, -2 * side, -short, 2 * printed_throw_coefficient(disc)
    return {name: jnp.asarray(value, disc.throw.dtype) for name, value in zip(FACTORS, values, strict=True)}


def printed_throw_coefficient(disc: Cycloid) -> Scalar:
    """Coefficient ``-|k_n|`` of Hu et al. (2020), eq. 14, in rad/mm, with the signs that give the printed number."""
    mm = 1e-3
    throw, circle = disc.throw / mm, disc.pin_circle / mm
    isometric, shifting, teeth = disc.isometric / mm, disc.shifting / mm, disc.teeth
    side = jnp.sqrt(1 - disc.modified_short_width**2)
    first = isometric / (throw * throw * teeth)
    second = teeth * shifting / (throw * circle * circle * side)
    return -jnp.abs(first - second + shifting * side / (throw * throw * teeth))


def coefficients(disc: Cycloid) -> dict[str, Scalar]:
    """Error coefficients divided by ``1 / (a z_c)``, from the derivatives of `geometric_error` [-]."""
    zeros = dict.fromkeys(FACTORS, jnp.zeros_like(disc.throw))
    slopes = jax.grad(lambda errors: geometric_error(disc, errors))(zeros)
    return {name: slope * disc.rolling_radius for name, slope in slopes.items()}


def sensitivity_indices(disc: Cycloid) -> dict[str, Scalar]:
    """Error coefficients divided by the coefficient of the pin circle's radius (Hu et al. 2020, eq. 22) [-]."""
    by_error = coefficients(disc)
    return {name: value / by_error["pin_circle"] for name, value in by_error.items()}


def mean_and_tolerance(
    disc: Cycloid, means: Mapping[str, ArrayLike], tolerances: Mapping[str, ArrayLike]
) -> tuple[Scalar, Scalar]:
    """Mean geometric error and its tolerance (Hu et al. 2020, eqs. 15-17) [rad].

    The mean is the sum of the contributions, the tolerance the root of the sum of their squares.
    """
    slopes = coefficients(disc)
    mean = geometric_error(disc, means)
    parts = [slopes[name] / disc.rolling_radius * jnp.asarray(size) for name, size in tolerances.items()]
    return mean, jnp.sqrt(sum((part * part for part in parts), jnp.zeros_like(mean)))


def compensation(disc: Cycloid, shares: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Deviations that compensate parts of a transmission error (Hu et al. 2020, eq. 27) [m].

    Args:
        disc: the disc.
        shares: transmission error that each factor is to compensate, by name [rad].
    """
    slopes = coefficients(disc)
    return {name: -jnp.asarray(share) * disc.rolling_radius / slopes[name] for name, share in shares.items()}
