"""Remarks on a fit: what it does not explain, what the recordings lack, and numbers that cannot be true."""

import math

import numpy as np

from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import Model
from gearjax.identification.visible import Visible
from gearjax.identification.weights import OUTLYING, noise_of
from gearjax.units import arcmin, mm

WIDE_OFFSET = 4.0  # offset of a recording over `offset_spread` that is no chance
POOR = 2.0  # times the noise from row to row: above this, the residual is more than noise
COARSE = 3.0  # times its residual: steps of an encoder above this are rounding rather than noise (sqrt(12) without any)


def _too_large(fit: Fit, model: Model) -> list[str]:
    """A remark if an error is larger than displacements may be, as a wrong unit or too few recordings make it."""
    system, errors = model.unknowns.scene.system, {}
    for unknown, value in zip(model.unknowns.each, fit.values, strict=False):
        if unknown.kind == "component":
            errors[unknown.path] = math.hypot(errors.get(unknown.path, 0.0), value * unknown.scale)
    path = max(errors, key=lambda path: errors[path], default="")
    limit = system.largest_displacement
    if limit is None or not path or errors[path] < limit:
        return []
    return [
        f"{path} of {errors[path] / mm:.3g} mm is more than a quarter of system.{system.size_of_teeth}, while "
        "displacements are taken as small: a unit of the recordings is wrong, or they do not determine it"
    ]


def _wide_offsets(records: list[Measurement], offsets: np.ndarray, spread: float) -> list[str]:
    """A remark if the offsets of recordings differ by more than they are assumed to; offsets and spread in arcmin."""
    own = dict(zip([record.name for record in records], offsets, strict=False))
    worst = max(own, key=lambda name: abs(own[name]))
    if abs(own[worst]) < WIDE_OFFSET * spread:
        return []
    return [
        f"the encoders' offset of {worst} differs by {own[worst]:.2g} arcmin from that of all recordings, "
        f"{abs(own[worst]) / spread:.0f} times offset_spread: if the encoders were zeroed anew between recordings, "
        "values and errors are wrong: give a larger offset_spread"
    ]


def remarks(fit: Fit, model: Model, told: Visible, records: list[Measurement], spread: float) -> list[str]:
    """Remarks on a fit for the reader: what it does not explain, and numbers that cannot be true.

    Args:
        fit: the fit.
        model: its model.
        told: what the recordings determine.
        records: the recordings.
        spread: standard deviation of the encoders' offset between recordings [rad].
    """
    size, notes = len(model.unknowns.each), _too_large(fit, model)
    outlying = int((fit.share < OUTLYING).sum())
    if outlying > 2e-3 * fit.weight.size:
        notes.append(f"{outlying} of {fit.weight.size} rows are outliers and have less weight")
    noise = noise_of(fit.problem.rows, fit.weight)
    if fit.sigma > POOR * noise and told.blocks > 1:
        notes.append(
            f"the residual ({fit.sigma:.3g} arcmin) is larger than the noise from row to row ({noise:.3g} arcmin): "
            f"an effect is not modelled; standard errors come from blocks of {told.blocks} rows"
        )
    for i, record in enumerate(records):
        step = (record.resolution or 0.0) / arcmin
        if step > COARSE * float(np.std(fit.residual[fit.problem.rows.record == i])):
            notes.append(
                f"{record.name}: the encoder's steps of {step:.3g} arcmin are larger than its noise: their rounding is "
                "no noise, and intervals may be too narrow"
            )
    if len(records) > 1:
        notes += _wide_offsets(records, fit.values[size + 1 :], spread / arcmin)
    for unknown, value in zip(model.unknowns.each, fit.values[:size], strict=True):
        if unknown.kind == "reciprocal" and value < 0.02:
            notes.append(f"{unknown.name}: the recordings show no deflection under torque: is the torque right?")
        if unknown.path == "backlash.initial" and value < 0:
            notes.append(
                "backlash.initial is below zero: flanks jam, the torque of a recording has the wrong sign, or the "
                "offsets of the recordings differ by more than the backlash; in identified.toml it is zero"
            )
    if len(fit.others):
        notes.append(
            f"{len(fit.others)} other solution(s) explain the recordings equally well: intervals are for one of them"
        )
    if len(records) == 1 and any(each.path.startswith("compliance.") for each in model.unknowns.each):
        notes.append("one recording alone hardly separates the stiffness from the encoders' offset")
    return notes
