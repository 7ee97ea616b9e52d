"""The Rauch-Tung-Striebel fixed-interval smoother (paper 0 eq. 24)."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import apply, congruence, gain, product, residual, transpose
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History, Trajectory


@attrs.frozen
class RauchTungStriebel:
    """Smooths a filtered history backwards, for linear and linearised motion.

    ``G = P F' (P-)^-1``, ``xs = x + G (xs+ - x-)``, ``Ps = P + G (Ps+ - P-) G'``, with the predicted
    moments that the filter stored, so that it is right after adapted or per-lane noise.

    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, section 8.2; paper 0, eq. 24.
    Laws: those of kind "smoother".
    """

    needs = ("jacobian",)

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
        _, F = linearise(motion, filtered.mean, dt, u, t)
        return gain(transpose(product(F, filtered.cov)), predicted.cov)

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


def regressed(
    G: Any, filtered: Gaussian, predicted: Gaussian, smoothed: Gaussian, motion: MotionModel
) -> Gaussian:
    """Smoothed moments at k, by the regression G of the state there on that at k + 1.

    Shapes:
        G ``(n, n, *batch)``; moments as in `RauchTungStriebel.step`.
    """
    ahead = residual(smoothed.mean, predicted.mean, motion.space.circular)
    return Gaussian.trusted(
        filtered.mean + apply(G, ahead),
        filtered.cov + congruence(G, smoothed.cov - predicted.cov),
    )


def begun(smoother: Any, filtered: Gaussian) -> Any:
    """What a smoother carries backwards from the last filtered moments: those, or a belief of its own.

    Shapes:
        filtered ``(n, *batch)``; the belief's are its own.
    """
    return smoother.begin(filtered) if hasattr(smoother, "begin") else filtered


def backwards(smoother: Any, history: History, motion: MotionModel) -> History:
    """A history smoothed by single steps, from its last estimate, which stays, to its first.

    ``smoother`` is any with a method ``step``, as of `RauchTungStriebel`, and perhaps a ``begin``.

    Shapes:
        history of T steps over any batch, with ``(T, n, *batch)`` means; the result has a ``smoothed``
        trajectory alike.
    """
    filtered, predicted, t = history.filtered, history.predicted, history.t
    mean, cov = np.empty_like(filtered.mean), np.empty_like(filtered.cov)
    if not len(history):
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))
    mean[-1], cov[-1] = filtered.mean[-1], filtered.cov[-1]
    with np.errstate(all="ignore"):
        belief = begun(smoother, filtered.at(len(history) - 1))
        for k in range(len(history) - 2, -1, -1):
            u = None if history.u is None else history.u[k + 1]
            own, ahead = filtered.at(k), predicted.at(k + 1)
            belief = smoother.step(own, ahead, belief, motion, t[k + 1] - t[k], u, t[k])
            state = belief.moments()
            mean[k], cov[k] = state.mean, state.cov
    return attrs.evolve(history, smoothed=Trajectory(mean, cov))
