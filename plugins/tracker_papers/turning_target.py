"""An aircraft that turns at a rate to be found out, seen by radar; a standard trial of nonlinear filters."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from tracker.simulation import Scenario
from tracker.types import Gaussian
from tracker_motion.coordinated_turn import coordinated_turn
from tracker_sensors.range_azimuth import range_azimuth


def turning_target(
    *,
    steps: Annotated[int, "1"] = 100,
    dt: Annotated[float, "s"] = 1.0,
    range_sigma: Annotated[float, "m"] = 10.0,
    azimuth_sigma: Annotated[float, "rad"] = float(np.sqrt(10.0)) * 1e-3,
) -> Scenario:
    """Coordinated turn at about -3 degrees a second, range and azimuth from the origin.

    Start, noise and prior are those of the source; the truth is drawn from the prior and follows the
    filter's model, so that a consistent filter must show it.

    Units: metres, seconds, radians.
    Reference: Arasaratnam and Haykin (2009), Cubature Kalman filters, section VIII.A.
    """
    mean = [1000.0, 1000.0, 300.0, 0.0, float(np.deg2rad(-3.0))]
    return Scenario(
        name="turning_target",
        motion=coordinated_turn(density=0.1, turn_density=1.75e-4),
        sensor=range_azimuth(range_sigma, azimuth_sigma).at(sx=0.0, sy=0.0),
        prior=Gaussian(mean, np.diag([100.0, 100.0, 10.0, 10.0, 1e-4])),
        t=dt * np.arange(1, steps + 1),
        summary="a turning aircraft, range and azimuth",
    )
