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
    as_array,
    brief,
)

__all__ = ["FixedLag", "Row", "whole_steps"]


def whole_steps(what: str, value: Any, least: int) -> None:
    """Refuse a lag that is no count of steps; ``what`` says whose it is.

    Raises:
        DomainError: if it is not a whole number, or below ``least``.
    """
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= least:
        return
    raise DomainError(
        wording(
            what,
            got=repr(value),
            expected=f"a whole number of steps, {least} or more; a lag is counted in measurements, "
            "not in seconds",
            do="pass lag=10; for a lag in seconds, divide it by the time between two measurements",
        )
    )


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

    ``begun`` is the oldest time that is kept, ``before`` the belief there, ``start`` the time of the
    prior.

    Raises:
        DomainError: if the lag is no whole number of steps, one or more.
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
    lag: int = attrs.field()
    begun: float
    before: Any = attrs.field(repr=False)
    rows: tuple[Row, ...] = ()
    start: float = attrs.field()

    @lag.validator
    def _steps(self, _attribute: object, lag: Any) -> None:
        whole_steps("argument 'lag'", lag, 1)

    @start.default
    def _as_begun(self) -> float:
        return self.begun

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
            DomainError: if the lag is no whole number of steps, one or more, or t is not finite.
        """
        whole_steps("argument 'lag'", lag, 1)
        return cls(estimator, int(lag), _time(t), estimator.begin(prior, pose=pose, rng=rng))

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
            z ``(m, *batch)``, NaN or masked where not measured; t a number, the same for all lanes.

        Raises:
            DomainError: if t is older than what is kept (`begun`), or not finite, or if a pose or an
                input holds what is not finite.
            ShapeError: if t differs from lane to lane, or z does not fit.
        """
        now, place = self._place(t)
        if u is None and place < len(self.rows):
            u = self.rows[place].u
        values = np.array(as_array(z, "z"))  # a copy: what was measured stays so
        where, given = _finite("pose", pose), _finite("u", u)
        new = Row(now, values, where, given, sensor, self.estimator, None, None)
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
            DomainError: if t is older than what is kept, or not finite.
            CapabilityError: if t is past and the estimator has no smoother.
        """
        (now, place), rows = self._place(t), self.rows
        if place == len(rows):
            ahead = Row(now, np.empty(0), None, None, 0, self.estimator, None, None)
            with np.errstate(all="ignore"):
                return _predicted(ahead, self.state, self.t).moments()  # type: ignore[no-any-return]
        nothing = np.full_like(rows[place].z, np.nan)
        blank = attrs.evolve(rows[place], t=now, z=nothing)
        whole = self._again((*rows[:place], blank, *rows[place:]), place)
        return attrs.evolve(self, rows=whole).smoothed()[1].at(place + 1)

    # ---------------------------------------------------------------------------- inside
    def _place(self, t: Any) -> tuple[float, int]:
        """A time as a number, and after how many rows it comes."""
        now = _time(t)
        if now < self.begun:
            left = now >= self.start  # once it was kept
            raise DomainError(
                wording(
                    "argument 't'",
                    got=f"{now} s",
                    expected=f"a time from {self.begun} s on, the oldest that is kept"
                    if left
                    else f"a time from {self.start} s on, that of the prior",
                    do=f"leave the measurement out, or begin with a lag of more than {self.lag} "
                    f"step{'s' * (self.lag > 1)}"
                    if left
                    else "leave the measurement out, or begin with a prior of an earlier time: "
                    "tk.FixedLag.begin(estimator, prior, t)",
                )
            )
        return now, bisect.bisect_right([row.t for row in self.rows], now)

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


def _time(t: Any) -> float:
    """One finite number of seconds.

    Raises:
        ShapeError: if there are several. DomainError: if it is not finite.
    """
    value = as_array(t, "t")
    if value.ndim:
        raise ShapeError(
            wording(
                "argument 't'",
                got=f"shape {value.shape}",
                expected="one time for all lanes",
                do="step lane by lane, or give NaN in the lanes that were not measured",
            )
        )
    if not np.isfinite(value):
        raise DomainError(
            wording(
                "argument 't'",
                got=f"{value} s",
                expected="a finite number of seconds",
                do="give the time of the measurement, or leave out one without a time",
            )
        )
    return float(value)


def _finite(name: str, values: Any) -> Any:
    """A pose or an input as an array of its own, or None."""
    if values is None:
        return None
    own = np.array(as_array(values, name))
    if not np.isfinite(own).all():
        raise DomainError(
            wording(
                f"argument {name!r}",
                got="NaN or inf",
                expected="finite numbers",
                do="fill the gap before the step",
            )
        )
    return own


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
