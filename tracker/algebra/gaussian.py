"""What every Gaussian filter does the same way; how each projects its state differs and lives with it."""

from __future__ import annotations

from typing import Any

from tracker.algebra import condition, finite
from tracker.protocols import SensorModel
from tracker.types import Gaussian, Innovation, Projection


def conditioned(
    state: Gaussian, sensor: SensorModel, z: Any, projection: Projection
) -> tuple[Gaussian, Innovation]:
    """Bayes' rule for a Gaussian state whose projection on the measurement is known.

    Shapes:
        state ``(n, *batch)``; z ``(m, *batch)``, NaN where a component was not measured.
    Reference:
        Särkkä, Bayesian Filtering and Smoothing, lemma A.2.
    """
    v = sensor.residual(z, projection.z)
    mean, cov, nis, loglik, count = condition(
        state.mean, state.cov, v, projection.S, projection.cross
    )
    innovation = Innovation(v, projection.S, nis, loglik, count, finite(nis))
    return Gaussian.trusted(mean, cov), innovation
