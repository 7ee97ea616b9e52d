"""The Huber update around any Gaussian filter (Karlgaard and Schaub 2007; Chang et al. 2012)."""

from __future__ import annotations

from typing import Annotated, Any

import attrs
import numpy as np

from tracker.algebra import apply, factor, inverse, symmetric_product, transpose, whiten
from tracker.models import absolute, maximum
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
from tracker_kalman.reweighted import conditioned_with


@attrs.frozen
class HuberUpdate:
    """Any Gaussian filter whose update takes large residuals for outliers, up to a point.

    The update minimises ``(x - x-)' P^-1 (x - x-) / 2 + sum_i rho(e_i)`` with ``e = R^-1/2 (z - h(x))``
    and Huber's rho, quadratic up to ``threshold`` and linear beyond: outliers pull with a bounded
    force. The noise of a whitened component is inflated until ``|e_i| / threshold`` is its inflation,
    or left as it is; all are adjusted together a fixed number of times, so that it can be compiled.
    At 1.345 the loss of efficiency under Gaussian noise is 5 %.

    The works named reweight prediction errors likewise; here the prediction is trusted, so that only
    measurements are judged. The sensor is seen through the projection of ``inner`` (any filter whose
    belief is a Gaussian, or its name), so that it need not be differentiable. Residual, S, NIS and
    likelihood of the innovation are those of the inner filter: they tell of outliers.

    Raises:
        DomainError: if ``threshold`` is not positive, or ``reweightings`` not at least 1.
    Reference: Karlgaard and Schaub, Huber-based divided difference filtering, Journal of Guidance,
        Control, and Dynamics 30 (2007); Chang, Hu, Chang and Li, Huber-based novel robust
        unscented Kalman filter, IET Science, Measurement & Technology 6 (2012); Huber (1964).
    Laws: those of kind "filter" that do not trust a measurement without limit; with an infinite
        threshold it is the inner filter; it minimises Huber's cost.
    """

    inner: Any = attrs.field(default="ekf1", converter=conditioning_filter)
    threshold: Annotated[float, "standard deviations"] = attrs.field(
        default=1.345, validator=positive_number("filter 'huber'")
    )
    reweightings: int = attrs.field(default=5, validator=at_least(1, "filter 'huber'"))

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
        """Condition on ``z`` with its noise inflated; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection

        def inflated(v: Any, known: Any, R: Any, _measured: Any) -> Any:
            root = factor(R)
            e, seen = whiten(root, v), whiten(root, transpose(whiten(root, known)))
            inflation = np.ones_like(e)
            for _ in range(self.reweightings):
                G = inverse(seen + _diagonal(inflation))
                force = absolute(apply(G, e)) * (1.0 / self.threshold)
                # What makes the force of a component the threshold, if it is above; exactly so where
                # there is but one component.
                width = 1.0 / np.stack([G[i, i] for i in range(len(G))])
                inflation = maximum(inflation + (force - 1.0) * width, 1.0)
            return symmetric_product(root * inflation[None], root)

        return conditioned_with(inflated, state, sensor, z, pose, seen)


def _diagonal(entries: Any) -> Any:
    """A matrix with these on its diagonal, zeros elsewhere."""
    n = len(entries)
    out = np.zeros((n, n, *entries.shape[1:]), dtype=entries.dtype)
    for i in range(n):
        out[i, i] = entries[i]
    return out
