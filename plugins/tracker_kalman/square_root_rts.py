"""The Rauch-Tung-Striebel smoother in square-root form: smoothed covariances are sums of squares."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import (
    apply,
    beside,
    dense,
    factor,
    product,
    residual,
    symmetric_product,
    transpose,
    triangularise,
    whiten,
)
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History
from tracker_kalman.rooted import SquareRootGaussian, rooted
from tracker_kalman.rts import backwards
from tracker_kalman.two_filter import diagonal, singular_root, whiten_across


@attrs.frozen
class SquareRootRauchTungStriebel:
    """Rauch-Tung-Striebel with the smoothed covariance as a sum of squares, held as its root.

    ``Ps = (1 - G F) P (1 - G F)' + G Q G' + G Ps+ G'``, whose root is one triangularisation of the
    three roots side by side: positive semi-definite whatever the rounding, where ``P + G (Ps+ - P-) G'``
    may lose that. The root is carried from step to step. The noise Q is what the filter used, ``P- - F P F'``,
    so that it is right after adapted or per-lane noise.

    It is semi-definite, not more precise: a history holds covariances, whose roots are taken here anew, and Q
    is their difference. Digits that only the root of a filter such as "square_root" held are lost, as in `rts`:
    of variances that are 1e12 times as large as R some 1e-4. It computes several times what `rts` does.

    Shapes:
        moments ``(n, *batch)`` and ``(n, n, *batch)``; the root that is carried ``(n, n, *batch)``, lower
        triangular.
    Reference: Park and Kailath (1995), Square-root RTS smoothing algorithms; Bierman (1983), A new
        computationally efficient fixed-interval, discrete-time smoother.
    Laws: those of kind "smoother".
    """

    needs = ("jacobian",)

    def begin(self, filtered: Gaussian) -> SquareRootGaussian:
        """The last filtered moments, as a mean and a root."""
        return rooted(filtered)

    def step(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        smoothed: SquareRootGaussian,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> SquareRootGaussian:
        """Smoothed mean and root at k, from moments filtered at k and predicted at k + 1.

        Shapes:
            means ``(n, *batch)``, covariances and root ``(n, n, *batch)``; dt scalar or ``(*batch)``.
        """
        _, F = linearise(motion, filtered.mean, dt, u, t)
        F, L = dense(F), factor(filtered.cov)
        FL = product(F, L)
        used = predicted.cov - symmetric_product(FL, FL)
        noise = singular_root(used, diagonal(predicted.cov))
        before = triangularise(beside(FL, noise))  # a root of the predicted covariance
        half = whiten(before, FL)
        G = transpose(whiten_across(before, product(half, transpose(L))))
        left = L - product(G, FL)
        root = triangularise(beside(left, product(G, noise), product(G, smoothed.root)))
        ahead = residual(smoothed.mean, predicted.mean, motion.space.circular)
        return SquareRootGaussian(filtered.mean + apply(G, ahead), root)

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        return backwards(self, history, motion)
