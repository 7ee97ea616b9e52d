"""Bearings only from one moving observer: the scenario of the consistency benchmark."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from tracker.models import one_of
from tracker.simulation import Scenario
from tracker.types import Array, Gaussian
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth

PATHS = ("straight", "manoeuvring")


def moving_observer(
    path: str = "straight",
    *,
    sigma: Annotated[float, "rad"] = float(np.deg2rad(0.5)),
    initial: str = "truth from prior",
) -> Scenario:
    """One observer, one target at nearly constant velocity, one azimuth every 10 s, 120 of them.

    The observer moves 50 m every 10 s: always along +y ("straight"), or 30 steps along +y and 30
    along +x in turn ("manoeuvring"). With a straight observer the range cannot be seen. The true target
    is not disturbed; its velocity is drawn anew in each run, with 5 m/s per axis where the prior
    is drawn around the truth.

    Units: metres, seconds, radians; azimuth counter-clockwise from +x.
    Reference: paper 2, eq. 9-12 for the geometry; Bar-Shalom, Li and Kirubarajan (2001), section 10.3.4.
    """
    one_of("path", path, PATHS)
    truth_motion = constant_velocity(density=0.0)
    start = np.array([6000.0, 5000.0, 0.0, 0.0])
    return Scenario(
        name=f"moving_observer ({path})",
        motion=constant_velocity(density=1e-6),
        sensor=azimuth(sigma),
        truth_motion=truth_motion,
        prior=Gaussian(
            [6000.0, 5000.0, 0.0, 0.0], np.diag([3000.0**2, 3000.0**2, 10.0**2, 10.0**2])
        ),
        start=None if initial == "truth from prior" else start,
        start_cov=np.diag([0.0, 0.0, 5.0**2, 5.0**2]) if initial == "prior around truth" else None,
        initial=initial,
        t=10.0 * np.arange(1, 121),
        pose=observer_path(path),
        summary=f"one {path} observer, azimuth only",
    )


def observer_path(path: str) -> Array:
    """Observer positions at the 120 measurement times, ``(120, 2)``."""
    position, out = np.zeros(2), []
    for k in range(120):
        along_x = path == "manoeuvring" and (k // 30) % 2 == 1
        position = position + (np.array([50.0, 0.0]) if along_x else np.array([0.0, 50.0]))
        out.append(position)
    return np.array(out)
