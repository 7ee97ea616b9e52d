"""The Schmidt-Kalman filter: states that count but are not estimated (Schmidt 1966)."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np

from tracker.algebra.gaussian import conditioned
from tracker.models import isnan, where
from tracker.protocols import SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.inner import (
    conditioning_filter,
    names,
    needs_of_inner,
    predict_as_inner,
    project_as_inner,
    tags_of_inner,
)


@attrs.frozen
class SchmidtFilter:
    """Any Gaussian filter in which some states keep their estimate and variance, but are considered.

    ``considered`` names components of the state, usually biases of the sensors
    (`tracker_sensors.biased`, `tracker_motion.augmented`). Their part of the gain is set to zero: no
    measurement changes them, but their uncertainty widens the innovation, and their correlation with
    the rest of the state is kept. The others are estimated with the gain that is then the best. It is
    the filter to use where a bias is too weakly observable to be estimated, and too large to be left
    out. ``inner``: any filter whose belief is a Gaussian, or its name; it predicts and projects, so
    that what is considered moves with the motion and widens S.

    A smoother treats the result as if all states had been estimated, and is not optimal.

    Raises:
        DomainError: at the first update, if the state has no component of such a name.
    Reference: Schmidt, Application of state-space methods to navigation problems, Advances in Control
        Systems 3 (1966); Simon (2006), Optimal State Estimation, section 10.3.2.
    Laws: those of kind "filter"; with nothing considered it is its inner filter; the covariance is
        that of the errors, whatever the bias is drawn to be.
    """

    considered: tuple[str, ...] = attrs.field(default=(), converter=names)
    inner: Any = attrs.field(default="ekf1", converter=conditioning_filter)

    own_update = True

    needs, tags = needs_of_inner, tags_of_inner
    predict, project = predict_as_inner, project_as_inner

    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on ``z`` what is not considered; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        best, innovation = conditioned(state, sensor, z, seen)
        if not self.considered:
            return best, innovation
        places = np.array(sensor.state.indices(*self.considered))
        # With K = [K_x; 0] the covariance P - K C' - C K' + K S K', C = P H', is that of the optimal
        # update in all blocks but the one among what is considered, which stays.
        mean, cov = best.mean.copy(), best.cov.copy()
        lost = isnan(best.mean[0])  # such a lane is, and stays, not ok
        for place in places:
            mean[place] = where(lost, math.nan, state.mean[place])
        block = places[:, None], places
        cov[block] = state.cov[block]
        return Gaussian.trusted(mean, cov), innovation
