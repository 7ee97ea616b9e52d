"""Two studies that paper 0 suggests: what collinear stations cost, and what more stations bring."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import tracker as tk
from tracker.simulation import Scenario
from tracker.types import Array, Gaussian
from tracker_motion.constant_velocity import constant_velocity
from tracker_papers.gulf_to_oman import COVARIANCE, STATIONS, gulf_to_oman
from tracker_papers.paper0.methods import estimators
from tracker_sensors.azimuth import azimuth
from tracker_sensors.stack import stack

ANGLES = (
    0.0,
    5.0,
    10.0,
    20.0,
    30.0,
    45.0,
    60.0,
    90.0,
    120.0,
    135.0,
    150.0,
    160.0,
    170.0,
    175.0,
    180.0,
)
"""Angles in degrees at which the two bearings cross half-way."""

FAR, NEAR = 4.0, 2.5
"""Distances of the two stations from the middle of the course."""

MORE_STATIONS = (*STATIONS, (2.4, 2.6), (2.6, -0.6), (0.6, 1.9), (5.2, 0.4))
"""The paper's two stations and four more around the strait; a network takes the first few."""

SIGMA = float(np.deg2rad(2.0))


def crossing(angle: float) -> Scenario:
    """A straight course on the line of the first station; the second is turned about its middle.

    At every ``angle`` (degrees) the distances are the same, so that only the geometry changes: at 0
    both stations lie astern, at 180 one astern and one ahead, and ship and stations are collinear
    throughout.
    """
    t = 0.1 * np.arange(21)
    path = np.stack([t, 0.0 * t, np.ones(21), np.zeros(21)], axis=1)
    turned = np.deg2rad(180.0 - angle)
    places = ((1.0 - FAR, 0.0), (1.0 + NEAR * np.cos(turned), NEAR * np.sin(turned)))
    return Scenario(
        name=f"bearings cross at {angle:g} degrees",
        motion=constant_velocity(density=0.1),
        sensor=stack([azimuth(SIGMA).at(sx=float(x), sy=float(y)) for x, y in places]),
        prior=Gaussian(path[0], np.diag(COVARIANCE)),
        start=path[0],
        initial="prior around truth",
        t=t[1:],
        path=path[1:],
    )


def single_fix(angle: Array) -> Array:
    """RMS position error of one fix by two bearings that cross at an angle in degrees, same distances."""
    with np.errstate(divide="ignore"):
        return np.asarray(SIGMA * np.hypot(FAR, NEAR) / np.abs(np.sin(np.deg2rad(angle))))


def collinear_study(
    runs: int, seed: int, tell: Callable[[], None]
) -> dict[str, dict[float, Array]]:
    """RMSE of each run of EKF1, by stage and angle; the same random numbers at every angle."""
    out: dict[str, dict[float, Array]] = {"filter": {}, "smoother": {}}
    for angle in ANGLES:
        scene = crossing(angle)
        campaign = tk.monte_carlo(estimators(scene, ("ekf1",)), scene, runs=runs, seed=seed)
        for stage, scores in campaign.scores["ekf1"].items():
            out[stage][angle] = scores.per_run["rmse"]
    tell()
    return out


def network_study(
    runs: int, seed: int, tell: Callable[[], None]
) -> dict[int, dict[str, dict[str, Array]]]:
    """RMSE of each run on the paper's path, by number of stations, method and stage."""
    out: dict[int, dict[str, dict[str, Array]]] = {}
    for count in range(2, len(MORE_STATIONS) + 1):
        scene = gulf_to_oman("A", stations=MORE_STATIONS[:count])
        made = estimators(scene, ("ekf1", "ekf2", "ukf"))
        campaign = tk.monte_carlo(made, scene, runs=runs, seed=seed)
        out[count] = {
            name: {stage: scores.per_run["rmse"] for stage, scores in stages.items()}
            for name, stages in campaign.scores.items()
        }
    tell()
    return out
