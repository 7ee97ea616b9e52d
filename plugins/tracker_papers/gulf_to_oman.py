"""The path and the two stations of paper 0: a ship from the Persian Gulf to the Sea of Oman."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from tracker.errors import ShapeError, wording
from tracker.models import one_of
from tracker.simulation import Scenario
from tracker.types import Array, ArrayLike, Gaussian, as_array
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.stack import stack

STATIONS = ((1.0, 1.0), (4.0, 1.1))
"""Paper 0, eq. 34."""

COVARIANCE = (0.1, 0.1, 10.0, 10.0)
"""Diagonal of the initial covariance; paper 0, eq. 35."""

WAYPOINTS = (
    (0.5, 0.5),
    (1.5, 0.8),
    (2.4, 1.5),
    (2.8, 1.7),
    (3.2, 1.2),
    (3.6, 0.2),
    (4.6, -0.6),
)
"""Points of the path, which the paper shows as a picture only, read off from it."""

PRESETS = {"A": (0.1, "prior around truth"), "B": (0.01, "fixed")}
"""Time step and start of each preset: two readings of what the paper leaves open."""


def gulf_to_oman(
    preset: str = "A",
    *,
    speed: Annotated[float, "m/s"] = 1.0,
    sigma: Annotated[float, "rad"] = float(np.deg2rad(2.0)),
    density: Annotated[float, "m^2/s^3"] = 0.1,
    stations: Sequence[Sequence[float]] = STATIONS,
) -> Scenario:
    """A ship on a given path at constant speed, seen by azimuth from fixed stations.

    The paper gives neither the time step nor what the estimators are told of the start. Preset "A"
    measures every 0.1 s and draws the prior mean around the true start, with the paper's covariance,
    anew in each run; preset "B" measures every 0.01 s and starts every run at rest at the true
    position. The truth is the same in every run: it turns as a ship does and not as the filter's
    white acceleration assumes, so no filter is exactly consistent here.

    Units: lengths are the paper's scaled units, called m here; seconds, radians.

    Raises:
        UnknownComponent: for another preset.
        ShapeError: if the stations are not pairs.
    Reference: paper 0, eq. 26-31, 34, 35 and figures 2, 4-6.
    """
    one_of("preset", preset, tuple(PRESETS))
    dt, initial = PRESETS[preset]
    places = as_array(stations, "stations")
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise ShapeError(
            wording(
                "argument 'stations'",
                got=f"shape {places.shape}",
                expected="(stations, 2): x and y of each",
                do="pass for example ((1.0, 1.0), (4.0, 1.1))",
            )
        )
    t, path = along(WAYPOINTS, speed=speed, dt=dt)
    prior = path[0] if initial == "prior around truth" else np.array([*path[0][:2], 0.0, 0.0])
    return Scenario(
        name=f"gulf_to_oman ({preset})",
        motion=constant_velocity(density=density),
        sensor=stack([azimuth(sigma).at(sx=float(x), sy=float(y)) for x, y in places]),
        prior=Gaussian(prior, np.diag(COVARIANCE)),
        start=path[0],
        initial=initial,
        t=t[1:],
        path=path[1:],
        summary=f"{len(places)} fixed stations, azimuth only, a given path",
    )


def along(waypoints: ArrayLike, *, speed: float, dt: float) -> tuple[Array, Array]:
    """Times and states at constant speed on the cubic spline through some points.

    The spline's parameter is the distance between the points, so that it does not overshoot.

    Shapes:
        waypoints ``(points, 2)``; result ``(T,)`` from 0 and ``(T, 4)``: x, y, vx, vy.

    Example:
    >>> t, x = along([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], speed=0.5, dt=1.0)
    >>> len(t), x[2].round(6).tolist()
    (5, [1.0, 0.0, 0.5, 0.0])
    """
    from scipy.interpolate import CubicSpline

    points = as_array(waypoints, "waypoints")
    spacing = np.hypot(*np.diff(points, axis=0).T)
    spline = CubicSpline(np.concatenate(([0.0], np.cumsum(spacing))), points)
    fine = np.linspace(0.0, float(spacing.sum()), 20_001)
    slope = np.hypot(*spline(fine, 1).T)
    length = np.concatenate(([0.0], np.cumsum((slope[1:] + slope[:-1]) / 2.0 * np.diff(fine))))
    # a thousandth of a step of slack: rounding must not take the last point away
    t = dt * np.arange(int(length[-1] / (speed * dt) + 1e-3) + 1)
    place = np.interp(speed * t, length, fine)
    tangent = spline(place, 1)
    velocity = speed * tangent / np.hypot(*tangent.T)[:, None]
    return as_array(t, "t"), np.concatenate([spline(place), velocity], axis=1)
