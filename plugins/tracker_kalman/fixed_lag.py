"""The fixed-lag smoother over a record: each state, given the measurements of so many more steps.

On line, one measurement after the other, it is `tracker.FixedLag`.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.late import whole_steps
from tracker.protocols import MotionModel
from tracker.types import Gaussian, History, Trajectory
from tracker_kalman.rts import RauchTungStriebel


@attrs.frozen
class FixedLagSmoother:
    """Smooths each step with the ``lag`` steps that follow it, as a system on line could, later.

    A lag of zero is the filter; a lag of the record's length or more is the fixed-interval smoother.
    ``smoother`` makes the single steps backwards: any smoother with a method ``step``, such as
    `RauchTungStriebel`. All windows that hold a step are worked at once, as one more batch axis, and
    share its gain.

    Raises:
        DomainError: if the lag is no whole number of steps, zero or more.
    Reference: Särkkä (2013), Bayesian Filtering and Smoothing, section 10.5; Anderson and Moore (1979),
        Optimal Filtering, section 7.3.
    Laws: those of kind "smoother" where the lag is as long as the record; each estimate is the
        least-squares solution of the record cut ``lag`` steps later.
    """

    lag: int = attrs.field(default=10)
    smoother: Any = attrs.field(factory=RauchTungStriebel)

    @lag.validator
    def _not_negative(self, _attribute: object, lag: int) -> None:
        whole_steps("parameter 'lag'", lag, 0)

    @property
    def needs(self) -> tuple[str, ...]:
        """What the smoother inside needs of the motion."""
        return tuple(self.smoother.needs)

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory; the last step equals the filter."""
        filtered, predicted, t = history.filtered, history.predicted, history.t
        mean, cov = np.empty_like(filtered.mean), np.empty_like(filtered.cov)
        last = len(history) - 1
        windows: Gaussian | None = None  # as a set before the batch; the one that ends last, first
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
                    windows = own
                elif k >= self.lag:  # no window of interest ends at other steps
                    windows = _joined(windows, own)
                mean[k], cov[k] = windows.mean[:, 0], windows.cov[:, :, 0]
                if k + self.lag <= last:  # the first window is needed no more
                    windows = None if k == 0 or self.lag == 0 else _rest(windows)
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))


def _set_of_one(state: Gaussian) -> Gaussian:
    return Gaussian.trusted(state.mean[:, None], state.cov[:, :, None])


def _joined(windows: Gaussian, own: Gaussian) -> Gaussian:
    return Gaussian.trusted(
        np.concatenate([windows.mean, own.mean], axis=1),
        np.concatenate([windows.cov, own.cov], axis=2),
    )


def _rest(windows: Gaussian) -> Gaussian:
    return Gaussian.trusted(windows.mean[:, 1:], windows.cov[:, :, 1:])
