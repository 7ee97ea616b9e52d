"""The two-station problem as users of other libraries would write it; only their documented calls.

A library that is not installed raises ImportError when its function is called.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from handwritten import TAU, transition, white_acceleration

Run = Callable[[], Any]
"""Filters one run of measurements ``(T, 2)`` and returns the means ``(T, 4)``."""


def filterpy_ekf(
    z: Any, x0: Any, P0: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> Run:
    """filterpy: ExtendedKalmanFilter, predict and update on every row."""
    from filterpy.kalman import ExtendedKalmanFilter

    def h(x: Any) -> Any:
        return np.array([np.arctan2(x[1] - sy, x[0] - sx) for sx, sy in stations])

    def jacobian(x: Any) -> Any:
        rows = []
        for sx, sy in stations:
            dx, dy = x[0] - sx, x[1] - sy
            square = dx * dx + dy * dy
            rows.append([-dy / square, dx / square, 0.0, 0.0])
        return np.array(rows)

    def difference(a: Any, b: Any) -> Any:
        return (a - b + math.pi) % TAU - math.pi

    def run() -> Any:
        ekf = ExtendedKalmanFilter(dim_x=4, dim_z=2)
        ekf.x, ekf.P = np.array(x0), np.array(P0)
        ekf.F, ekf.Q = transition(dt), white_acceleration(dt, density)
        ekf.R = sigma**2 * np.eye(2)
        means = np.empty((len(z), 4))
        for k in range(len(z)):
            ekf.predict()
            ekf.update(z[k], jacobian, h, residual=difference)
            means[k] = ekf.x
        return means

    return run


def filterpy_smoother(
    z: Any, x0: Any, P0: Any, *, dt: float, density: float, sigma: float
) -> tuple[Run, Run]:
    """filterpy on a linear problem: the filter alone, and the filter with rts_smoother."""
    from filterpy.kalman import KalmanFilter

    def made() -> Any:
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.x, kf.P = np.array(x0), np.array(P0)
        kf.F, kf.Q = transition(dt), white_acceleration(dt, density)
        kf.H, kf.R = np.eye(2, 4), sigma**2 * np.eye(2)
        return kf

    def filtered() -> Any:
        return made().batch_filter(z)[0]

    def smoothed() -> Any:
        kf = made()
        means, covs, _, _ = kf.batch_filter(z)
        return kf.rts_smoother(means, covs)[0]

    return filtered, smoothed


def stonesoup_ekf(
    z: Any, x0: Any, P0: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> Run:
    """Stone Soup's stock models, predictor and updater; derivatives are its own differences."""
    from stonesoup.models.measurement.nonlinear import (
        Cartesian2DToBearing,
        CombinedReversibleGaussianMeasurementModel,
    )
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    order = [0, 2, 1, 3]  # x, vx, y, vy: Stone Soup's order and, being a swap, the way back
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2)
    bearing = CombinedReversibleGaussianMeasurementModel(
        [
            Cartesian2DToBearing(
                ndim_state=4,
                mapping=(0, 2),
                noise_covar=np.array([[sigma**2]]),
                translation_offset=np.array([[sx], [sy]]),
            )
            for sx, sy in stations
        ]
    )
    predictor, updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(bearing)
    start, step = datetime(2000, 1, 1, tzinfo=UTC), timedelta(seconds=dt)
    detections = [
        Detection(
            StateVector([[Bearing(a)], [Bearing(b)]]),
            timestamp=start + (k + 1) * step,
            measurement_model=bearing,
        )
        for k, (a, b) in enumerate(z)
    ]

    def run() -> Any:
        state = GaussianState(
            np.asarray(x0)[order][:, None], np.asarray(P0)[np.ix_(order, order)], timestamp=start
        )
        means = np.empty((len(z), 4))
        for k, detection in enumerate(detections):
            predicted = predictor.predict(state, timestamp=detection.timestamp)
            state = updater.update(SingleHypothesis(predicted, detection))
            means[k] = np.asarray(state.state_vector, dtype=np.float64)[:, 0][order]
        return means

    return run
