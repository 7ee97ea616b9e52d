"""What a question along a path is asked with - times, sensors, covariances - checked; no answers here."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.errors import CapabilityError, DomainError, ShapeError, wording
from tracker.types import Array, as_array, checked_covariance


def checked_times(t: Any, steps: int, batch: tuple[int, ...] = ()) -> Array:
    """Times that are finite and never decrease, ``(T,)`` or ``(T, *batch)``.

    Raises:
        ShapeError, DomainError: if they are not that.
    """
    times = as_array(t, "t")
    if times.shape not in {(steps,), (steps, *batch)}:
        raise ShapeError(
            wording(
                "argument 't'",
                got=f"shape {times.shape} for {steps} states",
                expected=f"({steps},)" + (f" or {(steps, *batch)}" if batch else ""),
                do="give one time per state",
            )
        )
    if not np.isfinite(times).all() or (np.diff(times, axis=0) < 0).any():
        raise DomainError(
            wording(
                "argument 't'",
                got="NaN, inf, or a time before the one above it",
                expected="finite seconds that never decrease",
                do="sort times, states and what goes with them by time",
            )
        )
    return times


def checked_sensors(
    motion: Any, sensors: Any, sensor: Any, steps: int
) -> tuple[list[Any], npt.NDArray[np.intp]]:
    """Sensors over the motion's state, and which of them measured at each step.

    Raises:
        CapabilityError: if something is no sensor of such states.
        DomainError: if it is not said which of several measured, or one is named that is not there.
        ShapeError: if ``sensor`` is not one whole number per step.
    """
    several = isinstance(sensors, Sequence) and not isinstance(sensors, str)
    models = [_over(motion, one) for one in (sensors if several else [sensors])]
    if not models:
        raise CapabilityError(
            wording("argument 'sensors'", got="none", expected="at least one sensor", do="give one")
        )
    if sensor is None:
        if len(models) > 1:
            raise DomainError(
                wording(
                    "argument 'sensor'",
                    got="nothing",
                    expected=f"which of the {len(models)} sensors measured at each step",
                    do="give each step's sensor by its place among them, or pass one stack of sensors",
                )
            )
        return models, np.zeros(steps, dtype=np.intp)
    which = np.asarray(sensor)
    if which.shape != (steps,) or not np.issubdtype(which.dtype, np.integer):
        raise ShapeError(
            wording(
                "argument 'sensor'",
                got=f"{which.dtype} of shape {which.shape}",
                expected=f"integers of shape ({steps},)",
                do="give each step's sensor by its place among them",
            )
        )
    bad = which[(which < 0) | (which >= len(models))]
    if bad.size:
        raise DomainError(
            wording(
                "argument 'sensor'",
                got=f"sensor {int(bad[0])}",
                expected=f"0 to {len(models) - 1}",
                do="give as many sensors as are named",
            )
        )
    return models, which.astype(np.intp)


def _over(motion: Any, sensor: Any) -> Any:
    if not hasattr(sensor, "h"):
        raise CapabilityError(
            wording(
                "argument 'sensors'",
                got=repr(sensor)[:60],
                expected="a sensor, or a list of sensors",
                do="make one by its name: tracker.sensors.make('position', sigma=5.0)",
            )
        )
    state = getattr(sensor, "state", motion.space)
    if state.names == motion.space.names:
        return sensor
    if hasattr(sensor, "over"):
        return sensor.over(motion.space)
    raise CapabilityError(
        wording(
            f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
            got=f"a sensor that reads states ({state})",
            expected=f"states of the motion model ({motion.space})",
            do="build it with state=motion.space",
        )
    )


def checked_rows(name: str, values: Any, steps: int, least: int = 0) -> Any:
    """Rows of poses, inputs or flags, one per step and wide enough; None stays None.

    Raises:
        ShapeError: if they are not that.
    """
    if values is None:
        return None
    rows = np.asarray(values)
    if rows.ndim < 2 or len(rows) != steps or rows.shape[1] < least:
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {rows.shape}",
                expected=f"({steps}, {least}, ...)" if least else f"({steps}, ...)",
                do="give one row per time, components second",
            )
        )
    return rows


def covariance_along(name: str, value: Any, n: int, batch: tuple[int, ...]) -> Array:
    """A covariance for every lane, ``(n, n, *batch)``, from that or one for all.

    Raises:
        ShapeError: if its shape is another. DomainError: if it is not symmetric positive semi-definite.
    """
    if hasattr(value, "moments"):
        raise DomainError(
            wording(
                f"argument {name!r}",
                got="a Gaussian",
                expected=f"its covariance, {n} by {n}",
                do=f"pass {name}.cov",
            )
        )
    cov = as_array(value, name)
    if cov.shape not in {(n, n), (n, n, *batch)}:
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {cov.shape}",
                expected=f"a covariance of shape {(n, n)}"
                + (f" or {(n, n, *batch)}" * bool(batch)),
                do="pass np.diag(variances) if you have variances",
            )
        )
    return checked_covariance(cov, np.zeros((n, *batch)), name)


def checked_scenario(scenario: Any, runs: Any) -> None:
    """Refuse what is no scenario, and a number of runs that is none.

    Raises:
        CapabilityError, DomainError: if so.
    """
    if not hasattr(scenario, "simulate"):
        raise CapabilityError(
            wording(
                "argument 'scenario'",
                got=repr(scenario)[:60],
                expected="a scenario",
                do="make one by its name: tracker.scenario('two_stations')",
            )
        )
    if isinstance(runs, bool) or not isinstance(runs, Integral) or runs < 1:
        raise DomainError(
            wording(
                "argument 'runs'",
                got=repr(runs),
                expected="a whole number of runs, 1 or more",
                do="pass runs=100",
            )
        )
