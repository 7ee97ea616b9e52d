"""Where sensors are at each time: still, straight, weaving, and several beside each other.

Paths that are chosen for what they let one see are planners' business.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.protocols import ObserverPath
from tracker.types import Array, ArrayLike, as_array

__all__ = ["Straight", "Together", "Weaving"]


def _vector(value: ArrayLike) -> Array:
    array = np.array(as_array(value, "a place or velocity"))
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ShapeError(
            wording(
                "an observer's path",
                got=f"shape {array.shape}" if array.ndim != 1 else "NaN or inf",
                expected="finite numbers, (d,): one for each axis",
                do="pass for example (-900.0, -200.0, -100.0)",
            )
        )
    return array


def _like_place(instance: Any, attribute: Any, value: Array) -> None:
    if len(value) != len(instance.place):
        raise ShapeError(
            wording(
                f"argument {attribute.name!r} of an observer's path",
                got=f"{len(value)} axes",
                expected=f"{len(instance.place)}, as the place has",
                do="give one number per axis",
            )
        )


def _moved(place: Array, velocity: Array, t: Any) -> Array:
    times = np.asarray(t, dtype=np.float64)
    axes = (slice(None), *(None,) * times.ndim)
    return np.asarray(place[axes] + velocity[axes] * times)


@attrs.frozen(eq=False)
class Straight:
    """At constant velocity from ``place`` at time 0; without a velocity it stands still.

    Shapes:
        place, velocity ``(d,)``; `pose` of times of any shape is ``(d, *t.shape)``.
    Units:
        m, m/s, s.
    Reference:
        paper 4, eq. 4-11 (still), section 5.5 (straight).

    Example:
    >>> Straight((0.0, 1.0), (2.0, 0.0)).pose(np.array([0.0, 3.0])).tolist()
    [[0.0, 6.0], [1.0, 1.0]]
    """

    place: Annotated[Array, "m"] = attrs.field(converter=_vector)
    velocity: Annotated[Array, "m/s"] = attrs.field(converter=_vector, validator=_like_place)

    @velocity.default
    def _still(self) -> Array:
        return np.zeros_like(self.place)

    def pose(self, t: Any) -> Array:
        """Where it is at some times."""
        return _moved(self.place, self.velocity, t)


@attrs.frozen(eq=False)
class Weaving:
    """At a mean velocity with a sine on it: ``v(t) = velocity + sway sin(2 pi t / period)``.

    Shapes:
        place, velocity, sway ``(d,)``; `pose` of times of any shape is ``(d, *t.shape)``.
    Units:
        m, m/s, s.

    Raises:
        DomainError: if the period is not positive.
    Reference:
        our choice for section 5.6 of paper 4, whose profile is not given.
    Laws:
        after whole periods it is where the mean velocity takes it, off by ``sway period / 2 pi``
        never more than twice on the way.

    Example:
    >>> Weaving((0.0,), (1.0,), (5.0,), period=10.0).pose(10.0).round(9).tolist()
    [10.0]
    """

    place: Annotated[Array, "m"] = attrs.field(converter=_vector)
    velocity: Annotated[Array, "m/s"] = attrs.field(converter=_vector, validator=_like_place)
    sway: Annotated[Array, "m/s"] = attrs.field(converter=_vector, validator=_like_place)
    period: Annotated[float, "s"]

    def __attrs_post_init__(self) -> None:
        if not (np.isfinite(self.period) and self.period > 0.0):
            raise DomainError(
                wording(
                    "argument 'period'",
                    got=self.period,
                    expected="a positive number of seconds",
                    do="pass for example 100.0",
                )
            )

    def pose(self, t: Any) -> Array:
        """Where it is at some times: the integral of its velocity."""
        times = np.asarray(t, dtype=np.float64)
        turn = 2.0 * np.pi / self.period
        axes = (slice(None), *(None,) * times.ndim)
        swung = self.sway[axes] * (1.0 - np.cos(turn * times)) / turn
        return np.asarray(_moved(self.place, self.velocity, times) + swung)


def _all(paths: Iterable[ObserverPath]) -> tuple[ObserverPath, ...]:
    return tuple(paths)


@attrs.frozen(eq=False)
class Together:
    """Several observers: their poses end to end, as a stack of sensors reads them.

    Shapes:
        `pose` ``(d1 + d2 + ..., *t.shape)``.

    Example:
    >>> Together((Straight((0.0, 1.0)), Straight((2.0, 3.0)))).pose(5.0).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """

    paths: tuple[ObserverPath, ...] = attrs.field(converter=_all)

    def pose(self, t: Any) -> Array:
        """Where they are at some times."""
        return np.concatenate([one.pose(t) for one in self.paths])
