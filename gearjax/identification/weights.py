"""Weights of rows: less for rows of noisy recordings, and less for outliers."""

import numpy as np

from gearjax.identification.rows import Rows

FAR = 4.0  # standard deviations beyond which a row gets less weight
OUTLYING = 0.99  # share of its weight that is left to a row, below which the row counts as an outlier
EVEN = 1.3  # largest ratio of the noises of recordings that count as equally noisy
FEWEST = 30  # rows of a recording whose own noise is estimated
BESIDE = 9  # neighbouring rows whose median a spike is compared with
SPIKE, SPIKES = 10.0, 1.5  # least height of a spike: over the usual distance from that median, over the span of the TE
QUIETEST = 0.01  # of the noise of the noisiest recording: least noise that counts


def noise_of(rows: Rows, weight: np.ndarray | float = 1.0) -> float:
    """Standard deviation of the noise from row to row, without slow curves, of a row of weight one [arcmin]."""
    second = np.diff(rows.te * np.sqrt(weight), 2)[np.diff(rows.record, 2) == 0]
    return float(max(1.4826 * np.median(np.abs(second)) / np.sqrt(6), 1e-6)) if second.size else 1e-6


def spread_of(values: np.ndarray) -> float:
    """Standard deviation estimated from the median absolute deviation, which outliers hardly change."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def of_recordings(residual: np.ndarray, rows: Rows) -> np.ndarray:
    """Weights of rows by the noise of their recordings, shape (n,), one on average.

    A recording that the model does not explain counts in full: its noise is taken from row to row, or from the
    residual if that is smaller, as where few rows follow fast waves.
    """
    each = np.empty(residual.shape)
    for i in np.unique(rows.record):
        own = rows.record == i
        alone = rows._replace(**{key: getattr(rows, key)[own] for key in ("te", "record")})
        noise = min(noise_of(alone), spread_of(residual[own])) if own.sum() >= FEWEST else np.nan
        each[own] = max(noise, 1e-9) if np.isfinite(noise) else np.nan
    each = np.where(np.isfinite(each), each, np.nanmedian(each) if np.isfinite(each).any() else 1.0)
    if each.max() < EVEN * each.min():
        return np.ones(each.shape)
    inverse = np.maximum(each, QUIETEST * each.max()) ** -2
    return inverse / inverse.mean()


def of_spikes(rows: Rows) -> np.ndarray:
    """Weights of rows for the start of a search, shape (n,): zero for spikes, one for all others.

    A spike is farther from its neighbours than the TE of its recording spans. From a start that follows a spike, a
    search does not return: all rows seem to be outliers there.
    """
    each = np.ones(rows.te.shape)
    for i in np.unique(rows.record):
        own = np.flatnonzero(rows.record == i)
        te = rows.te[own]
        if te.size < BESIDE:
            continue
        around = np.lib.stride_tricks.sliding_window_view(np.pad(te, BESIDE // 2, mode="reflect"), BESIDE)
        away = np.abs(te - np.median(around, axis=1))
        span = float(np.subtract(*np.percentile(te, [80, 20])))
        each[own[away > max(SPIKE * 1.4826 * float(np.median(away)), SPIKES * span)]] = 0.0
    return each


def of_outliers(residual: np.ndarray, sigma: float) -> np.ndarray:
    """Shares of their weights that are left to rows, shape (n,), from residuals that are scaled to weight one."""
    return np.minimum(1.0, (FAR * sigma / np.maximum(np.abs(residual), 1e-300)) ** 2)
