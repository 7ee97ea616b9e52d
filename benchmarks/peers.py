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


def filterpy_ukf(
    z: Any, x0: Any, P0: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> Run:
    """filterpy: UnscentedKalmanFilter with Merwe's points, alpha 1, beta 2, kappa 0; azimuths as directions."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    F = transition(dt)

    def h(x: Any) -> Any:
        return np.array([np.arctan2(x[1] - sy, x[0] - sx) for sx, sy in stations])

    def difference(a: Any, b: Any) -> Any:
        return (a - b + math.pi) % TAU - math.pi

    def mean(points: Any, weights: Any) -> Any:
        return points[0] + weights @ difference(points, points[0])

    def run() -> Any:
        points = MerweScaledSigmaPoints(4, alpha=1.0, beta=2.0, kappa=0.0)
        ukf = UnscentedKalmanFilter(4, 2, dt, hx=h, fx=lambda x, _dt: F @ x, points=points)
        ukf.residual_z, ukf.z_mean = difference, mean
        ukf.x, ukf.P = np.array(x0), np.array(P0)
        ukf.Q, ukf.R = white_acceleration(dt, density), sigma**2 * np.eye(2)
        means = np.empty((len(z), 4))
        for k in range(len(z)):
            ukf.predict()
            ukf.update(z[k])
            means[k] = ukf.x
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


def filterpy_imm(
    z: Any, x0: Any, P0: Any, *, densities: Any, transition_matrix: Any, dt: float, sigma: float
) -> Run:
    """filterpy: IMMEstimator of Kalman filters on measured positions, equally likely at first."""
    from filterpy.kalman import IMMEstimator, KalmanFilter

    def run() -> Any:
        modes = []
        for density in densities:
            kf = KalmanFilter(dim_x=4, dim_z=2)
            kf.x, kf.P = np.array(x0), np.array(P0)
            kf.F, kf.Q = transition(dt), white_acceleration(dt, density)
            kf.H, kf.R = np.eye(2, 4), sigma**2 * np.eye(2)
            modes.append(kf)
        imm = IMMEstimator(modes, np.full(len(modes), 1.0 / len(modes)), transition_matrix)
        means = np.empty((len(z), 4))
        for k in range(len(z)):
            imm.predict()
            imm.update(z[k])
            means[k] = imm.x
        return means

    return run


def stonesoup_ukf(z: Any, x0: Any, P0: Any, **problem: Any) -> Run:
    """Stone Soup's unscented predictor and updater, alpha 1, beta 2, kappa 0, on its stock models."""
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    points = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    return _stonesoup(
        z,
        x0,
        P0,
        lambda motion: UnscentedKalmanPredictor(motion, **points),
        lambda bearing: UnscentedKalmanUpdater(bearing, **points),
        **problem,
    )


def stonesoup_ekf(z: Any, x0: Any, P0: Any, **problem: Any) -> Run:
    """Stone Soup's stock models, predictor and updater; derivatives are its own differences."""
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    return _stonesoup(z, x0, P0, ExtendedKalmanPredictor, ExtendedKalmanUpdater, **problem)


def _stonesoup(
    z: Any,
    x0: Any,
    P0: Any,
    made_predictor: Callable[[Any], Any],
    made_updater: Callable[[Any], Any],
    *,
    stations: Any,
    dt: float,
    density: float,
    sigma: float,
) -> Run:
    from stonesoup.models.measurement.nonlinear import (
        Cartesian2DToBearing,
        CombinedReversibleGaussianMeasurementModel,
    )
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState

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
    predictor, updater = made_predictor(motion), made_updater(bearing)
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


def stonesoup_particles(
    z: Any,
    x0: Any,
    P0: Any,
    *,
    count: int,
    stations: Any,
    seed: int,
    dt: float,
    density: float,
    sigma: float,
) -> Run:
    """Stone Soup's stock particle predictor and updater, with its systematic resampler."""
    from stonesoup.models.measurement.nonlinear import (
        Cartesian2DToBearing,
        CombinedReversibleGaussianMeasurementModel,
    )
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import ESSResampler, SystematicResampler
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.particle import ParticleUpdater

    order = [0, 2, 1, 3]  # x, vx, y, vy, as above
    rng = np.random.default_rng(seed)
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2, seed=seed)
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
    predictor = ParticlePredictor(motion)
    updater = ParticleUpdater(bearing, resampler=ESSResampler(resampler=SystematicResampler()))
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
        drawn = rng.multivariate_normal(
            np.asarray(x0)[order], np.asarray(P0)[np.ix_(order, order)], count
        )
        state = ParticleState(
            StateVectors(drawn.T), weight=np.full(count, 1.0 / count), timestamp=start
        )
        means = np.empty((len(z), 4))
        for k, detection in enumerate(detections):
            predicted = predictor.predict(state, timestamp=detection.timestamp)
            state = updater.update(SingleHypothesis(predicted, detection))
            means[k] = np.asarray(state.mean, dtype=np.float64)[:, 0][order]
        return means

    return run


def dynamax_ekf(
    z: Any, x0: Any, P0: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> Run:
    """dynamax: extended_kalman_filter, compiled; over many runs by vmap.

    Shapes:
        z ``(T, 2)`` and x0, P0 of one run, or ``(runs, T, 2)`` and ``(runs, ...)``. Returns the
        means ``(T, 4)`` or ``(runs, T, 4)``, and keeps nothing else but the log-likelihood.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter

    F, Q = jnp.array(transition(dt)), jnp.array(white_acceleration(dt, density))
    R = sigma**2 * jnp.eye(2)

    def h(x: Any) -> Any:
        return jnp.array([jnp.arctan2(x[1] - sy, x[0] - sx) for sx, sy in stations])

    def one(z: Any, x0: Any, P0: Any) -> Any:
        parameters = ParamsNLGSSM(  # its prior is that of the first measurement
            initial_mean=F @ x0,
            initial_covariance=F @ P0 @ F.T + Q,
            dynamics_function=lambda x: F @ x,
            dynamics_covariance=Q,
            emission_function=h,
            emission_covariance=R,
        )
        kept = ["filtered_means", "marginal_loglik"]
        done = extended_kalman_filter(parameters, z, output_fields=kept)
        return done.filtered_means, done.marginal_loglik

    compiled = jax.jit(one if np.ndim(z) == 2 else jax.vmap(one))
    given = [jnp.array(a) for a in (z, x0, P0)]

    def run() -> Any:
        return jax.block_until_ready(compiled(*given))[0]

    return run


def dynamax_ukf(
    z: Any, x0: Any, P0: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> Run:
    """dynamax: unscented_kalman_filter of many runs by vmap, compiled; alpha 1, beta 2, kappa 0.

    Shapes:
        z ``(runs, T, 2)``, x0 and P0 ``(runs, ...)``. Returns the means ``(runs, T, 4)``.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import (
        ParamsNLGSSM,
        UKFHyperParams,
        unscented_kalman_filter,
    )

    F, Q = jnp.array(transition(dt)), jnp.array(white_acceleration(dt, density))
    R = sigma**2 * jnp.eye(2)
    points = UKFHyperParams(alpha=1.0, beta=2.0, kappa=0.0)

    def h(x: Any) -> Any:
        return jnp.array([jnp.arctan2(x[1] - sy, x[0] - sx) for sx, sy in stations])

    def one(z: Any, x0: Any, P0: Any) -> Any:
        parameters = ParamsNLGSSM(  # its prior is that of the first measurement
            initial_mean=F @ x0,
            initial_covariance=F @ P0 @ F.T + Q,
            dynamics_function=lambda x: F @ x,
            dynamics_covariance=Q,
            emission_function=h,
            emission_covariance=R,
        )
        kept = ["filtered_means", "marginal_loglik"]
        done = unscented_kalman_filter(parameters, z, points, output_fields=kept)
        return done.filtered_means, done.marginal_loglik

    compiled = jax.jit(jax.vmap(one))
    given = [jnp.array(a) for a in (z, x0, P0)]

    def run() -> Any:
        return jax.block_until_ready(compiled(*given))[0]

    return run


def filterpy_linear(z: Any, x0: Any, P0: Any, F: Any, Q: Any, H: Any, R: Any) -> Run:
    """filterpy: KalmanFilter.predict and update on every row."""
    from filterpy.kalman import KalmanFilter

    def run() -> Any:
        kf = KalmanFilter(dim_x=len(x0), dim_z=len(R))
        kf.x, kf.P, kf.F, kf.Q, kf.H, kf.R = np.array(x0), np.array(P0), F, Q, H, R
        means = np.empty((len(z), len(x0)))
        for k in range(len(z)):
            kf.predict()
            kf.update(z[k])
            means[k] = kf.x
        return means

    return run
