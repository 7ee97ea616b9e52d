"""Signals before they are measurements: their noise told as a ratio, and held between samples."""

from __future__ import annotations

import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.types import Array, ArrayLike, as_array


def noise_sigma(signal: ArrayLike, decibels: ArrayLike) -> Array:
    """The standard deviation of noise that gives a signal this ratio to it: ``rms / 10^(dB / 20)``.

    Shapes:
        signal ``(T, *batch)``, its root mean square taken over time; decibels broadcasts against
        ``(*batch)``; result ``(*batch)``.

    Raises:
        ShapeError: if the signal has no samples.
    Reference:
        paper 4, sections 3.5, 4.2 and 5.2, which state 20 dB; the definition is not printed.
    Laws:
        `signal_to_noise` is its inverse.

    Example:
    >>> float(noise_sigma([3.0, -3.0], 20.0).round(6))
    0.3
    """
    return np.asarray(_rms(signal) / 10.0 ** (as_array(decibels, "decibels") / 20.0))


def signal_to_noise(signal: ArrayLike, sigma: ArrayLike) -> Array:
    """Ratio of a signal to noise of a standard deviation, in dB: ``20 log10(rms / sigma)``.

    Shapes:
        signal ``(T, *batch)``; sigma broadcasts against ``(*batch)``; result ``(*batch)``.

    Raises:
        ShapeError: if the signal has no samples.
        DomainError: if a sigma is not positive.
    Reference:
        paper 4, as `noise_sigma`, whose inverse it is.
    """
    noise = as_array(sigma, "sigma")
    if not (noise > 0.0).all():
        raise DomainError(
            wording(
                "argument 'sigma'",
                got=f"{noise.min()}",
                expected="positive standard deviations",
                do="pass the standard deviation, not the variance in dB",
            )
        )
    with np.errstate(divide="ignore"):  # no signal at all is minus infinity
        return np.asarray(20.0 * np.log10(_rms(signal) / noise))


def _rms(signal: ArrayLike) -> Array:
    values = as_array(signal, "signal")
    if not values.ndim or not len(values):
        raise ShapeError(
            wording(
                "argument 'signal'",
                got=f"shape {values.shape}",
                expected="(T, *batch) with at least one sample",
                do="put time on the first axis",
            )
        )
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def zero_order_hold(t: ArrayLike, values: ArrayLike, at: ArrayLike) -> Array:
    """Samples held until the next one: the value of the last sample that is not after each time.

    Before the first sample nothing is known: NaN.

    Shapes:
        t ``(T,)``, rising; values ``(T, *batch)``; at ``(K,)``; result ``(K, *batch)``.

    Raises:
        ShapeError: if there is not one time for each sample.
        DomainError: if times fall.
    Reference:
        paper 4, blocks 6 of figure 4-3 and 4 of figure 5-2.

    Example:
    >>> zero_order_hold([0.0, 1.0], [5.0, 6.0], [-0.5, 0.9, 1.0, 7.0]).tolist()
    [nan, 5.0, 6.0, 6.0]
    """
    times, samples = as_array(t, "t"), as_array(values, "values")
    if times.ndim != 1 or samples.shape[:1] != times.shape:
        raise ShapeError(
            wording(
                "arguments 't' and 'values'",
                got=f"shapes {times.shape} and {samples.shape}",
                expected="(T,) and (T, *batch)",
                do="give one time per sample",
            )
        )
    if (np.diff(times) < 0.0).any():
        raise DomainError(
            wording("argument 't'", got="falling times", expected="rising ones", do="sort them")
        )
    place = np.searchsorted(times, as_array(at, "at"), side="right") - 1
    held = np.full((len(place), *samples.shape[1:]), np.nan)
    known = place >= 0
    held[known] = samples[place[known]]
    return held
