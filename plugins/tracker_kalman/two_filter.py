"""The two-filter fixed-interval smoother: the filter's estimates joined with a filter run backwards."""

from __future__ import annotations

import math
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
from tracker.models.functions import absolute, less, maximum, sqrt, where
from tracker.models.graph import plain
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History
from tracker_kalman.rts import backwards


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


@attrs.frozen(eq=False)
class Meeting:
    """What the filter has found up to a step, and what only later measurements say of the state there.

    ``later`` is in deviations from the filtered state.

    Shapes:
        filtered ``(n, *batch)``; later over the same batch.
    """

    filtered: Gaussian
    later: Information

    def moments(self) -> Gaussian:
        """The smoothed moments: ``P = L (1 + J)^-1 L'`` and ``x + L (1 + J)^-1 j``."""
        later = self.later
        unit = _one_more(0.0 * later.root)
        root = triangularise(beside(unit, later.root))
        half = transpose(whiten(root, transpose(factor(self.filtered.cov))))
        mean = self.filtered.mean + apply(half, whiten(root, later.vector))
        return Gaussian.trusted(mean, symmetric_product(half, half))


@attrs.frozen
class TwoFilterSmoother:
    """Joins each filtered estimate with what a filter in information form, run backwards, has found.

    The backward filter starts from no information, takes from each step what its measurement told
    the forward filter, ``P^-1 - (P-)^-1`` and ``P^-1 (x - x-)``, and steps back through the
    motion linearised at the filtered estimates, with the noise ``P- - F P F'`` that the forward
    filter used: it is right after adapted or per-lane noise, and after any Gaussian filter. No
    covariance of the backward filter, which need not exist, is ever formed.

    Roots are taken of the covariances that a history holds: digits that only the root of a filter such as
    "square_root" held are lost here, as in `rts`, and nothing says so.

    In exact arithmetic it equals `rts`, except after a measurement without any noise. Choose it to
    see what past and future say apart, or to join two filters that ran at different places.

    Shapes:
        moments ``(n, *batch)`` and ``(n, n, *batch)``; what is carried as in `Meeting` and `Information`.
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
        moved = residual(filtered.mean, predicted.mean, motion.space.circular)
        s = whiten(T, whiten(root, moved))
        # The measurement's own part is (T T')^-1 - 1 = T^-T (1 - T' T) T^-1, where T can be inverted.
        own = _one_more(-symmetric_product(transpose(T), transpose(T)))
        own = singular_root(own, np.ones(len(own)))
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

    def begin(self, filtered: Gaussian) -> Meeting:
        """Nothing comes after the last step."""
        nothing = Information(0.0 * filtered.cov, 0.0 * filtered.mean)
        return Meeting(filtered, nothing)

    def step(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        smoothed: Meeting,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Meeting:
        """Past and future at k, from moments filtered at k and predicted at k + 1, and both there.

        Shapes:
            means ``(n, *batch)``, covariances ``(n, n, *batch)``; dt scalar or ``(*batch)``.
        """
        known = self.gathered(predicted, smoothed.filtered, smoothed.later, motion)
        return Meeting(filtered, self.back(known, filtered, predicted, motion, dt, u, t))

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        return backwards(self, history, motion)


def whiten_across(L: Any, B: Any) -> Any:
    """``L'^-1 B``, as `whiten` does ``L^-1 B``: read backwards, L' is a lower triangle too."""
    return whiten(transpose(L[::-1, ::-1]), B[::-1])[::-1]


def _one_more(P: Any) -> Any:
    return P + np.eye(len(P)).reshape(len(P), len(P), *(1,) * (P.ndim - 2))


def diagonal(P: Any) -> Any:
    """The diagonal of a matrix, ``(n, *batch)``."""
    index = np.arange(len(P))
    return P[index, index]


def singular_root(P: Any, scale: Any) -> Any:
    """Some B with ``B B' = P`` of a matrix that may be singular, from a subtraction perhaps.

    What is left of variances of size ``scale`` is taken in the order of its share of them; shares as
    small as rounding are nothing, where a factor in the order of the components would divide by them.
    Of a matrix that is not positive semi-definite, no variance in ``B B'`` is larger than in P, but for
    rounding.

    Shapes:
        P ``(n, n, *batch)``; scale ``(n, *batch)``; result ``(n, n, *batch)``, of any structure.
    Reference:
        Higham (2002), Accuracy and Stability of Numerical Algorithms, section 10.3: complete pivoting.
    """
    n, left = len(P), P
    units = [where(less(0.0, s), 1.0 / where(less(0.0, s), s, 1.0), 0.0) for s in scale]
    rounding = (_ROUNDING * n * scale).reshape(
        n, *scale.shape[1:], *(1,) * (P.ndim - 1 - scale.ndim)
    )
    root = np.zeros_like(P)
    for k in range(n):
        most, square, column = left[0, 0] * units[0], left[0, 0], left[:, 0]
        for j in range(1, n):
            share = left[j, j] * units[j]
            larger = less(most, share)
            most = where(larger, share, most)
            square = where(larger, left[j, j], square)
            column = where(larger, left[:, j], column)
        known = less(_ROUNDING * n, most)
        column = column * where(known, 1.0 / sqrt(where(known, square, 1.0)), 0.0)
        column = _within(column, diagonal(left), rounding)
        root[:, k] = column
        left = left - symmetric_product(column[:, None], column[:, None])
    total: Any = 0.0
    for place in np.ndindex(n, n):
        total = total + absolute(P[place])
    lost = where(less(total, math.inf), 0.0, math.nan)
    for place in np.ndindex(n, n):
        root[place] = plain(root[place] + lost)
    return root


def _within(column: Any, left: Any, rounding: Any) -> Any:
    """Entries whose squares are no larger than what is left of the variances, but for rounding."""
    most, own = maximum(left, 0.0) + rounding, column * column
    over = less(most, own)
    return column * where(over, most / where(over, own, 1.0), 1.0)


_ROUNDING = 2.0**-50
