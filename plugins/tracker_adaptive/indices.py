"""What the thesis judges an adaptive filter by, J1 to J4; the degree of mismatch itself is in `mismatch`."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once
from tracker.errors import CapabilityError, DomainError, wording
from tracker.metrics.errors import error
from tracker.types import Array, History
from tracker_adaptive.mismatch import degree_of_mismatch


@attrs.frozen
class NoiseError:
    """J1: RMS over time of what was measured less what is true, for each measured component.

    What was not measured does not count. It judges the problem, not the filter.

    Shapes:
        truth ``(T, n, *batch)``; score ``(m, *batch)``.
    Reference:
        paper 4, eq. 3-15.
    """

    def score(self, history: History, truth: Array) -> Array:
        """The RMS of the noise."""
        run = _run(history)
        return _rms(_off(run, np.asarray(run.record.z), _seen(run, truth)), skip=True)


@attrs.frozen
class MeasuredError:
    """J2: RMS over time of the estimate as the sensor would measure it less the truth likewise.

    Shapes:
        truth ``(T, n, *batch)``; score ``(m, *batch)``.
    Reference:
        paper 4, eq. 3-16, 4-42 and 5-23; for a component that is a state, the same as `StateError`.
    """

    def score(self, history: History, truth: Array) -> Array:
        """The RMS of the error in measured components."""
        run = _run(history)
        return _rms(_off(run, _seen(run, np.asarray(history.estimate.mean)), _seen(run, truth)))


@attrs.frozen
class StateError:
    """J3: RMS over time of the error of each state.

    Shapes:
        truth ``(T, n, *batch)``; score ``(n, *batch)``.
    Reference:
        paper 4, eq. 3-17.
    """

    def score(self, history: History, truth: Array) -> Array:
        """The RMS of the error in states."""
        space = _run(history).estimator.motion.space
        return _rms(error(truth, np.asarray(history.estimate.mean), space))


@attrs.frozen
class MismatchCost:
    """J4: ``alpha`` times the RMS over time of the degree of mismatch, for each measured component.

    Their sum is the cost by which the thesis tunes. The mismatch counts once a window has passed: the
    first steps, in which the thesis sets the sample to zero, would outweigh all others. The truth
    does not enter.

    Shapes:
        score ``(m, *batch)``.

    Raises:
        DomainError: unless alpha is positive and the window at least one step.
    Reference:
        paper 4, eq. 3-18 (its entries), 3-19 (their sum), 4-43 and 5-24.
    """

    alpha: float = 1000.0
    window: int = 25

    def __attrs_post_init__(self) -> None:
        if not (np.isfinite(self.alpha) and self.alpha > 0.0 and self.window >= 1):
            raise DomainError(
                wording(
                    "parameters 'alpha' and 'window'",
                    got=f"{self.alpha} and {self.window}",
                    expected="a positive number, and a window of at least one step",
                    do="leave them out, or pass 1000.0 and 25",
                )
            )

    def score(self, history: History, truth: Array) -> Array:  # noqa: ARG002 - as every metric
        """The RMS of the mismatch."""
        found = degree_of_mismatch(history.innovation, self.window)
        dom = np.array(np.einsum("tii...->ti...", found.dom))
        dom[: self.window - 1] = 0.0
        return np.asarray(self.alpha * _rms(dom))


def _run(history: History) -> Any:
    run = history.run
    if run is None or len(run.estimator.sensors) != 1:
        got = "a history by itself" if run is None else f"{len(run.estimator.sensors)} sensors"
        raise CapabilityError(
            wording(
                "what J1 to J3 are of",
                got=got,
                expected="a history that `tk.filter` made, of one sensor",
                do="keep what tk.filter returns; join sensors to a stack",
            )
        )
    return run


def _seen(run: Any, states: Array) -> Array:
    """What the sensor would measure of states ``(T, n, *batch)`` without noise, ``(T, m, *batch)``."""
    (sensor,), x, pose = run.estimator.sensors, np.moveaxis(states, 1, 0), None
    if run.record.pose is not None and sensor.pose_space.size:
        pose = np.moveaxis(np.asarray(run.record.pose)[:, : sensor.pose_space.size], 1, 0)
        pose = np.broadcast_to(
            pose.reshape(*pose.shape, *(1,) * (x.ndim - pose.ndim)), (len(pose), *x.shape[1:])
        )
    with at_once():
        return np.moveaxis(np.asarray(sensor.h(x, pose)), 1, 0)


def _off(run: Any, one: Array, other: Array) -> Array:
    """Differences of measurements, through the sensor's residual: angles wrap."""
    (sensor,) = run.estimator.sensors
    gap = sensor.residual(np.moveaxis(one, 1, 0), np.moveaxis(other, 1, 0))
    return np.asarray(np.moveaxis(np.asarray(gap), 0, 1))


def _rms(values: Array, *, skip: bool = False) -> Array:
    """Over time; ``skip`` leaves NaN out."""
    kept = ~np.isnan(values) if skip else np.ones(values.shape, dtype=bool)
    squares = np.where(kept, values, 0.0) ** 2
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(squares.sum(axis=0) / kept.sum(axis=0)))
