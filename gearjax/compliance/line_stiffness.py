"""Contact lines as uniform rows of springs, with a given stiffness per length or the mesh stiffness of ISO 6336."""

from typing import ClassVar

import jax.numpy as jnp

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.compliance.base import AbstractSliceCompliance
from gearjax.compliance.iso6336 import LOW_LOAD, stiffness_of
from gearjax.contact import LinearSprings, Slices
from gearjax.geometry.helical_checks import longer_contact
from gearjax.parameters import check_parameters, number
from gearjax.typing import Number


class LineStiffness(AbstractSliceCompliance):
    """Constant stiffness per length of the contact lines, along the normal of the flanks.

    Args:
        per_length: stiffness per length of contact line, along the normal of the flanks [N/m per m].
    """

    kind: ClassVar[str] = "line_stiffness"
    per_length: Number = number(units.LINE_STIFFNESS, at_least=1e3, at_most=1e15, example="14 N/mm/um")

    def __check_init__(self):
        check_parameters(self)

    def springs(self, slices: Slices) -> LinearSprings:
        return LinearSprings(self.per_length * slices.lengths)


class Iso6336Teeth(AbstractSliceCompliance):
    """Mesh stiffness by ISO 6336-1, method B (`iso6336_stiffness`), distributed uniformly along the contact lines.

    The mean length of the contact lines, ``b eps_alpha / cos beta_b``, has the stiffness
    ``c_gamma_alpha b / cos^2 beta_b`` along the normal of the flanks.

    Args:
        blank_factor: gear blank factor ``C_R``, 1 for solid discs [-].
        load_per_width: load per face width ``F_t K_A / b`` [N/m]; without it, a load of 100 N/mm or more is assumed,
            where the stiffness does not depend on the load.
        low_load_exponent: exponent of the load below 100 N/mm [-].
    """

    kind: ClassVar[str] = "iso_6336"
    blank_factor: Number = number(units.RATIO, at_least=0.1, at_most=1.5, default=1.0)
    load_per_width: Number | None = number(units.LINE_LOAD, at_least=1e3, at_most=1e9, default=None, example="150 N/mm")
    low_load_exponent: Number = number(units.RATIO, at_least=0.0, at_most=2.0, default=LOW_LOAD)

    def __check_init__(self):
        check_parameters(self)

    def springs(self, slices: Slices) -> LinearSprings:
        pair = slices.pair
        iso = stiffness_of(pair, self.blank_factor, self.load_per_width, self.low_load_exponent)
        per_length = iso.mesh_alpha / (iso.transverse_contact_ratio * jnp.cos(pair.base_helix_angle))
        return LinearSprings(per_length * slices.lengths)

    def check(self, slices: Slices) -> None:
        ratio = float(slices.pair.transverse_contact_ratio)
        if ratio < 1:
            words = f"is for transverse contact ratios of 1 and more, not {ratio:.4g}: {longer_contact(slices.pair)}"
            raise ParameterError("compliance.kind", self.kind, words)
