"""A target on a line whose position is measured: the linear-Gaussian problem where all is known."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from tracker.simulation import Scenario
from tracker.types import Gaussian
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.position import position


def line(
    *,
    steps: Annotated[int, "1"] = 100,
    dt: Annotated[float, "s"] = 1.0,
    sigma: Annotated[float, "m"] = 3.0,
    density: Annotated[float, "m^2/s^3"] = 0.1,
    axes: Annotated[int, "1"] = 1,
) -> Scenario:
    """Constant velocity with white acceleration; position measured once a step.

    Truth is drawn from the prior, so that a Kalman filter is exactly consistent: its NEES is
    chi-square with n degrees of freedom at every step.

    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, example 4.3.
    """
    motion = constant_velocity(density=density, axes=axes)
    cov = np.diag([100.0] * axes + [4.0] * axes)
    return Scenario(
        name="line",
        motion=motion,
        sensor=position(sigma, axes=axes),
        prior=Gaussian(np.zeros(2 * axes), cov),
        t=dt * np.arange(1, steps + 1),
        summary="linear and Gaussian",
    )
