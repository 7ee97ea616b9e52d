"""The fixed-point smoother: one past state, better known with every measurement that comes after it."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import apply, at_once, congruence, product, residual
from tracker.errors import CapabilityError, DomainError, wording
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History, Trajectory
from tracker_kalman.mixture import made
from tracker_kalman.rts import RauchTungStriebel


@attrs.frozen(eq=False)
class FixedPoint:
    """What is known of the state at one fixed time, and how it hangs on the latest state.

    Begin it with the filtered state of the time of interest; `step` it with each later step of the
    filter. Nothing grows: memory and time of a step do not depend on how long ago the time was.

    It smooths one state, not a record, so it is no component of kind "smoother", and runs on arrays: a
    user steps it by hand. Its step is written over the algebra, and can be part of a traced one.

    Shapes:
        mean ``(n, *batch)``; cov, and the regression on the latest state, ``(n, n, *batch)``.
    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, section 10.4; Anderson and Moore (1979),
        Optimal Filtering, section 7.2; Meditch (1969).
    Laws: equal to the fixed-interval smoother's estimate of that time from the record so far.
    """

    mean: Any
    cov: Any
    regression: Any
    smoother: Any = attrs.field(factory=RauchTungStriebel)

    @classmethod
    def begin(cls, filtered: Gaussian, smoother: Any = None) -> FixedPoint:
        """From the filtered state ``(n, *batch)`` of the time of interest.

        ``smoother`` gives the gains: one with a method ``gain`` or its name, by default `RauchTungStriebel`.

        Raises:
            CapabilityError: if it has none.
        """
        rule = RauchTungStriebel() if smoother is None else made(smoother, "smoother")
        if not hasattr(rule, "gain"):
            raise CapabilityError(
                wording(
                    "argument 'smoother'",
                    got=f"{type(rule).__name__}, which has no method 'gain'",
                    expected="a smoother that tells its gains",
                    do="pass 'rts' or 'sigma_point_rts'",
                )
            )
        n = len(filtered.mean)
        unit = np.eye(n).reshape(n, n, *(1,) * (filtered.mean.ndim - 1))
        unit = np.broadcast_to(unit, filtered.cov.shape)
        return cls(filtered.mean, filtered.cov, unit, rule)

    def moments(self) -> Gaussian:
        """Mean and covariance of the state at the fixed time."""
        return Gaussian.trusted(self.mean, self.cov)

    def step(
        self,
        before: Gaussian,
        predicted: Gaussian,
        filtered: Gaussian,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> FixedPoint:
        """One step of the filter later: filtered at k, then predicted and filtered at k + 1.

        Shapes:
            means ``(n, *batch)``, covariances ``(n, n, *batch)``; dt scalar or ``(*batch)``.
        """
        G = self.smoother.gain(before, predicted, motion, dt, u, t)
        B = product(self.regression, G)
        news = residual(filtered.mean, predicted.mean, motion.space.circular)
        return FixedPoint(
            self.mean + apply(B, news),
            self.cov + congruence(B, filtered.cov - predicted.cov),
            B,
            self.smoother,
        )

    @classmethod
    def along(
        cls, history: History, motion: MotionModel, step: int = 0, smoother: Any = None
    ) -> Trajectory:
        """The state of one step of a filtered record, as it was known then and after each later step.

        Shapes:
            step from 0, or from the end if negative; the result has one entry per step from there
            on: the first is the filtered state of ``step``, the last that of a fixed-interval
            smoother.

        Raises:
            DomainError: if the history has no such step.
            CapabilityError: if the smoother has no method ``gain``.

        Example:
        >>> import tracker as tk
        >>> scene = tk.scenario("two_stations", steps=50)
        >>> run = scene.simulate(seed=1)
        >>> est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
        >>> history = tk.filter(est, run.record, run.prior, start=run.start)
        >>> start = FixedPoint.along(history, scene.motion, step=0)
        >>> len(start), bool(start.at(-1).sigma[0] < start.at(0).sigma[0])
        (50, True)
        """
        count = len(history)
        if not -count <= step < count:
            raise DomainError(
                wording(
                    "argument 'step'",
                    got=step,
                    expected=f"a step of the history, 0 to {count - 1}",
                    do="give the place of the time of interest among history.t",
                )
            )
        first, t, after = step % count, history.t, history.filtered
        known = cls.begin(after.at(first), smoother)
        found = [known]
        with at_once():
            for k in range(first, count - 1):
                u = None if history.u is None else history.u[k + 1]
                steps = after.at(k), history.predicted.at(k + 1), after.at(k + 1)
                known = known.step(*steps, motion, t[k + 1] - t[k], u, t[k])
                found.append(known)
        return Trajectory(np.stack([f.mean for f in found]), np.stack([f.cov for f in found]))
