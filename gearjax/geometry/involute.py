"""Involute gears: base circles and centre distance."""

import jax.numpy as jnp

from gearjax.typing import Scalar


def base_radius(teeth: int | float, module: Scalar, pressure_angle: Scalar) -> Scalar:
    """Base circle radius ``r_b = z m cos(alpha) / 2`` (ISO 21771).

    Args:
        teeth: number of teeth.
        module: module [m].
        pressure_angle: pressure angle of the cutting rack [rad].

    Returns:
        The radius [m].
    """
    return 0.5 * teeth * module * jnp.cos(pressure_angle)


def internal_centre_distance(
    teeth_difference: int, module: Scalar, cutting_angle: Scalar, working_angle: Scalar
) -> Scalar:
    """Working centre distance of an internal pair, ``a cos(alpha_w) = m (z_2 - z_1) cos(alpha) / 2`` (ISO 21771).

    Args:
        teeth_difference: ring teeth minus planet teeth.
        module: module [m].
        cutting_angle: pressure angle of the cutting rack [rad].
        working_angle: working pressure angle [rad].

    Returns:
        The centre distance [m].
    """
    return 0.5 * teeth_difference * module * jnp.cos(cutting_angle) / jnp.cos(working_angle)
