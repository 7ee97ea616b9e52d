"""Intervals by resampling whole runs: of medians, of ratios, and of means over fewer runs.

Where a distribution has heavy tails a mean says little and its Student-t interval less; runs are
independent of each other whatever their distribution, so runs are what is resampled. What is normal
enough for a closed form is in `tracker.metrics.consistency`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tracker.errors import ShapeError, wording
from tracker.metrics.consistency import Interval
from tracker.types import Array


def bootstrap_interval(
    statistic: Callable[..., Any],
    *samples: Any,
    rng: np.random.Generator,
    probability: float = 0.95,
    draws: int = 1000,
) -> Interval:
    """A statistic of paired samples with its percentile bootstrap interval.

    A run in which any sample is not finite is left out of all of them.

    Shapes:
        samples ``(runs,)`` each; ``statistic`` reduces the last axis of arrays ``(..., runs)``.

    Raises:
        ShapeError: if there is no sample, or they differ in length.
    Reference:
        Efron and Tibshirani (1993), An Introduction to the Bootstrap, section 13.3.

    Example:
    >>> rng = np.random.default_rng(0)
    >>> found = bootstrap_interval(lambda a: np.median(a, axis=-1), np.arange(101.0), rng=rng)
    >>> found.value, found.low < 50.0 < found.high
    (50.0, True)
    """
    values = _paired(samples)
    count = values.shape[-1]
    if not count:
        return Interval(np.nan, np.nan, np.nan, probability)
    value = float(statistic(*values))
    if count == 1:
        return Interval(value, np.nan, np.nan, probability)
    chosen = rng.integers(count, size=(draws, count))
    return _percentiles(value, statistic(*(v[chosen] for v in values)), probability)


def ratio_interval(
    above: Any, below: Any, *, rng: np.random.Generator, probability: float = 0.95
) -> Interval:
    """Ratio of the means of two paired samples ``(runs,)``; see `bootstrap_interval`."""
    return bootstrap_interval(
        lambda a, b: a.mean(axis=-1) / b.mean(axis=-1),
        above,
        below,
        rng=rng,
        probability=probability,
    )


def ratio_of_medians(
    above: Any, below: Any, *, rng: np.random.Generator, probability: float = 0.95
) -> Interval:
    """Ratio of the medians of two paired samples ``(runs,)``; see `bootstrap_interval`."""
    return bootstrap_interval(
        lambda a, b: np.median(a, axis=-1) / np.median(b, axis=-1),
        above,
        below,
        rng=rng,
        probability=probability,
    )


def spread_of_mean(
    samples: Any,
    runs: int,
    *,
    rng: np.random.Generator,
    probability: float = 0.95,
    draws: int = 2000,
) -> Interval:
    """Where the mean over ``runs`` runs lies with a stated probability, judged by many more runs.

    This, and not the interval of our own mean, is what a number that was published as a mean over
    few runs is to be compared with.

    Shapes:
        samples ``(many,)``; those that are not finite are left out.
    """
    (values,) = _paired((samples,))
    if not values.size:
        return Interval(np.nan, np.nan, np.nan, probability)
    means = values[rng.integers(values.size, size=(draws, runs))].mean(axis=-1)
    return _percentiles(float(values.mean()), means, probability)


def _paired(samples: tuple[Any, ...]) -> Array:
    rows = [np.asarray(one, dtype=np.float64) for one in samples]
    if not rows or any(row.shape != rows[0].shape or row.ndim != 1 for row in rows):
        raise ShapeError(
            wording(
                "argument 'samples'",
                got=", ".join(str(row.shape) for row in rows) or "none",
                expected="one number per run, (runs,), alike for all",
                do="pass the same runs of each",
            )
        )
    values = np.stack(rows)
    return values[:, np.isfinite(values).all(axis=0)]


def _percentiles(value: float, drawn: Any, probability: float) -> Interval:
    tail = 50.0 * (1.0 - probability)
    low, high = np.percentile(drawn, (tail, 100.0 - tail))
    return Interval(value, float(low), float(high), probability)
