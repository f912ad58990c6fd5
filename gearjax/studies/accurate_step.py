"""Longest steps of a motion whose metrics are within an allowed error of a reference."""

import math
from collections.abc import Callable

from gearjax.analysis import FixedStep
from gearjax.analysis.choice import STEP
from gearjax.checks import SceneError
from gearjax.progress import Progress, silent
from gearjax.run import Run
from gearjax.scene import Scene
from gearjax.studies.motion_choices import STEPS, Resolving, Setting, dynamic_run, resolving
from gearjax.studies.tradeoff import Metrics, apart, first_run
from gearjax.units import arcmin

YARDSTICK = 0.05  # rad of the fastest motion: first Runge-Kutta steps of the reference of `accurate_step`
UNSURE = 0.2  # of the allowed error: largest uncertainty of the reference
MOST_HALVINGS = 4


def accurate_step(scene: Scene, error: float, progress: Progress = silent) -> FixedStep:
    """The longest steps of the fitted scheme whose metrics are within an error of a reference.

    The reference is computed by Runge-Kutta, a different scheme, because step lengths of one scheme share errors that
    their comparison does not show. Its steps are halved until the metrics change little compared with the error. The
    step of the fitted scheme is predicted from the usual one, as the error falls with the square of the step, and
    then tried.

    Args:
        scene: a scene with a run section that lists ``dynamic``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.

    Raises:
        SceneError: there is no dynamic analysis, or no step is short enough.
    """
    run = dynamic_run(scene)
    resolved = resolving(scene, run)
    longest, usual = resolved.longest, resolved.usual

    def metrics(stepper: FixedStep) -> Metrics:
        return first_run(Setting("solver", "", scene, stepper, run.samples)).metrics

    truth, unsure = _yardstick(metrics, resolved, run, error, progress)
    sizes = (*STEPS, STEPS[-1] / 2, STEPS[-1] / 4)
    size, tried = STEP, {}
    while size not in tried:
        stepper = FixedStep(size * longest, windows=usual.windows)
        tried[size] = off = apart(metrics(stepper), truth) + unsure
        progress(f"steps of {stepper.step:.2g} s: metrics within {off / arcmin:.2g} arcmin")
        good = [one for one, missed in tried.items() if missed <= error]
        foretold = size * math.sqrt(error / max(off, 1e-3 * error))
        if good and (longer := [one for one in sizes if max(good) < one <= foretold and one not in tried]):
            size = max(longer)
        elif good:
            size = max(good)
        else:
            shorter = [one for one in sizes if one < min(tried)]
            if not shorter:
                raise SceneError(
                    f"accuracy: no step down to {stepper.step:.2g} s is within {error / arcmin:.2g} arcmin"
                )
            size = max((one for one in shorter if one <= foretold), default=min(shorter))
    return FixedStep(size * longest, windows=usual.windows)


def _yardstick(
    metrics: Callable[[FixedStep], Metrics], resolved: Resolving, run: Run, error: float, progress: Progress
) -> tuple[Metrics, float]:
    """Metrics by Runge-Kutta, and their uncertainty: a third of the change when the step was halved [rad]."""
    size = YARDSTICK
    coarse = metrics(resolved.runge_kutta(2 * size, run))
    for _ in range(MOST_HALVINGS):
        truth, step = metrics(resolved.runge_kutta(size, run)), size * resolved.whole
        unsure = apart(coarse, truth) / 3
        progress(f"reference: Runge-Kutta, steps of {step:.2g} s: within {unsure / arcmin:.2g} arcmin")
        if unsure <= UNSURE * error:
            return truth, unsure
        coarse, size = truth, size / 2
    raise SceneError(
        f"accuracy: {error / arcmin:.2g} arcmin cannot be verified: the error of Runge-Kutta itself is larger"
    )
