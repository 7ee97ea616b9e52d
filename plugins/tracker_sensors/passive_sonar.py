"""Azimuth by listening: the passive sonar equation, and what is left of a bearing in the noise of the sea.

Nothing of this is in paper 4, whose chapter 1 stops at pictures: it is ours, from the open literature.
How loud the sea is lives in `ambient_noise`.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from tracker.models import ComponentSensor, atan2, positive, sqrt
from tracker.models import exp as exponential
from tracker.types import PLANAR, Array, ArrayLike, Space, as_array

_DECIBEL = float(np.log(10.0) / 10.0)
_NEAREST = 1.0
"""Distance [m] at which source levels are told; nearer than that nothing gets louder."""

_NOTHING = float(np.pi**2 / 3.0)
"""Variance of a direction of which nothing is known."""


def absorption(frequency: ArrayLike) -> Array:
    """What sea water takes of sound, dB per km.

    Shapes:
        scalar or ``(*batch)``, result alike.
    Units:
        Hz.
    Reference:
        Thorp (1967) for 4 degrees at 1,000 m, as in Brekhovskikh and Lysanov (2003), section 1.5.

    Example:
    >>> absorption([1000.0, 10_000.0]).round(3).tolist()
    [0.069, 1.187]
    """
    f2 = (as_array(frequency, "frequency") / 1000.0) ** 2
    return np.asarray(0.11 * f2 / (1.0 + f2) + 44.0 * f2 / (4100.0 + f2) + 2.75e-4 * f2 + 0.003)


def signal_excess(
    distance: ArrayLike,
    *,
    source_level: ArrayLike,
    noise_level: ArrayLike,
    array_gain: ArrayLike = 0.0,
    absorption: ArrayLike = 0.0,
    spreading: ArrayLike = 20.0,
) -> Array:
    """Ratio of signal to noise by the passive sonar equation: ``SL - TL - (NL - AG)``, dB.

    The loss on the way is ``TL = spreading log10 r + absorption r / 1000``: 20 spherical, 10
    cylindrical; within the first metre there is none.

    Shapes:
        scalars or ``(*batch)``, broadcast; result alike.
    Units:
        distance m; levels dB re 1 uPa (source at 1 m) in one and the same band; absorption dB/km.
    Reference:
        Urick (1983), Principles of Underwater Sound, section 2.2.

    Example:
    >>> float(signal_excess(1000.0, source_level=140.0, noise_level=80.0))
    0.0
    """
    r = np.maximum(as_array(distance, "distance"), _NEAREST)
    loss = as_array(spreading, "spreading") * np.log10(r)
    loss = loss + as_array(absorption, "absorption") * r / 1000.0
    noise = as_array(noise_level, "noise_level") - as_array(array_gain, "array_gain")
    return np.asarray(as_array(source_level, "source_level") - loss - noise)


def bearing_sigma(
    ratio: ArrayLike,
    *,
    elements: ArrayLike,
    radius: ArrayLike,
    snapshots: ArrayLike,
) -> Array:
    """Least standard deviation of a bearing from a circle of hydrophones in white noise.

    With ``rho`` the ratio of signal to noise at one hydrophone, M of them on a circle of radius a
    wavelengths and K snapshots, the Cramér-Rao bound for a Gaussian signal is
    ``sigma^2 = (1 + 1 / (M rho)) / (K rho M (2 pi a)^2)``, the same in all directions.

    Shapes:
        all scalars or ``(*batch)``, broadcast; result alike.
    Units:
        ratio dB; radius wavelengths; result rad. A bound above about 1 rad means that nothing is known.
    Reference:
        Stoica and Nehorai (1990), Performance study of conditional and unconditional
        direction-of-arrival estimation, eq. 3.1, for one source and this array.
    Laws:
        equal to the bound that follows from the covariance of the snapshots, differentiated
        numerically (tests/property/test_underwater_noise.py).

    Example:
    >>> float(bearing_sigma(0.0, elements=16, radius=2.0, snapshots=100).round(5))
    0.00205
    """
    rho = 10.0 ** (as_array(ratio, "ratio") / 10.0)
    m = as_array(elements, "elements")
    turn = 2.0 * np.pi * as_array(radius, "radius")
    variance = (1.0 + 1.0 / (m * rho)) / (as_array(snapshots, "snapshots") * rho * m * turn**2)
    return np.asarray(np.sqrt(variance))


def _measure(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    return (atan2(y - sy, x - sx),)


def _noise(
    x: Any,
    y: Any,
    *,
    sx: Any,
    sy: Any,
    excess: Any,
    absorption: Any,
    elements: Any,
    radius: Any,
    snapshots: Any,
    floor: Any,
) -> Any:
    square = (x - sx) ** 2 + (y - sy) ** 2 + _NEAREST**2
    lost = square * exponential(_DECIBEL * absorption * sqrt(square) / 1000.0)
    inverse = lost * exponential(-_DECIBEL * excess)  # noise to signal at one hydrophone
    turn = 2.0 * np.pi * radius
    variance = (1.0 + inverse / elements) * inverse / (snapshots * elements * turn * turn)
    # no bearing is worse than one of which nothing is known
    known = variance * _NOTHING / (variance + _NOTHING)
    return ((floor * floor + known,),)


def passive_sonar(
    source_level: Annotated[ArrayLike, "dB"],
    noise_level: Annotated[ArrayLike, "dB"],
    *,
    absorption: Annotated[ArrayLike, "dB/km"] = 0.07,
    elements: Annotated[ArrayLike, "1"] = 16.0,
    radius: Annotated[ArrayLike, "1"] = 2.0,
    snapshots: Annotated[ArrayLike, "1"] = 100.0,
    floor: Annotated[ArrayLike, "rad"] = 1e-3,
    state: Space = PLANAR,
) -> ComponentSensor:
    """Azimuth of a target that is heard, less exact the farther it is.

    The noise of the bearing follows from the passive sonar equation with spherical spreading
    (`signal_excess`) and the Cramér-Rao bound of a circle of hydrophones (`bearing_sigma`), with two
    departures that keep it finite: distances are ``sqrt(r^2 + 1 m^2)``, and a variance V becomes
    ``V U / (V + U)`` with ``U = pi^2 / 3``, that of a direction of which nothing is known. ``floor``
    is what calibration leaves. Levels of source and noise are in one and the same band; the noise
    comes from `ambient_noise.band_level`.

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy]``, ``(2, *batch)``.
    Units:
        dB re 1 uPa (source at 1 m); dB/km; radius wavelengths; rad.

    Raises:
        DomainError: if a level is not finite, or another number not positive.
    Reference:
        ours; chapter 1 of paper 4 names the pieces only. Urick (1983); Stoica and Nehorai (1990).
    Laws:
        those of kind "sensor"; the noise grows with distance.

    Example:
    >>> sensor = passive_sonar(source_level=140.0, noise_level=85.0).at(sx=0.0, sy=0.0)
    >>> [round(float(sensor.R([r, 0.0, 0.0, 0.0])[0, 0] ** 0.5), 4) for r in (100.0, 1000.0, 3000.0)]
    [0.0011, 0.004, 0.0184]
    """
    return ComponentSensor(
        name="passive_sonar",
        measure=_measure,
        noise=_noise,
        space=Space.of("azimuth [rad] circular"),
        pose_space=Space.of("sx [m]", "sy [m]"),
        state=state,
        parameters={
            "excess": as_array(source_level, "source_level") - as_array(noise_level, "noise_level"),
            "absorption": positive("absorption", absorption, unit="dB/km"),
            "elements": positive("elements", elements, unit="1"),
            "radius": positive("radius", radius, unit="1"),
            "snapshots": positive("snapshots", snapshots, unit="1"),
            "floor": positive("floor", floor, unit="rad"),
        },
    )
