"""Whether an estimate knows how wrong it is: NEES, NIS, their chi-square bands, and the verdict.

A confident wrong answer is the worst failure of an estimator; these numbers find it.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import mahalanobis
from tracker.types import Array


def nees(errors: Array, cov: Array) -> Array:
    """Normalised estimation error squared, ``e' P^-1 e``; chi-square with n degrees if consistent.

    Shapes:
        errors ``(T, n, *batch)``; cov ``(T, n, n, *batch)``; result ``(T, *batch)``.
    Reference:
        Bar-Shalom, Li and Kirubarajan (2001), section 5.4.2.
    """
    e, P = np.moveaxis(errors, 0, -1), np.moveaxis(cov, 0, -1)
    with np.errstate(all="ignore"):
        return np.moveaxis(mahalanobis(e, P), -1, 0)


@attrs.frozen
class Band:
    """The interval in which the mean of a consistent statistic lies with a stated probability."""

    low: float
    high: float
    probability: float

    def verdict(self, mean: float) -> str:
        """In one word."""
        if not np.isfinite(mean):
            return "undefined"
        if mean > self.high:
            return "overconfident"
        return "underconfident" if mean < self.low else "consistent"


def chi_square_band(degrees: float, probability: float = 0.95, *, per: float = 1.0) -> Band:
    """Two-sided band of a chi-square variable with ``degrees`` degrees of freedom, divided by ``per``.

    The mean of N values with d degrees each has ``degrees = N * d`` and ``per = N``, if they are
    independent: true of NIS over time and of both over runs, not of NEES over time.

    Example:
    >>> band = chi_square_band(4 * 1000, 0.999, per=1000)
    >>> round(band.low, 3), round(band.high, 3)
    (3.712, 4.301)
    """
    from scipy.special import chdtri

    if degrees <= 0:
        return Band(np.nan, np.nan, probability)
    tail = (1.0 - probability) / 2.0
    low, high = chdtri(degrees, 1.0 - tail), chdtri(degrees, tail)
    return Band(float(low) / per, float(high) / per, probability)


@attrs.frozen
class Interval:
    """A value with the interval that holds the true one with a stated probability."""

    value: float
    low: float
    high: float
    probability: float = 0.95


def mean_interval(samples: Any, probability: float = 0.95) -> Interval:
    """Mean of independent samples with its Student-t confidence interval; NaN samples are left out."""
    from scipy.special import stdtrit

    values = np.asarray(samples, dtype=np.float64)
    values = values[np.isfinite(values)]
    if not values.size:
        return Interval(np.nan, np.nan, np.nan, probability)
    mean = float(values.mean())
    if values.size == 1:
        return Interval(mean, np.nan, np.nan, probability)
    half = float(stdtrit(values.size - 1, 0.5 + probability / 2.0)) * float(
        values.std(ddof=1) / np.sqrt(values.size)
    )
    return Interval(mean, mean - half, mean + half, probability)
