"""Chapter 5 of paper 4: a target under water by azimuth and elevation from two sensors that may move."""

from __future__ import annotations

from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from tracker.models import one_of
from tracker.protocols import ObserverPath
from tracker.simulation import Scenario
from tracker.types import Array, Gaussian
from tracker_papers.underwater_multipath import (
    PROCESS_VARIANCE,
    SPEED_UNITS,
    constant_velocity_step,
)
from tracker_sensors.azimuth_elevation import azimuth_elevation
from tracker_sensors.observer_paths import Straight, Together, Weaving
from tracker_sensors.stack import stack

PLACES = ((-900.0, -200.0, -100.0), (-910.0, -180.0, -100.0))
"""Eq. 5-16: both sensors [m]."""

START = (-530.0, -50.0, -50.0, 14.0, 0.3, 0.1)
GUESS = (-500.0, -40.0, -40.0, 17.0, 1.0, 1.0)
PRIOR_VARIANCES = (50.0, 15.0, 15.0, 5.0, 0.04, 0.04)
"""Eq. 5-17 to 5-20; speeds in printed numbers. Printed are [2 or 5]0, 1[2 or 5], 1[2 or 5], [2 or 5]."""

VELOCITY, SWAY, PERIOD = (12.0, 0.0, -1.0), (0.0, 8.0, 0.0), 100.0
"""Of moving sensors; the sway of manoeuvring ones and its period [s] are ours, as no profile is given."""

TOLD_R, TRUE_R = (0.3, 0.03), (3.0, 0.4)
"""Variances of azimuth and elevation in printed numbers, whose unit is not given."""

UNITS = MappingProxyType({
    "1e-4 rad^2": 1e-4,
    "1e-5 rad^2": 1e-5,
    "deg^2": float(np.deg2rad(1.0)) ** 2,
    "rad^2": 1.0,
})  # fmt: skip
"""Readings of the unit of R, in rad^2; only the first gives errors of the printed size."""

MOTIONS = ("static", "constant", "manoeuvring")


def sensor_path(motion: str, speed_unit: str = "kmh") -> Together:
    """Where the two sensors are: both stand still, both go straight, or both weave (sections 5.4 to 5.6).

    Raises:
        DomainError: for another motion or unit.
    """
    one_of("sensor_motion", motion, MOTIONS)
    one_of("speed_unit", speed_unit, tuple(SPEED_UNITS))
    scale = SPEED_UNITS[speed_unit]
    velocity, sway = scale * np.array(VELOCITY), scale * np.array(SWAY)

    def one(place: tuple[float, ...]) -> ObserverPath:
        if motion == "static":
            return Straight(place)
        if motion == "constant":
            return Straight(place, velocity)
        return Weaving(place, velocity, sway, period=PERIOD)

    return Together(tuple(one(place) for place in PLACES))


def angle_sensors(variances: tuple[float, float], unit: str, count: int = 2) -> Any:
    """Azimuth and elevation from several places, which are the pose (eq. 5-10)."""
    sigma, lift = (float(np.sqrt(v * UNITS[unit])) for v in variances)
    return stack([azimuth_elevation(sigma, lift) for _ in range(count)])


def underwater_angles(
    sensor_motion: str = "static",
    *,
    unit: str = "1e-4 rad^2",
    truth_noise: bool = True,
    speed_unit: str = "kmh",
    told: bool = False,
    steps: Annotated[int, "1"] = 500,
) -> Scenario:
    """A target under water by the angles from two sensors beside each other, R told wrongly.

    The filter is told R = diag(0.3, 0.03) of each sensor where diag(3, 0.4) is true, in ``unit``. The
    sensors stand 22 m from each other and 400 m from the target, which recedes to over a kilometre if
    they stay: their bearings become parallel. ``speed_unit`` "raw" takes printed speeds as m/s, of
    target and sensors. ``truth_noise`` False: the target is not disturbed, while the filter assumes
    so. With ``told`` the filter is told the true R.

    Units: m, m/s, rad; a step is a second, whatever dt.

    Raises:
        DomainError: for another motion or unit.
    Source: paper 4, eq. 5-1 to 5-20; Tables 5-1 to 5-3.
    """
    one_of("unit", unit, tuple(UNITS))
    path = sensor_path(sensor_motion, speed_unit)
    scale: Array = np.array([1.0] * 3 + [SPEED_UNITS[speed_unit]] * 3)
    return Scenario(
        name=f"underwater_angles ({sensor_motion})",
        motion=constant_velocity_step(PROCESS_VARIANCE),
        sensor=angle_sensors(TRUE_R if told else TOLD_R, unit),
        truth_motion=constant_velocity_step(PROCESS_VARIANCE if truth_noise else 0.0),
        truth_sensor=angle_sensors(TRUE_R, unit),
        prior=Gaussian(scale * GUESS, np.diag(PRIOR_VARIANCES)),
        start=scale * START,
        initial="fixed",
        t=np.arange(1.0, steps + 1.0),
        pose=path,
        summary=f"two {sensor_motion} sensors, azimuth and elevation",
    )
