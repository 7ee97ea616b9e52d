"""What noise a filter has used, read off its run; estimating noise is for adapters and `tracker.noise_estimation`."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.algebra import at_once
from tracker.errors import CapabilityError, wording
from tracker.types import Array, History


def measurement_noise(history: History, first: int = 0) -> Array:
    """R as each update used it from a step on: ``S - H P- H'``, H taken at the predicted mean.

    Exact for filters that linearise there, whoever changed R: an adapter, or the filter itself. Of
    a sigma-point filter, or a mixture, it also holds what such an S has beyond that. Where
    ``H P- H'`` is far larger than R, few digits are left.

    Shapes:
        ``(T - first, m, m, *batch)``.

    Raises:
        CapabilityError: if the history does not know what it came from, or there are several sensors.

    Laws:
        without an adapter, the sensor's own R (tests/estimation/test_health.py).

    Example:
    >>> import tracker as tk
    >>> scene = tk.scenario("line", axes=1)
    >>> kf = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    >>> sim = scene.simulate(seed=1, runs=2)
    >>> R = tk.filter(kf, sim.record, sim.prior, start=sim.start).measurement_noise()
    >>> bool(np.allclose(R, scene.sensor.parameters["sigma"] ** 2))
    True
    """
    run = history.run
    if run is None or len(run.estimator.sensors) != 1:
        got = "a history by itself" if run is None else f"{len(run.estimator.sensors)} sensors"
        raise CapabilityError(
            wording(
                "the noise that was used",
                got=got,
                expected="a history that `tk.filter` made, of one sensor",
                do="keep what tk.filter returns; join sensors to a stack",
            )
        )
    sensor = run.estimator.sensors[0]
    x = np.moveaxis(np.asarray(history.predicted.mean)[first:], 1, 0)
    P = np.asarray(history.predicted.cov)[first:]
    pose: Any = None
    if run.record.pose is not None and sensor.pose_space.size:
        pose = np.moveaxis(np.asarray(run.record.pose)[first:, : sensor.pose_space.size], 1, 0)
        pose = np.broadcast_to(
            pose.reshape(*pose.shape, *(1,) * (x.ndim - pose.ndim)), (len(pose), *x.shape[1:])
        )
    with at_once():
        H = np.asarray(sensor.jacobian(x, pose))
        H = H.reshape(*H.shape, *(1,) * (x.ndim + 1 - H.ndim))  # a constant one has no lanes
        H = np.broadcast_to(H, (*H.shape[:2], *x.shape[1:]))
        expected = np.einsum("ijt...,tjk...,lkt...->til...", H, P, H, optimize=True)
        return np.asarray(history.innovation.S[first:] - expected)
