"""The Student-t update around any Gaussian filter (Agamennoni, Nieto and Nebot 2012; Piché et al. 2012)."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import apply, gain, product
from tracker.protocols import SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.inner import (
    at_least,
    conditioning_filter,
    needs_of_inner,
    positive_number,
    predict_as_inner,
    project_as_inner,
    tags_of_inner,
)
from tracker_kalman.reweighted import conditioned_with, trace


@attrs.frozen
class StudentTUpdate:
    """Any Gaussian filter whose measurement noise is Student's t instead of Gaussian.

    Noise of scale R and ``degrees_of_freedom`` nu is Gaussian noise of covariance ``R / w`` with w
    drawn from a gamma distribution. The update finds the best independent densities of state and w
    in turns (variational Bayes), a fixed number of times, so that it can be compiled: with Psi the
    expected square of ``z - h(x)`` after the update, ``w = (nu + m) / (nu + tr(Psi R^-1))``. A gross
    outlier is left out altogether. One w serves all components that were measured together: an
    outlier in one of them discredits the others.

    ``inner``: any filter whose belief is a Gaussian, or its name; the sensor is seen through its
    projection. Residual, S, NIS and likelihood of the innovation are those of the inner filter.
    The covariance of t noise is ``R nu / (nu - 2)``: R is its scale, not its covariance.

    Raises:
        DomainError: if ``degrees_of_freedom`` is not positive, or ``reweightings`` not at least 1.
    Reference: Agamennoni, Nieto and Nebot, Approximate inference in state-space models with
        heavy-tailed noise, IEEE Transactions on Signal Processing 60 (2012); Piché, Särkkä and
        Hartikainen, Recursive outlier-robust filtering and smoothing for nonlinear systems using the
        multivariate Student-t distribution, MLSP 2012; Roth, Özkan and Gustafsson (2013) for t
        distributed states, which this is not.
    Laws: those of kind "filter" that do not trust a measurement without limit; with infinitely many
        degrees of freedom it is the inner filter; one more turn changes little.
    """

    inner: Any = attrs.field(default="ekf1", converter=conditioning_filter)
    degrees_of_freedom: float = attrs.field(
        default=4.0, validator=positive_number("filter 'student_t'")
    )
    reweightings: int = attrs.field(default=5, validator=at_least(1, "filter 'student_t'"))

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
        """Condition on ``z`` with its noise rescaled; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        nu = self.degrees_of_freedom

        def rescaled(v: Any, known: Any, R: Any, measured: Any) -> Any:
            noise = R
            for _ in range(self.reweightings):
                K = gain(noise, known + noise)
                e = apply(K, v)  # what the update leaves of v
                spread = product(K, known)  # and of H P H'
                squared = e[:, None] * e[None] + spread
                noise = R * ((nu + trace(gain(squared, R))) / (nu + measured))
            return noise

        return conditioned_with(rescaled, state, sensor, z, pose, seen)
