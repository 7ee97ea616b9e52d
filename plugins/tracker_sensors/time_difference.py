"""Differences of the times at which one wave front reaches several receivers; delays between several
paths to one receiver do not belong here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import attrs

from tracker.errors import ShapeError, wording
from tracker.models import ComponentSensor, one_of, positive, sqrt
from tracker.types import PLANAR, SPATIAL, ArrayLike, Axis, Space, as_array


@attrs.frozen
class _Delays:
    """Delay of each receiver but the first, against the first."""

    receivers: int
    axes: int

    @property
    def positional(self) -> tuple[str, ...]:
        return ("x", "y", "z")[: self.axes]

    @property
    def pose(self) -> tuple[str, ...]:
        places = range(1, self.receivers + 1)
        return tuple(f"s{axis}_{i}" for i in places for axis in self.positional)

    @property
    def keywords(self) -> tuple[str, ...]:
        return (*self.pose, "speed")

    def __call__(self, *target: Any, speed: Any, **pose: Any) -> Any:
        places = [pose[name] for name in self.pose]
        ranges = []
        for start in range(0, len(places), self.axes):
            receiver = places[start : start + self.axes]
            ranges.append(sqrt(sum((a - b) ** 2 for a, b in zip(target, receiver, strict=True))))
        return tuple((r - ranges[0]) / speed for r in ranges[1:])


@attrs.frozen
class _ArrivalNoise:
    """Independent errors of the arrival times: differences share that of the first receiver."""

    delays: int
    positional: tuple[str, ...] = ()
    keywords: tuple[str, ...] = ("sigma",)

    def __call__(self, *, sigma: Any) -> Any:
        k, variance = range(self.delays), sigma**2
        return tuple(tuple(2.0 * variance if i == j else variance for j in k) for i in k)


@attrs.frozen
class _DelayNoise:
    """Independent errors of the delays themselves."""

    delays: int
    positional: tuple[str, ...] = ()
    keywords: tuple[str, ...] = ("sigma",)

    def __call__(self, *, sigma: Any) -> Any:
        k = range(self.delays)
        return tuple(tuple(sigma**2 if i == j else 0.0 for j in k) for i in k)


_NOISE: dict[str, Callable[[int], Callable[..., Any]]] = {
    "arrivals": _ArrivalNoise,
    "delays": _DelayNoise,
}


def time_difference(
    sigma: Annotated[ArrayLike, "s"],
    *,
    receivers: Annotated[int | ArrayLike, "m"] = 2,
    speed: Annotated[ArrayLike, "m/s"] = 1500.0,
    errors: str = "arrivals",
    axes: int = 2,
    state: Space | None = None,
) -> ComponentSensor:
    """Delays of arrival at receivers 2, 3, ... against receiver 1 (TDOA).

    ``receivers`` is how many there are, their places being given as pose at each step; or an array
    of their fixed places, one row each. With ``errors='arrivals'`` (default) sigma is the error of
    each arrival time, so the delays are correlated through the first receiver:
    ``R = sigma^2 (I + 1 1')``. With ``errors='delays'`` sigma is the error of each delay, as a
    correlator measures it between two receivers, and ``R = sigma^2 I``. ``speed`` is the speed of
    propagation: by default that of sound in sea water.

    Shapes:
        receivers an int or ``(count, axes)``; measurement ``(count - 1, *batch)``; pose
        ``[sx_1, sy_1, (sz_1,) sx_2, ...]``, ``(count axes, *batch)``, none if they are fixed.
    Units:
        s, m, m/s.

    Raises:
        DomainError: if sigma or speed is not positive, or ``errors`` or ``axes`` is not offered.
        ShapeError: if there are fewer than two receivers, or their places do not have ``axes``
            coordinates.
    Reference:
        Chan and Ho, A simple and efficient estimator for hyperbolic location, IEEE Transactions on
        Signal Processing 42 (1994) 1905-1915.
    Laws:
        those of kind "sensor"; swapping two receivers of a pair changes the sign.

    Example:
    >>> pair = time_difference(1e-3, receivers=[[0.0, 0.0], [1500.0, 0.0]])
    >>> pair.h([1500.0, 0.0, 0.0, 0.0]).tolist()
    [-1.0]
    >>> time_difference(0.1, receivers=3).R([0.0] * 4, [0.0] * 6).round(3).tolist()
    [[0.02, 0.01], [0.01, 0.02]]
    """
    one_of("axes", axes, (2, 3))
    one_of("errors", errors, tuple(_NOISE))
    count = receivers if isinstance(receivers, int) else _count(receivers, axes)
    if count < 2:
        raise ShapeError(
            wording(
                "parameter 'receivers'",
                got=f"{count}",
                expected="at least 2 receivers",
                do="give how many there are, or one row of coordinates for each",
            )
        )
    measure = _Delays(count, axes)
    sensor = ComponentSensor(
        name="time_difference",
        measure=measure,
        noise=_NOISE[errors](count - 1),
        space=Space(tuple(Axis(f"delay_{i}", "s") for i in range(2, count + 1))),
        pose_space=Space(tuple(Axis(name, "m") for name in measure.pose)),
        state=state or (SPATIAL if axes == 3 else PLANAR),
        planar=axes == 2,
        parameters={
            "sigma": positive("sigma", sigma, unit="s"),
            "speed": positive("speed", speed, unit="m/s"),
        },
    )
    if isinstance(receivers, int):
        return sensor
    places = as_array(receivers, "receivers").ravel().tolist()
    return sensor.at(**dict(zip(measure.pose, places, strict=True)))


def _count(receivers: ArrayLike, axes: int) -> int:
    places = as_array(receivers, "receivers")
    if places.ndim != 2 or places.shape[1] != axes:
        raise ShapeError(
            wording(
                "parameter 'receivers'",
                got=f"shape {places.shape}",
                expected=f"(count, {axes}): {axes} coordinates for each receiver",
                do="give one row per receiver, or set axes",
            )
        )
    return len(places)
