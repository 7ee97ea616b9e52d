"""An estimator on line that can look back: late measurements, and estimates with a fixed lag.

What a filter, a smoother or a noise adapter does belongs to them; here their steps are kept, put
into time order, and done again where a late measurement asks for it.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker import estimation
from tracker.errors import CapabilityError, DomainError, ShapeError, wording
from tracker.estimation import Estimator
from tracker.recursion import Adapted
from tracker.types import (
    Array,
    ArrayLike,
    Beliefs,
    Gaussian,
    History,
    Innovation,
    Trajectory,
    brief,
)

__all__ = ["FixedLag", "Row"]


@attrs.frozen(eq=False)
class Row:
    """One measurement as it was given, and what the estimator made of it.

    Shapes:
        z ``(m, *batch)``; pose ``(p, *batch)``, u ``(q, *batch)`` or None; belief: what the
        estimator carries on; innovation None where nothing was measured.
    """

    t: float
    z: Array = attrs.field(repr=brief)
    pose: Any = attrs.field(repr=False)
    u: Any = attrs.field(repr=False)
    sensor: int
    estimator: Estimator = attrs.field(repr=False)
    belief: Any = attrs.field(repr=False)
    innovation: Innovation | None = attrs.field(repr=False)


@attrs.frozen(eq=False)
class FixedLag:
    """The last ``lag`` steps of an estimator on line, which later measurements may still improve.

    It is a value: `step` returns the next one. A measurement later than all others is filtered as by
    `Estimator.step`. One that comes late is put in its place and the steps after it are done again,
    from stored beliefs and measurements: the result is, exactly and for every filter, that of the
    same measurements in time order. ``estimator`` may be exchanged between steps
    (``attrs.evolve(window, estimator=...)``): each step keeps the one that it was made with.

    Raises:
        DomainError: if the lag is below one step.
    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, section 10.5, for the lag; Bar-Shalom (2002),
        Update with out-of-sequence measurements in tracking: exact solution, for what is equalled.
    Laws: late measurements give what the same measurements give in time order.

    Example:
    >>> import numpy as np, tracker as tk
    >>> from tracker_motion import constant_velocity
    >>> from tracker_sensors import position
    >>> est = tk.estimator("kf", motion=constant_velocity(0.1), sensor=position(2.0), smoother="rts")
    >>> window = tk.FixedLag.begin(est, tk.Gaussian(np.zeros(4), 100.0 * np.eye(4)), lag=5)
    >>> for t in (1.0, 2.0, 4.0, 3.0):  # the last one is late
    ...     window = window.step([t, 0.0], t)
    >>> window.t, [row.t for row in window.rows]
    (4.0, [1.0, 2.0, 3.0, 4.0])
    >>> window.at(2.5).mean[:2].round(1).tolist()  # looking back
    [2.5, 0.0]
    """

    estimator: Estimator
    lag: int
    begun: float
    before: Any = attrs.field(repr=False)
    rows: tuple[Row, ...] = ()

    @classmethod
    def begin(
        cls,
        estimator: Estimator,
        prior: Any,
        t: float = 0.0,
        *,
        lag: int = 10,
        pose: ArrayLike | None = None,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
    ) -> FixedLag:
        """From a prior of any batch shape at time ``t``; pose and rng as in `Estimator.begin`.

        Raises:
            DomainError: if the lag is below one step.
        """
        if lag < 1:
            raise DomainError(
                wording("argument 'lag'", got=lag, expected="1 or more steps", do="pass lag=10")
            )
        return cls(estimator, lag, float(t), estimator.begin(prior, pose=pose, rng=rng))

    @property
    def t(self) -> float:
        """The latest time."""
        return self.rows[-1].t if self.rows else self.begun

    @property
    def state(self) -> Any:
        """The belief at the latest time, given all measurements."""
        return self.rows[-1].belief if self.rows else self.before

    @property
    def innovation(self) -> Innovation | None:
        """The innovation of the latest step in time, or None before the first one."""
        return self.rows[-1].innovation if self.rows else None

    def step(
        self,
        z: ArrayLike,
        t: float,
        *,
        pose: ArrayLike | None = None,
        u: ArrayLike | None = None,
        sensor: int = 0,
    ) -> FixedLag:
        """With one more measurement, taken at time ``t``; late or not.

        Of measurements of the same time the one that came first is used first. An input u acts from
        the row before until this one; of a late measurement without one it is that of the row after.

        Shapes:
            z ``(m, *batch)``, NaN where not measured; t a number, the same for all lanes.

        Raises:
            DomainError: if t is older than what is kept (`begun`), or not finite.
            ShapeError: if t differs from lane to lane, or z does not fit.
        """
        place = self._place(t)
        if u is None and place < len(self.rows):
            u = self.rows[place].u
        values = np.array(z, dtype=np.float64)
        new = Row(float(t), values, pose, u, sensor, self.estimator, None, None)
        rows = self._again((*self.rows[:place], new, *self.rows[place:]), place)
        if len(rows) <= self.lag:
            return attrs.evolve(self, rows=rows)
        return attrs.evolve(self, begun=rows[0].t, before=rows[0].belief, rows=rows[1:])

    def smoothed(self) -> tuple[Array, Trajectory]:
        """Times and estimates of all steps kept, each given every measurement so far.

        The first is that of `begun`: ``lag`` steps ago, once so many were made.

        Raises:
            CapabilityError: if the estimator has no smoother.
        """
        history = self._history()
        found = estimation.smoothed(self.estimator, history).smoothed
        assert found is not None  # noqa: S101 - a smoother fills it in
        return history.t, found

    def at(self, t: float) -> Gaussian:
        """Mean and covariance at any time from `begun` on, given all measurements so far.

        A time that is past is retrodicted: a step is put there that measures nothing, and smoothed.

        Raises:
            DomainError: if t is older than what is kept.
            CapabilityError: if t is past and the estimator has no smoother.
        """
        place, rows = self._place(t), self.rows
        if place == len(rows):
            ahead = Row(float(t), np.empty(0), None, None, 0, self.estimator, None, None)
            with np.errstate(all="ignore"):
                return _predicted(ahead, self.state, self.t).moments()  # type: ignore[no-any-return]
        nothing = np.full_like(rows[place].z, np.nan)
        blank = attrs.evolve(rows[place], t=float(t), z=nothing)
        whole = self._again((*rows[:place], blank, *rows[place:]), place)
        return attrs.evolve(self, rows=whole).smoothed()[1].at(place + 1)

    # ---------------------------------------------------------------------------- inside
    def _place(self, t: Any) -> int:
        if np.ndim(t):
            raise ShapeError(
                wording(
                    "argument 't'",
                    got=f"shape {np.shape(t)}",
                    expected="one time for all lanes",
                    do="step lane by lane, or give NaN in the lanes that were not measured",
                )
            )
        if not np.isfinite(t) or t < self.begun:
            raise DomainError(
                wording(
                    "argument 't'",
                    got=f"{t} s",
                    expected=f"a time from {self.begun} s on, the oldest that is kept",
                    do=f"leave the measurement out, or begin with a lag of more than {self.lag} steps",
                )
            )
        return bisect.bisect_right([row.t for row in self.rows], t)

    def _again(self, rows: tuple[Row, ...], first: int) -> tuple[Row, ...]:
        """The rows with what follows from the measurements, from ``first`` on."""
        done = list(rows[:first])
        belief, t = (done[-1].belief, done[-1].t) if done else (self.before, self.begun)
        for row in rows[first:]:
            belief, innovation = row.estimator.step(
                belief, row.z, row.t - t, pose=row.pose, u=row.u, t=t, sensor=row.sensor
            )
            t = row.t
            done.append(attrs.evolve(row, belief=belief, innovation=innovation))
        return tuple(done)

    def _history(self) -> History:
        """All steps kept as a history; the one before them is its first row."""
        if self.estimator.smoother is None:
            raise CapabilityError(
                "looking back needs an estimator with a smoother: got one without. "
                "Build it with smoother='rts'."
            )
        beliefs, times = [self.before], [self.begun]
        ahead = [self.before.moments()]
        kept = [_belief(self.before)]
        with np.errstate(all="ignore"):
            for row in self.rows:
                predicted = _predicted(row, beliefs[-1], times[-1])
                kept.append(predicted)
                ahead.append(predicted.moments())
                beliefs.append(row.belief)
                times.append(row.t)
        after = [belief.moments() for belief in beliefs]
        batch = after[0].batch
        nothing = np.full((len(times), *batch), np.nan)
        innovation = Innovation(
            nothing[:, None], nothing[:, None, None], nothing, nothing, nothing, nothing == 0.0
        )
        inputs = [row.u for row in self.rows]
        known = bool(inputs) and all(each is not None for each in inputs)
        u = np.stack([np.asarray(each) for each in inputs[:1] + inputs]) if known else None
        return History(
            np.array(times),
            _trajectory(ahead),
            _trajectory(after),
            innovation,
            u=u,
            beliefs=Beliefs(tuple(kept), tuple(_belief(belief) for belief in beliefs)),
        )


def _belief(carried: Any) -> Any:
    return carried.belief if isinstance(carried, Adapted) else carried


def _predicted(row: Row, carried: Any, t: float) -> Any:
    """What the step into a row predicted, with the noise that it was made with."""
    built, motion = row.estimator, row.estimator.motion
    if built.adapter is not None and isinstance(carried, Adapted):
        memory = carried.memories[row.sensor]
        motion, _ = built.adapter.tuned(memory, motion, built.sensors[row.sensor])
    return built.filter.predict(_belief(carried), motion, row.t - t, row.u, t)


def _trajectory(states: list[Gaussian]) -> Trajectory:
    return Trajectory(np.stack([s.mean for s in states]), np.stack([s.cov for s in states]))
