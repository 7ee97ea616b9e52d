"""How loud the sea is, after Wenz and Knudsen: spectral levels by wind, shipping and sea state; band levels.

Background of chapter 1 of paper 4, which prints curves and no formula: everything here is ours, from
the open literature. What the noise does to a bearing is in `passive_sonar`.
"""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np

from tracker.errors import DomainError, wording
from tracker.types import Array, ArrayLike, as_array

KNUDSEN_LEVELS = MappingProxyType(
    {0.0: 44.5, 0.5: 50.0, 1.0: 55.0, 2.0: 61.5, 3.0: 64.5, 4.0: 66.5, 5.0: 68.5, 6.0: 70.0}
)
"""Spectral level at 1 kHz [dB re 1 uPa^2/Hz] by sea state; Knudsen, Alford and Emling 1948."""

KNUDSEN_SLOPE = -17.0
"""dB per decade above 1 kHz, near the 5 dB per octave of Knudsen."""


def turbulence_level(frequency: ArrayLike) -> Array:
    """Spectral level of turbulence; matters below 10 Hz. See `wenz_level`."""
    return np.asarray(17.0 - 30.0 * np.log10(_kilohertz(frequency)))


def shipping_level(frequency: ArrayLike, shipping: ArrayLike = 0.5) -> Array:
    """Spectral level of distant ships; rules from 10 to 100 Hz. See `wenz_level`."""
    f, s = _kilohertz(frequency), _between(shipping, "shipping", 0.0, 1.0)
    return np.asarray(40.0 + 20.0 * (s - 0.5) + 26.0 * np.log10(f) - 60.0 * np.log10(f + 0.03))


def wind_level(frequency: ArrayLike, wind: ArrayLike = 5.0) -> Array:
    """Spectral level of the agitated surface; rules from 100 Hz to 100 kHz. See `wenz_level`."""
    f, w = _kilohertz(frequency), _between(wind, "wind", 0.0, np.inf)
    return np.asarray(50.0 + 7.5 * np.sqrt(w) + 20.0 * np.log10(f) - 40.0 * np.log10(f + 0.4))


def thermal_level(frequency: ArrayLike) -> Array:
    """Spectral level of molecules; rules above 100 kHz. See `wenz_level`."""
    return np.asarray(-15.0 + 20.0 * np.log10(_kilohertz(frequency)))


def wenz_level(frequency: ArrayLike, *, wind: ArrayLike = 5.0, shipping: ArrayLike = 0.5) -> Array:
    """Spectral level of ambient noise in deep water: the powers of its four sources together.

    Shapes:
        all scalars or ``(*batch)``, broadcast; result alike.
    Units:
        frequency Hz; wind m/s; shipping 0 (none) to 1 (heavy); result dB re 1 uPa^2/Hz.

    Raises:
        DomainError: for a frequency that is not positive, or wind or shipping out of range.
    Reference:
        ours, not the thesis': Coates (1990), Underwater Acoustic Systems, section 4.5, as used by
        Stojanovic (2007), On the relationship between capacity and distance in an underwater
        acoustic communication channel, eq. 7-10; curves of Wenz (1962), JASA 34 (12).

    Example:
    >>> wenz_level([100.0, 1000.0, 10_000.0], wind=10.0).round(1).tolist()
    [69.6, 67.9, 53.0]
    """
    parts = (
        turbulence_level(frequency),
        shipping_level(frequency, shipping),
        wind_level(frequency, wind),
        thermal_level(frequency),
    )
    power: Any = 0.0
    for part in parts:
        power = power + 10.0 ** (part / 10.0)
    return np.asarray(10.0 * np.log10(power))


def knudsen_level(frequency: ArrayLike, sea_state: ArrayLike) -> Array:
    """Spectral level of wind noise after Knudsen: flat below 1 kHz, then 17 dB less a decade.

    Between tabulated sea states (0 to 6) it is interpolated.

    Shapes:
        scalars or ``(*batch)``, broadcast; result alike.
    Units:
        frequency Hz; result dB re 1 uPa^2/Hz.

    Raises:
        DomainError: for a frequency that is not positive, or a sea state beyond the table.
    Reference:
        ours, not the thesis': Knudsen, Alford and Emling (1948), J. Marine Research 7 (3); numbers
        as in Lurton (2010), An Introduction to Underwater Acoustics, section 4.2.3. The curves are
        stated for 1 to 100 kHz; that they are flat below is the usual continuation.

    Example:
    >>> knudsen_level([1000.0, 10_000.0], 3.0).tolist()
    [64.5, 47.5]
    """
    f = _kilohertz(frequency)
    states, levels = np.array(list(KNUDSEN_LEVELS.items())).T
    state = _between(sea_state, "sea_state", 0.0, states[-1])
    return np.asarray(
        np.interp(state, states, levels) + KNUDSEN_SLOPE * np.log10(np.maximum(f, 1.0))
    )


def band_level(
    level: Callable[[Array], Array], low: float, high: float, *, points: int = 257
) -> float:
    """Level of all noise between two frequencies: spectral density integrated over the band.

    ``level`` is a function of frequency, such as ``lambda f: wenz_level(f, wind=10.0)``. The
    integral is that of straight lines between points in logarithms of frequency and power.

    Units:
        Hz; result dB re 1 uPa^2.

    Raises:
        DomainError: unless ``0 < low < high``.
    Reference:
        Urick (1983), Principles of Underwater Sound, section 1.5.

    Example:
    >>> round(band_level(lambda f: np.full_like(f, 60.0), 900.0, 1000.0), 6)
    80.0
    """
    if not 0.0 < low < high < np.inf:
        raise DomainError(
            wording(
                "the band",
                got=f"{low} to {high} Hz",
                expected="two positive frequencies, the lower one first",
                do="pass for example low=900.0, high=1100.0",
            )
        )
    f = np.geomspace(low, high, points)
    f[0], f[-1] = low, high
    density = 10.0 ** (level(f) / 10.0)
    # a straight line in logarithms is a power law: integrated exactly
    slope = np.diff(np.log(density)) / np.diff(np.log(f)) + 1.0
    near = np.abs(slope) < 1e-8
    ratio = np.diff(np.log(f))
    exact = (density[1:] * f[1:] - density[:-1] * f[:-1]) / np.where(near, 1.0, slope)
    return float(10.0 * np.log10(np.sum(np.where(near, density[:-1] * f[:-1] * ratio, exact))))


def _kilohertz(frequency: ArrayLike) -> Array:
    f = as_array(frequency, "frequency")
    if not (f > 0.0).all():
        raise DomainError(
            wording(
                "argument 'frequency'",
                got=f"{np.min(f)} Hz",
                expected="positive frequencies",
                do="pass Hz",
            )
        )
    return np.asarray(f / 1000.0)


def _between(value: ArrayLike, name: str, low: float, high: float) -> Array:
    array = as_array(value, name)
    if not ((array >= low) & (array <= high)).all():
        bad = array[~((array >= low) & (array <= high))].flat[0]
        raise DomainError(
            wording(
                f"argument {name!r}",
                got=bad,
                expected=f"{low:g} to {high:g}",
                do="see the units in the docstring",
            )
        )
    return array
