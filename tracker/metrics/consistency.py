"""Whether an estimate knows how wrong it is: NEES, NIS, their chi-square bands, and the verdict.

A confident wrong answer is the worst failure of an estimator; these numbers find it.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import factor, mahalanobis, whiten, without_missing
from tracker.types import Array, Innovation


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


def chi_square_point(probability: float, degrees: float) -> float:
    """What a chi-square variable stays below with the given probability.

    Example:
    >>> round(chi_square_point(0.99, 4), 3)
    13.277
    """
    from scipy.special import chdtri

    return float(chdtri(degrees, 1.0 - probability))


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


@attrs.frozen(eq=False)
class Whiteness:
    """Whether innovations are uncorrelated in time, as those of a matched filter are.

    ``statistic`` is chi-square with ``degrees`` degrees of freedom if they are, and larger if not;
    ``probability`` is that of a larger one by chance.

    Shapes:
        statistic, degrees, probability ``(*batch)``; correlations ``(lags, *batch)``: mean over the
        components of a component with itself, so many steps later.
    """

    statistic: Any
    degrees: Any
    correlations: Any

    @property
    def probability(self) -> Any:
        """Of a larger statistic in a matched filter, ``(*batch)``; NaN where nothing is known."""
        from scipy.special import chdtrc

        with np.errstate(all="ignore"):
            return np.where(self.degrees > 0, chdtrc(self.degrees, self.statistic), np.nan)

    @property
    def together(self) -> Whiteness:
        """All lanes, which are independent, as one; those that are not finite are left out."""
        good = np.isfinite(self.statistic) & (self.degrees > 0)
        lanes = tuple(range(1, np.ndim(self.correlations)))
        known = good & np.isfinite(self.correlations)  # a short record has few lags
        with np.errstate(all="ignore"):
            return Whiteness(
                np.where(good, self.statistic, 0.0).sum(),
                np.where(good, self.degrees, 0.0).sum(),
                np.where(known, self.correlations, 0.0).sum(axis=lanes) / known.sum(axis=lanes),
            )


def whiteness(innovation: Innovation, lags: int = 5) -> Whiteness:
    """A portmanteau test of the autocorrelation of a run's innovations.

    Each is whitened by its own covariance S; the correlations of every component with every other,
    1 to ``lags`` steps later, are squared and added. The sizes of innovations are divided out: they
    are the business of NIS. Components that were not measured are left out of their pairs.

    Shapes:
        innovation with a leading time axis, as in a `History`.
    Reference:
        Hosking (1980), The multivariate portmanteau statistic; Ljung and Box (1978) for the small-sample
        factor; Bar-Shalom, Li and Kirubarajan (2001), section 5.4.2, eq. 5.4.2-16, for the idea.
    Laws:
        on matched linear models a chi-square variable, but for records shorter than ten times ``lags``.
    """
    v, S = np.moveaxis(innovation.residual, 0, 1), np.moveaxis(innovation.S, 0, 2)
    steps, batch = v.shape[1], v.shape[2:]
    seen = np.isfinite(v)
    with np.errstate(all="ignore"):
        whole, _ = without_missing(S, np.zeros((1, *v.shape)), v)
        e = np.where(seen, whiten(factor(whole), np.where(seen, v, 0.0)), 0.0)
        count = seen.sum(axis=1)
        power = np.where(count > 0, (e**2).sum(axis=1) / np.maximum(count, 1), np.nan)
        statistic, degrees = np.zeros(batch), np.zeros(batch)
        own = np.eye(len(v)).reshape(len(v), len(v), *(1,) * len(batch))
        correlations = np.full((lags, *batch), np.nan)
        for lag in range(1, min(lags, steps - 1) + 1):
            early, late = slice(0, steps - lag), slice(lag, steps)
            pairs = np.einsum(
                "at...,bt...->ab...", seen[:, late].astype(float), seen[:, early].astype(float)
            )
            total = np.einsum("at...,bt...->ab...", e[:, late], e[:, early])
            r = total / pairs / np.sqrt(power[:, None] * power)
            used = (pairs > 0) & np.isfinite(r)
            # Ljung and Box's factor: a component also stands in its own denominator.
            size = pairs * (1.0 + own * 2.0 / np.maximum(count, 1))
            statistic += np.where(used, size * r**2, 0.0).sum(axis=(0, 1))
            degrees += used.sum(axis=(0, 1))
            correlations[lag - 1] = np.nanmean(
                np.where(np.einsum("aa...->a...", used), np.einsum("aa...->a...", r), 0.0), axis=0
            )
    lost = ~np.asarray(innovation.ok).all(axis=0)
    return Whiteness(np.where(lost, np.nan, statistic), np.where(lost, 0.0, degrees), correlations)
