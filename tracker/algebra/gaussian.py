"""What several Gaussian filters do the same way; what makes each of them itself lives with it."""

from __future__ import annotations

from typing import Any

from tracker.algebra import (
    condition,
    congruence,
    finite,
    product,
    symmetric_product,
    transpose,
)
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection


def predicted(state: Gaussian, motion: MotionModel, dt: Any, u: Any, t: Any) -> Gaussian:
    """``f(x)`` and ``F P F' + Q``, with F at the mean: exact for linear motion.

    Reference:
        paper 0, eq. 6.
    """
    mean, F = linearise(motion, state.mean, dt, u, t)
    return Gaussian.trusted(mean, congruence(F, state.cov) + motion.Q(state.mean, dt))


def projected(state: Gaussian, sensor: SensorModel, pose: Any) -> Projection:
    """``h(x)`` and ``H P H' + R``, with H at the mean: exact for linear sensors.

    Reference:
        paper 0, eq. 7.
    """
    z, H = linearise(sensor, state.mean, pose)
    HP = product(H, state.cov)
    return Projection(z, symmetric_product(HP, H) + sensor.R(state.mean, pose), transpose(HP))


def conditioned(
    state: Gaussian, sensor: SensorModel, z: Any, projection: Projection
) -> tuple[Gaussian, Innovation]:
    """Bayes' rule for a Gaussian state whose projection on the measurement is known.

    Shapes:
        state ``(n, *batch)``; z ``(m, *batch)``, NaN where a component was not measured.
    Reference:
        Särkkä (2013), Bayesian Filtering and Smoothing, lemma A.2.
    """
    v = sensor.residual(z, projection.z)
    mean, cov, nis, loglik, count = condition(
        state.mean, state.cov, v, projection.S, projection.cross
    )
    innovation = Innovation(v, projection.S, nis, loglik, count, finite(nis))
    return Gaussian.trusted(mean, cov), innovation
