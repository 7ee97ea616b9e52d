"""A vehicle that falls through the atmosphere, seen by radar: nonlinear motion, precise measurements."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from tracker.models import ComponentMotion, diagonal, exp, hypot
from tracker.simulation import Scenario
from tracker.types import Gaussian, Space
from tracker_sensors.range_azimuth import range_azimuth

EARTH = 6_374_000.0
"""Radius of the Earth [m]."""

GRAVITATION = 3.986e14
"""Gravitational parameter of the Earth [m^3/s^2]."""

BALLISTIC = 0.59783e-3
"""Drag of the reference body at sea level [1/m]."""

SCALE_HEIGHT = 13_406.0
"""Height over which the air thins by a factor e [m]."""


def _fall(x: Any, y: Any, vx: Any, vy: Any, drag: Any, *, dt: Any) -> Any:
    distance = hypot(x, y)
    slowing = -BALLISTIC * exp(drag + (EARTH - distance) / SCALE_HEIGHT) * hypot(vx, vy)
    pull = -GRAVITATION / distance**3
    return (
        x + dt * vx,
        y + dt * vy,
        vx + dt * (slowing * vx + pull * x),
        vy + dt * (slowing * vy + pull * y),
        drag,
    )


def falling_body(
    density: Annotated[float, "m^2/s^3"] = 240.64, drag_density: Annotated[float, "1/s"] = 1e-5
) -> ComponentMotion:
    """Gravity, and drag in an exponential atmosphere, by Euler steps; ``drag`` is a logarithm.

    Two half steps of Euler are not one whole step: choose dt small (0.1 s).

    Reference: Julier and Uhlmann (2004), Unscented filtering and nonlinear estimation, section VI.
    """
    return ComponentMotion(
        name="falling_body",
        advance=_fall,
        noise=lambda *, dt, density, drag_density: diagonal(
            0.0, 0.0, density * dt, density * dt, drag_density * dt
        ),
        space=Space.of("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "drag"),
        parameters={"density": density, "drag_density": drag_density},
    )


def reentry(*, steps: Annotated[int, "1"] = 2000, dt: Annotated[float, "s"] = 0.1) -> Scenario:
    """A body enters the atmosphere; its drag is unknown at first; a radar stands where it comes down.

    Units: metres, seconds, radians (the source has kilometres).
    Reference: Julier and Uhlmann (2004), section VI; noise as in Hartikainen, Solin and Särkkä (2011),
        Optimal filtering with Kalman filters and smoothers, section 4.3.
    """
    start = np.array([6_500_400.0, 349_140.0, -1809.3, -6796.7, 0.6932])
    return Scenario(
        name="reentry",
        motion=falling_body(),
        truth_motion=falling_body(drag_density=0.0),
        sensor=range_azimuth(1.0, 0.17e-3).at(sx=EARTH, sy=0.0),
        prior=Gaussian([*start[:4], 0.0], np.diag([1.0, 1.0, 1.0, 1.0, 1.0])),
        start=start,
        initial="fixed",
        t=dt * np.arange(1, steps + 1),
        summary="a body enters the atmosphere, range and azimuth",
    )
