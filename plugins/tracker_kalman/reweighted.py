"""Conditioning with a measurement noise that the residual itself has changed: robust updates share it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tracker.algebra import condition, finite, without_missing
from tracker.models import isnan, where
from tracker.protocols import SensorModel
from tracker.types import Gaussian, Innovation, Projection

Noise = Callable[[Any, Any, Any, Any], Any]
"""From v, ``H P H'``, R and the number of measured components: the noise to condition with.

What was not measured has a residual of zero, no ``H P H'`` and unit noise.
"""


def conditioned_with(
    noise_of: Noise, state: Any, sensor: SensorModel, z: Any, pose: Any, projection: Projection
) -> tuple[Gaussian, Innovation]:
    """The state after ``z`` with the noise that ``noise_of`` finds; the innovation of the given one.

    Shapes:
        state ``(n, *batch)``; z ``(m, *batch)``, NaN where a component was not measured.
    """
    v = sensor.residual(z, projection.z)
    R = sensor.R(state.mean, pose)
    S, cross = without_missing(projection.S, projection.cross, v)
    R, _ = without_missing(R, projection.cross, v)
    missing = isnan(v)
    measured: Any = 0.0
    for flag in missing:
        measured = measured + where(flag, 0.0, 1.0)
    known = S - R
    noise = noise_of(np.asarray(where(missing, 0.0, v)), known, R, measured)
    _, _, nis, loglik, count = condition(state.mean, None, v, projection.S, projection.cross)
    mean, cov, told, *_ = condition(state.mean, state.cov, v, known + noise, cross)
    nis = where(isnan(told), math.nan, nis)
    return Gaussian.trusted(mean, cov), Innovation(v, projection.S, nis, loglik, count, finite(nis))


def trace(A: Any) -> Any:
    """Sum of the diagonal, ``(*batch)``."""
    total = A[0, 0]
    for i in range(1, len(A)):
        total = total + A[i, i]
    return total
