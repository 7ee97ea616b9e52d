"""The fixed-lag smoother over a record: each state, given the measurements of so many more steps.

On line, one measurement after the other, it is `tracker.FixedLag`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, wording
from tracker.late import whole_steps
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History, Trajectory
from tracker_kalman.mixture import made
from tracker_kalman.rts import RauchTungStriebel, begun

MOST = 32
"""The longest lag of a compiled step, which has instructions of its own for each window."""


@attrs.frozen(eq=False)
class Windows:
    """The smoothed beliefs of a state in the windows that end there and 1, 2, ... steps later."""

    members: tuple[Any, ...]

    def moments(self) -> Gaussian:
        """Those of the window that ends last."""
        last: Gaussian = self.members[-1].moments()
        return last


def stepwise(value: Any) -> Any:
    """A smoother, itself or by its name, that goes back step by step and needs no beliefs.

    Raises:
        CapabilityError: for another.
    """
    smoother = made(value, "smoother")
    needs_beliefs = "beliefs" in getattr(smoother, "needs", ())
    if needs_beliefs or not hasattr(smoother, "step"):
        lacks = "which needs a filter's beliefs" if needs_beliefs else "which has no method 'step'"
        raise CapabilityError(
            wording(
                "parameter 'smoother'",
                got=f"{type(smoother).__name__}, {lacks}",
                expected="a smoother that goes back step by step from moments",
                do="pass 'rts', 'sigma_point_rts', 'square_root_rts' or 'two_filter'",
            )
        )
    return smoother


@attrs.frozen
class FixedLagSmoother:
    """Smooths each step with the ``lag`` steps that follow it, as a system on line could, later.

    A lag of zero is the filter; a lag of the record's length or more is the fixed-interval smoother.
    ``smoother`` makes the single steps backwards: any smoother of moments with a method ``step``, such as
    `RauchTungStriebel`, or the name of one. All windows that hold a step are worked at once, as one more batch axis, and
    share its gain.

    Raises:
        DomainError: if the lag is no whole number of steps, zero or more.
        CapabilityError: if the smoother does not go back step by step from moments.
    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, section 10.5; Anderson and Moore (1979),
        Optimal Filtering, section 7.3.
    Laws: those of kind "smoother" where the lag is as long as the record; each estimate is the
        least-squares solution of the record cut ``lag`` steps later.
    """

    lag: int = attrs.field(default=10)
    smoother: Any = attrs.field(factory=RauchTungStriebel, converter=stepwise)

    @lag.validator
    def _not_negative(self, _attribute: object, lag: int) -> None:
        whole_steps("parameter 'lag'", lag, 0)

    @property
    def needs(self) -> tuple[str, ...]:
        """What the smoother inside needs of the motion."""
        return tuple(self.smoother.needs)

    @property
    def why_opaque(self) -> str:
        """Why its step cannot be compiled, or ''."""
        if self.lag > MOST:
            return f"a lag of {self.lag} steps is too long to unroll (at most {MOST})"
        return str(getattr(self.smoother, "why_opaque", ""))

    def begin(self, filtered: Gaussian) -> Windows:
        """At the end of the record all windows end."""
        return Windows((begun(self.smoother, filtered),) * (self.lag + 1))

    def step(
        self,
        filtered: Gaussian,
        predicted: Gaussian,
        smoothed: Windows,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Windows:
        """The windows one step earlier: one that ends at k, and all but the last of those at k + 1."""
        known = (motion, dt, u, t)
        later = (
            self.smoother.step(filtered, predicted, w, *known) for w in smoothed.members[: self.lag]
        )
        return Windows((begun(self.smoother, filtered), *later))

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        filtered, predicted, t = history.filtered, history.predicted, history.t
        mean, cov = np.empty_like(filtered.mean), np.empty_like(filtered.cov)
        last, axes = len(history) - 1, len(filtered.batch)
        windows: Any = None  # as a set before the batch; the one that ends last, first
        count = 0
        with np.errstate(all="ignore"):
            for k in range(last, -1, -1):
                own = _set_of_one(filtered.at(k))
                if windows is not None:
                    u = None if history.u is None else history.u[k + 1][:, None]
                    ahead = _set_of_one(predicted.at(k + 1))
                    windows = self.smoother.step(
                        own, ahead, windows, motion, t[k + 1] - t[k], u, t[k]
                    )
                if windows is None:
                    windows, count = begun(self.smoother, own), 1
                elif k >= self.lag:  # no window of interest ends at other steps
                    new = begun(self.smoother, own)
                    windows = _on_sets(axes, partial(_joined, count), windows, new)
                    count += 1
                state = windows.moments()
                mean[k], cov[k] = state.mean[:, 0], state.cov[:, :, 0]
                if k + self.lag <= last:  # the first window is needed no more
                    none = k == 0 or self.lag == 0
                    windows = None if none else _on_sets(axes, partial(_rest, count), windows)
                    count -= 1
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))


def _set_of_one(state: Gaussian) -> Gaussian:
    return Gaussian.trusted(state.mean[:, None], state.cov[:, :, None])


def _joined(count: int, at: int, some: Any, more: Any) -> Any:
    """Sets on axis ``at``, one after the other; the first has ``count`` windows, or one value for all."""
    if some.shape[at] != count:
        some = np.repeat(some, count, axis=at)
    return np.concatenate([some, more], axis=at)


def _rest(count: int, at: int, some: Any) -> Any:
    """All windows but the first; one value for all stays."""
    return some if some.shape[at] != count else some[(slice(None),) * at + (slice(1, None),)]


def _on_sets(axes: int, function: Callable[..., Any], *beliefs: Any) -> Any:
    """A function of arrays, on those of beliefs over a set and ``axes`` batch axes."""
    first = beliefs[0]
    if isinstance(first, np.ndarray):
        return function(first.ndim - axes - 1, *beliefs)
    if isinstance(first, tuple):
        return tuple(_on_sets(axes, function, *parts) for parts in zip(*beliefs, strict=True))
    if not attrs.has(type(first)):
        return first
    made = object.__new__(type(first))
    for field in attrs.fields(type(first)):
        parts = (getattr(belief, field.name) for belief in beliefs)
        object.__setattr__(made, field.name, _on_sets(axes, function, *parts))
    return made
