"""Valleys of a multi-start search: groups of end points without a rise of the objective between them."""

from collections.abc import Callable

import numpy as np

from gearjax.studies.select import Free

NEIGHBOURS = 5
STOPS = 9  # points on the way from one end point to another
RISE = 0.01  # of the objective


def label(
    free: Free, ends: np.ndarray, objectives: np.ndarray, evaluate: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Number of the valley of each end point, 0 for the valley of the best end point; -1 for a failed start.

    Two neighbours share a valley if the objective on the straight way between them rises by no more than `RISE` above
    the higher of the two.

    Args:
        free: the free numbers.
        ends: end points, shape (starts, free), SI.
        objectives: objectives of the end points, shape (starts,); not finite if a start failed.
        evaluate: function from points, shape (n, free), to objectives, shape (n,), which may be approximate.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    labels = np.full(len(ends), -1)
    good = np.flatnonzero(np.isfinite(objectives))
    order = good[np.argsort(objectives[good], kind="stable")]
    points = ends[order]
    pairs, ways = _neighbours(free, points)
    if len(pairs):
        stops = (np.arange(STOPS) + 1) / (STOPS + 1)
        between = points[pairs[:, 0], None, :] + stops[None, :, None] * ways[:, None, :]
        heights = evaluate(np.concatenate([points, between.reshape(-1, points.shape[1])]))
        higher = heights[: len(points)][pairs].max(axis=1)
        highest = heights[len(points) :].reshape(-1, STOPS).max(axis=1)
        pairs = pairs[highest - higher <= RISE * np.abs(higher)]
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, component = connected_components(links, directed=False)
    numbers = {number: index for index, number in enumerate(dict.fromkeys(component.tolist()))}
    labels[order] = [numbers[number] for number in component.tolist()]
    return labels


def _neighbours(free: Free, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of close points, shape (pairs, 2), and the vectors from the first to the second, shape (pairs, free)."""
    from scipy.spatial import KDTree  # imported here, because it takes a third of a second and few runs need it

    size = points.shape[1]
    number = min(NEIGHBOURS + 1, len(points))
    if number < 2:
        return np.zeros((0, 2), int), np.zeros((0, size))
    places = np.where(free.periodic, points % (2 * np.pi), (points - free.origins) / free.scales)
    places = np.where(free.periodic & (places >= 2 * np.pi), 0.0, places)
    tree = KDTree(places, boxsize=np.where(free.periodic, 2 * np.pi, 0.0))
    near = np.asarray(tree.query(places, k=number)[1])[:, 1:]
    pairs = np.stack([np.repeat(np.arange(len(points)), near.shape[1]), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return pairs, free.way(points[pairs[:, 0]], points[pairs[:, 1]])
