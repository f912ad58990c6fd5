"""Points of the unit cube for a study; each point depends only on the seed and its own index.

All is integer arithmetic, or numpy on the host. Every bit of a point is therefore the same on any chunk, device or
machine, in any order and after any interruption. Each coordinate belongs to a name (the path of the number that is
drawn from it) and has a key from this name: with Monte Carlo and Latin hypercube, further names change nothing. Latin
hypercube and Sobol points are made in `REPLICATES` independent designs, one after the other. The spread between the
designs gives the error of an estimate from all of them (Owen, 1997, randomised QMC).
"""

import functools
import hashlib
import warnings
from collections.abc import Sequence

import numpy as np

from gearjax.checks import ParameterError, nearest

SAMPLERS = ("monte_carlo", "latin_hypercube", "sobol")
REPLICATES = 16


def replicate_sizes(sampler: str, number: int) -> np.ndarray:
    """Numbers of points of the independent designs, adding to ``number``.

    There is one design for Monte Carlo, or if a design would have fewer than two points.
    """
    if sampler == "monte_carlo" or number < 2 * REPLICATES:
        return np.array([number])
    return np.diff(np.arange(REPLICATES + 1) * number // REPLICATES)


def points(sampler: str, seed: int, names: Sequence[str], number: int, begin: int, end: int) -> np.ndarray:
    """Points ``begin`` to ``end`` of a design of ``number``, shape (end - begin, names), coordinates between 0 and 1.

    Args:
        sampler: ``"monte_carlo"``, ``"latin_hypercube"`` or ``"sobol"`` (scrambled, scipy.stats.qmc).
        seed: seed of the whole study.
        names: one name for each coordinate.
        number: number of all points; Monte Carlo points do not depend on it.
        begin, end: indices of the points, the end not included.

    Raises:
        ParameterError: the sampler is unknown.
    """
    if sampler not in SAMPLERS:
        raise ParameterError("sampler", sampler, nearest(sampler, SAMPLERS))
    if sampler == "monte_carlo":
        return _columns(names, lambda name: _uniform(_words(seed, name), np.arange(begin, end, dtype=np.uint64)))
    parts, edge = [], 0
    for replicate, size in enumerate(replicate_sizes(sampler, number)):
        first, last = max(begin, edge), min(end, edge + int(size))
        if first < last:
            part = _stratified if sampler == "latin_hypercube" else _sobol
            parts.append(part(seed, replicate, names, int(size), first - edge, last - edge))
        edge += int(size)
    return np.concatenate(parts) if parts else np.empty((0, len(names)))


def _columns(names: Sequence[str], column) -> np.ndarray:
    return np.stack([column(name) for name in names], axis=1)


def _words(seed: int, *names: object) -> tuple[int, int]:
    """Two words that depend on a seed and names, the same on every machine."""
    digest = hashlib.sha256("\0".join([str(seed), *map(str, names)]).encode()).digest()
    return int.from_bytes(digest[:8], "little"), int.from_bytes(digest[8:16], "little")


def _mixed(words: np.ndarray) -> np.ndarray:
    """Words of which every bit depends on every bit given (the finaliser of SplitMix64; Steele, Lea, Flood 2014)."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def _bits(key: tuple[int, int], index: np.ndarray) -> np.ndarray:
    """64 random bits for each index: two rounds, each with a word of the key."""
    with np.errstate(over="ignore"):
        return _mixed(_mixed(index * np.uint64(0x9E3779B97F4A7C15) + np.uint64(key[0])) ^ np.uint64(key[1]))


def _uniform(key: tuple[int, int], index: np.ndarray) -> np.ndarray:
    """A number above 0 and below 1 for each index, in steps of 2^-52."""
    return ((_bits(key, index) >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def _stratified(seed: int, replicate: int, names: Sequence[str], size: int, begin: int, end: int) -> np.ndarray:
    """Part of a Latin hypercube: each coordinate is in each of ``size`` equal strata once, at random within it."""
    index = np.arange(begin, end, dtype=np.uint64)

    def column(name: str) -> np.ndarray:
        within = _uniform(_words(seed, name, replicate), index)
        return (_order(_words(seed, name, "stratum", replicate), size)[begin:end] + within) / size

    return np.minimum(_columns(names, column), 1 - 2.0**-53)


@functools.lru_cache(maxsize=64)
def _order(key: tuple[int, int], size: int) -> np.ndarray:
    """A random order of ``0 .. size - 1``."""
    return np.argsort(_bits(key, np.arange(size, dtype=np.uint64)), kind="stable")


def _sobol(seed: int, replicate: int, names: Sequence[str], size: int, begin: int, end: int) -> np.ndarray:
    """Part of a scrambled Sobol sequence; names correspond to its dimensions in order."""
    from scipy.stats import qmc  # takes a third of a second to import

    del size
    engine = qmc.Sobol(len(names), scramble=True, bits=32, rng=_words(seed, "sobol", replicate)[0])
    if begin:
        engine.fast_forward(begin)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # scipy warns that only powers of two are balanced
        drawn = engine.random(end - begin)
    return np.minimum(drawn + 2.0**-33, 1 - 2.0**-53)
