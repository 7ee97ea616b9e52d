"""The two-filter fixed-interval smoother: the filter's estimates joined with a filter run backwards."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    apply,
    beside,
    congruence,
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
from tracker.types import Gaussian, History, Trajectory, square_root


@attrs.frozen(eq=False)
class Information:
    """What measurements say of a state: the likelihood ``exp(-e' J e / 2 + e' j)``, unnormalised.

    The deviation e is measured in standard deviations of an estimate, ``L e = x - estimate`` with
    ``L L' = P``: J then says how many times more than the estimate the measurements know. It is held
    as a root B, ``J = B B'``; zero is no information.

    Shapes:
        root B ``(n, n, *batch)``; vector j ``(n, *batch)``.
    """

    root: Any
    vector: Any


@attrs.frozen
class TwoFilterSmoother:
    """Joins each filtered estimate with what a filter in information form, run backwards, has found.

    The backward filter starts from no information, takes from each step what its measurement told
    the forward filter, ``P^-1 - (P-)^-1`` and ``P^-1 (x - x-)``, and steps back through the
    motion linearised at the filtered estimates, with the noise ``P- - F P F'`` that the forward
    filter used: it is right after adapted or per-lane noise, and after any Gaussian filter. No
    covariance of the backward filter, which need not exist, is ever formed.

    In exact arithmetic it equals `rts`, except after a measurement without any noise. Choose it to
    see what past and future say apart, or to join two filters that ran at different places.

    Reference: Fraser and Potter (1969); Särkkä (2013), Bayesian Filtering and Smoothing, section 8.3 and
        eq. 8.12-8.15; Kitagawa (1994) for a form that inverts neither Q nor J.
    Laws: those of kind "smoother".
    """

    needs = ("jacobian",)

    def gathered(
        self, predicted: Gaussian, filtered: Gaussian, later: Information, motion: MotionModel
    ) -> Information:
        """What this measurement and later ones say, in deviations from the predicted state.

        ``later``: what only the later ones say, in deviations from the filtered state.
        """
        root = factor(predicted.cov)
        T = whiten(root, factor(filtered.cov))  # from deviations after the update to those before
        moved = residual(filtered.mean, predicted.mean, _circular(motion))
        s = whiten(T, whiten(root, moved))
        # The measurement's own part is (T T')^-1 - 1 = T^-T (1 - T' T) T^-1, where T can be inverted.
        own = singular_root(_one_more(-symmetric_product(transpose(T), transpose(T))))
        whole = whiten_across(T, beside(own, later.root))
        vector = s + later.vector + apply(later.root, apply(transpose(later.root), s))
        vector = whiten_across(T, vector)
        return Information(triangularise(whole), vector)

    def back(
        self,
        known: Information,
        filtered: Gaussian,
        predicted: Gaussian,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Information:
        """Information on the state at k, filtered there, from that on k + 1, predicted there."""
        _, F = linearise(motion, filtered.mean, dt, u, t)
        A = whiten(factor(predicted.cov), product(dense(F), factor(filtered.cov)))
        Q = _one_more(-symmetric_product(A, A))
        U = known.root
        # (J^-1 + Q)^-1 of a J that may be singular: U (1 + U' Q U)^-1 U'
        kept = whiten(factor(_one_more(congruence(transpose(U), Q))), transpose(U))
        taken = apply(transpose(kept), apply(kept, apply(Q, known.vector)))
        back = transpose(A)
        return Information(product(back, transpose(kept)), apply(back, known.vector - taken))

    def join(self, filtered: Gaussian, later: Information) -> Gaussian:
        """The smoothed moments: ``P = L (1 + J)^-1 L'`` and ``x + L (1 + J)^-1 j``."""
        unit = _one_more(0.0 * later.root)
        root = triangularise(beside(unit, later.root))
        half = transpose(whiten(root, transpose(factor(filtered.cov))))
        mean = filtered.mean + apply(half, whiten(root, later.vector))
        return Gaussian.trusted(mean, symmetric_product(half, half))

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        filtered, predicted, t = history.filtered, history.predicted, history.t
        mean, cov = np.empty_like(filtered.mean), np.empty_like(filtered.cov)
        if not len(history):
            return attrs.evolve(history, smoothed=Trajectory(mean, cov))
        mean[-1], cov[-1] = filtered.mean[-1], filtered.cov[-1]
        later = Information(np.zeros(cov.shape[1:]), np.zeros(mean.shape[1:]))  # nothing
        with np.errstate(all="ignore"):
            for k in range(len(history) - 2, -1, -1):
                u = None if history.u is None else history.u[k + 1]
                own, ahead = filtered.at(k), predicted.at(k + 1)
                known = self.gathered(ahead, filtered.at(k + 1), later, motion)
                later = self.back(known, own, ahead, motion, t[k + 1] - t[k], u, t[k])
                state = self.join(own, later)
                mean[k], cov[k] = state.mean, state.cov
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))


def whiten_across(L: Any, B: Any) -> Any:
    """``L'^-1 B``, as `whiten` does ``L^-1 B``: read backwards, L' is a lower triangle too."""
    return whiten(transpose(L[::-1, ::-1]), B[::-1])[::-1]


def _one_more(P: Any) -> Any:
    return P + np.eye(len(P)).reshape(len(P), len(P), *(1,) * (P.ndim - 2))


def singular_root(P: Any) -> Any:
    """A root of a matrix that is mostly singular, by eigenvalues: a factor would divide by rounding."""
    lost = ~np.isfinite(P).all(axis=(0, 1))
    root = square_root(np.where(lost, 0.0, P))
    return np.where(lost, np.nan, root)


def _circular(motion: MotionModel) -> bool | tuple[bool, ...]:
    flags = motion.space.circular
    return flags if any(flags) else False
