"""Which unknowns the recordings determine and which they hide, in numbers and in words."""

import dataclasses

import numpy as np

from gearjax.identification.fit import Fit, scaled, without_further
from gearjax.identification.unknowns import Unknown, Unknowns

UNSEEN = 1e-9  # of an unknown's own sum of squares, below which there is only rounding
LEAST = 1e-15  # information of a direction, of numbers scaled to ones: less is rounding
TAKES_PART = 1e-5  # least coefficient of an unknown that takes part in a direction
CORRELATED = 0.05  # correlation of successive rows, above which standard errors are computed from blocks of rows
SHORTEST_BLOCK = 10
MOST_CORRELATED = 0.9


@dataclasses.dataclass(frozen=True)
class Combination:
    """A weighted sum of unknowns that the recordings determine, although they hide the unknowns themselves.

    Args:
        words: the sum in words, such as ``errors.planet_1.cos + errors.revolution.cos``.
        coefficients: coefficients of the sum by name of the unknown; a stiffness takes part by its reciprocal, named
            ``1 / compliance.mean``, whose coefficient is in SI: with lengths a force [N].
        value, error: value of the sum and its standard error.
        unit: unit of the first unknown that is no stiffness.
    """

    words: str
    coefficients: dict[str, float]
    value: float
    error: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Visible:
    """What a fit determines and what it hides.

    Args:
        covariance: covariance of the numbers, in units of the search, shape (number, number); it has no meaning for
            hidden unknowns without a prior.
        hidden: hidden directions as rows: changes of the unknowns that change no curve, in units of the search, shape
            (k, unknown).
        combinations: sums of the hidden unknowns that are determined.
        settled: whether priors settle the hidden directions.
        blocks: number of successive rows that count as one, 1 if rows are independent.
        inflation: factor on the variance because successive rows are correlated.
        condition: largest over smallest standard deviation of the directions that are determined, all unknowns scaled
            to the same information.
    """

    covariance: np.ndarray
    hidden: np.ndarray
    combinations: tuple[Combination, ...]
    settled: bool
    blocks: int
    inflation: float
    condition: float

    def is_hidden(self, unknowns: int) -> np.ndarray:
        """Whether each unknown takes part in a hidden direction, shape (unknown,)."""
        if not len(self.hidden):
            return np.zeros(unknowns, bool)
        return np.abs(self.hidden).max(axis=0) > TAKES_PART


def visible(fit: Fit, unknowns: Unknowns) -> Visible:
    """Find what a fit determines and what it hides."""
    _, jacobian = fit.problem.curve(fit.values)
    size = len(unknowns.each)
    hidden = hidden_directions(fit, size)
    blocks = block_length(fit.residual, fit.problem.rows.record)
    settled = _settled(hidden, fit.known.precision[:size] > 0)
    unsettled = 0 if settled else len(hidden)
    covariance = _covariance(fit, jacobian, blocks, unsettled)
    alone = covariance if blocks == 1 else _covariance(fit, jacobian, 1, unsettled)
    inflation = float(np.median(np.diag(covariance)[:size] / np.maximum(np.diag(alone)[:size], 1e-300)))
    told = _combinations(fit, unknowns, hidden, covariance)
    prior = np.diag(fit.known.precision)
    seen = np.linalg.eigvalsh(scaled(fit.matrix + prior)[0][:size, :size])
    seen = seen[len(hidden) :]
    condition = float(np.sqrt(seen[-1] / max(seen[0], 1e-300))) if seen.size else 1.0
    return Visible(covariance, hidden, told, settled, blocks, max(inflation, 1.0), condition)


def hidden_directions(fit: Fit, size: int) -> np.ndarray:
    """Directions of the unknowns whose effect on the curves is zero, or is taken up by offsets and free orders."""
    _, scale = scaled(fit.matrix[:size, :size])
    whole = fit.matrix + np.diag(np.concatenate([np.zeros(size), fit.known.precision[size:]]))
    values, vectors = np.linalg.eigh(without_further(whole, size) / scale[:, None] / scale[None, :])
    directions = vectors[:, values < UNSEEN].T / scale
    return _reduced(directions)


def _reduced(rows: np.ndarray) -> np.ndarray:
    """Rows of the same span that are easier to read: each has a one where the others have zeros."""
    rows = rows.copy()
    row = 0
    for column in range(rows.shape[1]):
        if row == len(rows):
            break
        pivot = row + int(np.argmax(np.abs(rows[row:, column])))
        if abs(rows[pivot, column]) < TAKES_PART * np.abs(rows).max():
            continue
        rows[[row, pivot]] = rows[[pivot, row]]
        rows[row] /= rows[row, column]
        others = np.arange(len(rows)) != row
        rows[others] -= rows[others, column][:, None] * rows[row]
        row += 1
    rows = rows[:row]
    return np.where(np.abs(rows) < TAKES_PART, 0.0, rows)


def block_length(residual: np.ndarray, record: np.ndarray) -> int:
    """Number of successive rows that count as one: six times the correlation time of the residual."""
    centred = residual - residual.mean()
    follows = np.diff(record) == 0
    total = float((centred**2).sum())
    first = float((centred[1:] * centred[:-1])[follows].sum()) / max(total, 1e-300)
    if abs(first) < CORRELATED:
        return 1
    share = min(max(first, 0.0), 0.995)
    time = (1 + share) / (1 - share)
    return int(np.clip(np.ceil(6 * time), SHORTEST_BLOCK, max(SHORTEST_BLOCK, residual.size // 40)))


def _covariance(fit: Fit, jacobian: np.ndarray, blocks: int, hidden: int) -> np.ndarray:
    """Covariance of the numbers found, from the scatter of the rows, or of blocks if successive rows are correlated.

    Hidden directions are left out; directions that the recordings hardly determine have large variances.
    """
    precision = fit.known.precision
    matrix = fit.matrix + np.diag(precision)
    part, scale = scaled(matrix)
    values, vectors = np.linalg.eigh(part)
    seen = vectors[:, hidden:] / np.sqrt(np.maximum(values[hidden:], LEAST))
    inverse = seen @ seen.T / scale[:, None] / scale[None, :]
    variance = fit.sigma**2
    if blocks == 1:
        scatter = variance * matrix
    else:
        rows = fit.problem.rows
        pulls = (fit.weight * fit.residual)[:, None] * jacobian
        begin = np.flatnonzero(np.concatenate([[True], np.diff(rows.record) != 0]))
        number = np.concatenate([(np.arange(n) // blocks) for n in np.diff(np.append(begin, rows.theta.size))])
        key = number + rows.record * (number.max() + 1)
        _, key = np.unique(key, return_inverse=True)
        sums = np.zeros((key.max() + 1, jacobian.shape[1]))
        np.add.at(sums, key, pulls)
        scatter = sums.T @ sums * len(sums) / max(len(sums) - 1, 1) + variance * np.diag(precision)
    return inverse @ scatter @ inverse


def _settled(hidden: np.ndarray, known: np.ndarray) -> bool:
    """Whether the priors settle all directions that the recordings hide."""
    return bool(np.linalg.matrix_rank(hidden[:, known]) == len(hidden)) if known.any() else False


def _combinations(fit: Fit, unknowns: Unknowns, hidden: np.ndarray, covariance: np.ndarray) -> tuple[Combination, ...]:
    """Sums of hidden unknowns that the recordings determine, each with as few unknowns as possible."""
    if not len(hidden):
        return ()
    own = np.flatnonzero(np.abs(hidden).max(axis=0) > TAKES_PART)
    _, _, vectors = np.linalg.svd(hidden[:, own])
    rest = vectors[len(hidden) :]
    told = []
    for row in _reduced(rest):
        weights = np.zeros(fit.values.size)
        weights[own] = np.where(np.abs(row) > TAKES_PART, row, 0.0)
        taking = np.flatnonzero(weights)
        first = _leading(unknowns, taking)
        if unknowns.reciprocals[taking].any():
            weights = weights / weights[first]
        error = float(np.sqrt(max(weights @ covariance @ weights, 0.0)))
        told.append(_told(unknowns, weights, first, float(weights @ fit.values), error))
    return tuple(told)


def _leading(unknowns: Unknowns, taking: np.ndarray) -> int:
    """The unknown in whose unit a direction is told: the first one that is no reciprocal, if there is one."""
    return int(next((i for i in taking if not unknowns.reciprocals[i]), taking[0]))


def _told(unknowns: Unknowns, weights: np.ndarray, first: int, value: float, error: float) -> Combination:
    """A sum in the unit of one of its unknowns; of a stiffness k, its term is a force over k."""
    lead, names = unknowns.each[first], unknowns.names
    inverse = lead.kind == "reciprocal"
    size = 1 / lead.scale if inverse else lead.scale / lead.per_unit
    words, coefficients = "", {}
    for place in np.flatnonzero(weights):
        each, coefficient = unknowns.each[place], float(weights[place])
        sign = ("- " if words else "-") if coefficient < 0 else "+ " if words else ""
        if each.kind == "reciprocal":
            factor, name = coefficient * each.scale * (size if inverse else lead.scale), f"1 / {names[place]}"
            over = f"{abs(factor):.4g} {_over(lead, each)}".rstrip()
            term = name if inverse and place == first else f"{over} / {names[place]}"
        else:
            factor, name = coefficient * size / (each.scale / each.per_unit), names[place]
            term = name if abs(abs(factor) - 1) < 1e-4 else f"{abs(factor):.4g} {name}"
        words += f"{' ' if words else ''}{sign}{term}"
        coefficients[name] = factor
    return Combination(words, coefficients, value * size, error * size, f"1/({lead.unit})" if inverse else lead.unit)


def _over(lead: Unknown, stiffness: Unknown) -> str:
    """SI unit of the number that is divided by a stiffness in a sum in the unit of ``lead``."""
    if lead.kind == "reciprocal":
        return "" if lead.unit == stiffness.unit else f"{stiffness.unit} / ({lead.unit})"
    unit = {"um": "m", "arcmin": "rad", "deg": "rad"}.get(lead.unit, lead.unit)
    return "N" if (unit, stiffness.unit) == ("m", "N/m") else f"{unit}*{stiffness.unit}"


def hidden_in_words(unknowns: Unknowns, hidden: np.ndarray) -> list[str]:
    """The hidden directions in words, one sentence each."""
    words = []
    for row in hidden:
        taking = np.flatnonzero(np.abs(row) > TAKES_PART)
        if len(taking) == 1:
            words.append(f"nothing in the recordings depends on {unknowns.names[taking[0]]}")
            continue
        first = _leading(unknowns, taking)
        changes = ", ".join(_change(unknowns, row, int(i), first) for i in taking)
        words.append(f"the recordings do not change with {changes} together, for any d")
    return words


def _change(unknowns: Unknowns, row: np.ndarray, place: int, first: int) -> str:
    """Change of one unknown in a hidden direction, per change d of the first one that is no reciprocal."""
    each, lead = unknowns.each[place], unknowns.each[first]
    if each.kind != "reciprocal":
        size = row[place] / row[first] * (each.scale / each.per_unit) / (lead.scale / lead.per_unit)
    elif lead.kind == "reciprocal":
        size = row[place] / row[first] * lead.scale / each.scale
    else:
        force = lead.scale * each.scale * row[first] / row[place]
        return f"1 / {each.name} {'-' if force < 0 else '+'} d / ({abs(force):.4g} {_over(lead, each)})"
    times = "" if abs(abs(size) - 1) < 1e-4 else f"{abs(size):.4g} "
    name = f"1 / {each.name}" if each.kind == "reciprocal" else each.name
    return f"{name} {'-' if size < 0 else '+'} {times}d"


def strongest_correlations(
    unknowns: Unknowns, covariance: np.ndarray, seen: np.ndarray
) -> list[tuple[str, str, float]]:
    """Pairs of unknowns whose errors are strongly correlated, with the correlation; the strongest first."""
    size = len(unknowns.each)
    deviation = np.sqrt(np.maximum(np.diag(covariance)[:size], 1e-300))
    found = []
    for i in range(size):
        for j in range(i):
            if seen[i] and seen[j]:
                value = float(covariance[i, j] / deviation[i] / deviation[j])
                if abs(value) > MOST_CORRELATED:
                    found.append((unknowns.names[j], unknowns.names[i], value))
    return sorted(found, key=lambda each: -abs(each[2]))
