"""The Rauch-Tung-Striebel smoother whose gain comes from sigma points."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import factor, gain
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History
from tracker_kalman.rts import RauchTungStriebel, backwards, regressed
from tracker_kalman.sigma_point import through_motion
from tracker_kalman.sigma_points import PointSet, Scaled, point_set


@attrs.frozen
class SigmaPointRauchTungStriebel:
    """Smooths a filtered history backwards; the motion needs no derivatives.

    ``G = C (P-)^-1`` with ``C``, the covariance of the state with the next one, from points through f;
    the rest as in `rts.RauchTungStriebel`, with the predicted moments that the filter stored. Take
    the ``points``, and ``augmented``, of the filter. Linear motion needs no points: there it is `rts`.

    Reference:
        Särkkä (2008), Unscented Rauch-Tung-Striebel smoother, IEEE Transactions on Automatic
        Control 53 (3); paper 0, eq. 24 and the text below it.
    Laws:
        those of kind "smoother".
    """

    points: PointSet = attrs.field(factory=Scaled, converter=point_set)
    augmented: bool = False

    needs = ()

    def gain(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Any:
        """``G``, the regression of the state at k on that at k + 1, from moments as in `step`."""
        if getattr(motion, "linear", False):
            return RauchTungStriebel().gain(filtered, predicted, motion, dt, u, t)
        mean, root = filtered.mean, factor(filtered.cov)
        ahead = through_motion(self.points, mean, root, motion, dt, u, t, self.augmented)
        return gain(ahead.cross, predicted.cov)

    def step(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        smoothed: Gaussian,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Gaussian:
        """Smoothed moments at k, from those filtered at k and predicted and smoothed at k + 1."""
        G = self.gain(filtered, predicted, motion, dt, u, t)
        return regressed(G, filtered, predicted, smoothed, motion)

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        return backwards(self, history, motion)
