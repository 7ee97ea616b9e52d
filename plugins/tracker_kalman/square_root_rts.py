"""The Rauch-Tung-Striebel smoother in square-root form: covariances are never subtracted."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

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
from tracker.types import Gaussian, History, Trajectory
from tracker_kalman.two_filter import singular_root, whiten_across


@attrs.frozen
class SquareRootRauchTungStriebel:
    """Rauch-Tung-Striebel with the smoothed covariance as a sum of squares, held as its root.

    ``Ps = (1 - G F) P (1 - G F)' + G Q G' + G Ps+ G'``, whose root is one triangularisation of the
    three roots side by side: positive semi-definite whatever the rounding, where ``P + G (Ps+ - P-) G'``
    may lose that. The noise Q is what the filter used, ``P- - F P F'``, so that it is right after
    adapted or per-lane noise. It costs several times `rts`: choose it where a measurement is many orders
    better than the prior.

    Reference: Park and Kailath (1995), Square-root RTS smoothing algorithms; Bierman (1983), A new
        computationally efficient fixed-interval, discrete-time smoother.
    Laws: those of kind "smoother".
    """

    needs = ("jacobian",)

    def root(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        ahead: Any,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> tuple[Any, Any]:
        """Gain at k, and the smoothed root there, from that (``ahead``) at k + 1."""
        _, F = linearise(motion, filtered.mean, dt, u, t)
        F, L = dense(F), factor(filtered.cov)
        FL = product(F, L)
        noise = singular_root(predicted.cov - symmetric_product(FL, FL))
        before = triangularise(beside(FL, noise))  # a root of the predicted covariance
        half = whiten(before, FL)
        G = transpose(whiten_across(before, product(half, transpose(L))))
        left = L - product(G, FL)
        return G, triangularise(beside(left, product(G, noise), product(G, ahead)))

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        filtered, predicted, t = history.filtered, history.predicted, history.t
        mean, cov = np.empty_like(filtered.mean), np.empty_like(filtered.cov)
        if not len(history):
            return attrs.evolve(history, smoothed=Trajectory(mean, cov))
        flags = motion.space.circular
        circular = flags if any(flags) else False
        mean[-1], cov[-1] = filtered.mean[-1], filtered.cov[-1]
        with np.errstate(all="ignore"):
            root = factor(cov[-1])
            for k in range(len(history) - 2, -1, -1):
                u = None if history.u is None else history.u[k + 1]
                own, ahead = filtered.at(k), predicted.at(k + 1)
                G, root = self.root(own, ahead, root, motion, t[k + 1] - t[k], u, t[k])
                mean[k] = own.mean + apply(G, residual(mean[k + 1], ahead.mean, circular))
                cov[k] = symmetric_product(root, root)
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))
