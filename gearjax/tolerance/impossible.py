"""Gear sets of a population that cannot be made, because its numbers contradict each other."""

import dataclasses
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError
from gearjax.scene import Scene
from gearjax.studies.select import owners
from gearjax.tolerance.population import Tolerances


class Impossible(NamedTuple):
    """Gear sets of a population that their own scene would refuse.

    Args:
        looked_at: number of gear sets that were examined, from the first on.
        refused: number of them that are impossible.
        sample: index of the first impossible gear set.
        reason: why it is impossible.
    """

    looked_at: int
    refused: int
    sample: int
    reason: str

    @property
    def told(self) -> str | None:
        """The impossible gear sets in words, ``None`` if there are none."""
        if self.refused == 0:
            return None
        return (
            f"impossible: {self.refused} of the first {self.looked_at} gear sets cannot be made, and their measures "
            f"mean nothing; sample {self.sample}: {self.reason}"
        )

    def as_json(self) -> dict:
        """The entry of ``gearjax tolerance --json``."""
        return self._asdict()


def impossible(tolerances: Tolerances, rows: np.ndarray) -> Impossible:
    """The gear sets of a population that its scene would refuse; numbers out of their own bounds are not among them.

    Args:
        tolerances: the population.
        rows: numbers of the gear sets, in the order of the paths of the population, shape (n, free).
    """
    refused = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is worth a warning was warned of when the scene was made
        for index in np.flatnonzero(tolerances.allowed(rows)).tolist():
            try:
                make_anew(tolerances.with_values(jnp.asarray(rows[index])), tolerances.paths)
            except GearjaxError as fault:
                refused[index] = str(fault)
    first = min(refused, default=-1)
    return Impossible(len(rows), len(refused), first, refused.get(first, ""))


def make_anew(scene: Scene, paths: Sequence[str]) -> None:
    """Make a scene anew, and its parts to which numbers belong, so that they check their numbers.

    Raises:
        GearjaxError: the scene is impossible.
    """
    for part in owners(scene, paths):
        dataclasses.replace(part)
    dataclasses.replace(scene)
