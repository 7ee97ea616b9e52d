"""The two-station azimuth problem of paper 0 with a target that follows the filter's own model."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from tracker.simulation import Scenario
from tracker.types import Gaussian
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.stack import stack


def two_stations(
    *,
    steps: Annotated[int, "1"] = 500,
    dt: Annotated[float, "s"] = 0.01,
    sigma: Annotated[float, "rad"] = float(np.deg2rad(2.0)),
    density: Annotated[float, "m^2/s^3"] = 0.1,
    detection_probability: Annotated[float, "1"] = 1.0,
) -> Scenario:
    """A ship seen from two fixed stations.

    Stations, noise, spectral density and initial covariance are those of paper 0 (eq. 34, 35 and
    text); lengths are the paper's scaled units. The truth is drawn from the prior and moves as the
    filter assumes, so that a consistent filter must show it. The paper's own path is not this one.

    Reference: paper 0, eq. 26-31, 34, 35.
    """
    sensor = stack(
        [
            azimuth(sigma).at(sx=1.0, sy=1.0),
            azimuth(sigma).at(sx=4.0, sy=1.1),
        ]
    )
    return Scenario(
        name="two_stations",
        motion=constant_velocity(density=density),
        sensor=sensor,
        prior=Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 10.0, 10.0])),
        start=np.array([0.0, 0.0, 1.0, 0.0]),
        initial="fixed",
        t=dt * np.arange(1, steps + 1),
        detection_probability=detection_probability,
        summary="two fixed stations, azimuth only",
    )
