"""One step of an estimator - predict, update, adapt - and what is carried from step to step.

Loops over records, checks of what users pass, and compiled steps live elsewhere: all of them run this.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, wording
from tracker.types import Gaussian, Innovation, Step

__all__ = [
    "Adapted",
    "advance",
    "begin",
    "is_random",
    "joined",
    "lanes_of",
    "unseen",
    "why_unsmoothable",
    "why_untunable",
]


@attrs.frozen(eq=False)
class Adapted:
    """A belief beside a noise adapter's memories, one for each sensor."""

    belief: Any
    memories: tuple[Any, ...]

    def moments(self) -> Gaussian:
        """Mean and covariance of the belief."""
        return self.belief.moments()  # type: ignore[no-any-return]


def is_random(filter_: Any) -> bool:
    """Whether a filter draws random numbers."""
    return bool(getattr(filter_, "random", False))


def _asks_for(name: str, method: Any) -> bool:
    return name in inspect.signature(method).parameters


def why_untunable(adapter: Any, sensors: Sequence[Any]) -> str:
    """Why an adapter cannot serve these sensors, or ''."""
    if adapter is None or len(sensors) == 1 or "Q" not in adapter.tunes:
        return ""
    return (
        f"adapter {type(adapter).__name__} re-tunes the process noise, and must see every measurement "
        f"for that: got {len(sensors)} sensors; expected one. Do this: join them to one stack of "
        "sensors (tracker_sensors.stack), or use an adapter of measurement noise alone."
    )


def unseen(filter_: Any, motion: Any, smoother: Any = None) -> str:
    """In words, what a smoother of moments does not see of a filter's beliefs; '' if nothing.

    Without a smoother: what any that sees no beliefs would not.
    """
    more = _beyond(filter_, motion, smoother)
    if not more:
        return ""
    name = "a smoother of moments" if smoother is None else f"smoother {type(smoother).__name__}"
    names = _listed(filter_.smoothers)
    way = f"use smoother {names}" if names else "compare it with the filter before you trust it"
    return (
        f"{name} sees only mean and covariance of what filter {type(filter_).__name__} believes, "
        f"{more}, and takes it for one Gaussian: {way}."
    )


def why_unsmoothable(filter_: Any, motion: Any, smoother: Any) -> str:
    """Why a smoother cannot follow a filter: it says so itself, or would see moments of draws; or ''."""
    if hasattr(smoother, "why_not_after") and (why := smoother.why_not_after(filter_)):
        return str(why)
    more = _beyond(filter_, motion, smoother) if is_random(filter_) else ""
    if not more:
        return ""
    names = _listed(filter_.smoothers)
    return wording(
        f"smoother {type(smoother).__name__} after filter {type(filter_).__name__}",
        got=f"{more}, of which it sees only mean and covariance",
        expected="a smoother that sees them",
        do=f"pass smoother={names}"
        if names
        else "leave the smoother out; none here serves this filter",
    )


def _beyond(filter_: Any, motion: Any, smoother: Any) -> str:
    blind = smoother is None or "beliefs" not in smoother.needs
    return filter_.beyond_moments(motion) if blind and hasattr(filter_, "beyond_moments") else ""


def _listed(names: Sequence[str]) -> str:
    return " or ".join(map(repr, names))


def begin(
    filter_: Any,
    adapter: Any,
    motion: Any,
    sensors: Sequence[Any],
    prior: Any,
    pose: Any = None,
    rng: Any = None,
) -> Any:
    """What is carried into the first step: the belief, and what the adapter remembers.

    Shapes:
        prior of any batch shape; pose ``(p, *batch)`` of the first row, or None; rng a generator,
        or a sequence with one per lane.

    Raises:
        CapabilityError: if the filter draws random numbers and has no generator.
    """
    if isinstance(prior, Adapted):
        return prior
    belief = prior
    if hasattr(filter_, "begin"):
        offered = {"motion": motion, "sensors": sensors}
        known = {k: v for k, v in offered.items() if _asks_for(k, filter_.begin)}
        if not is_random(filter_):
            belief = filter_.begin(prior, **known)
        elif rng is not None or type(prior) is not Gaussian:
            belief = filter_.begin(prior, rng=rng, **known)
        else:
            raise CapabilityError(
                f"filter {type(filter_).__name__} draws random numbers: got no generator. "
                "Do this: pass rng=np.random.default_rng(seed), to tk.filter or to estimator.begin."
            )
    if adapter is None:
        return belief
    moments = belief.moments()
    memories = []
    for sensor in sensors:
        size = sensor.pose_space.size
        where = None if pose is None or not size else pose[:size]
        memories.append(adapter.begin(motion, sensor, moments, where))
    return Adapted(belief, tuple(memories))


def advance(
    filter_: Any,
    adapter: Any,
    carried: Any,
    motion: Any,
    sensor: Any,
    which: int,
    z: Any,
    dt: Any,
    u: Any = None,
    t: Any = None,
    pose: Any = None,
) -> tuple[Any, Any, Any, Innovation]:
    """Predict ``dt`` seconds ahead, update with z, let the adapter learn from it.

    Returns:
        what is carried into the next step, predicted belief, filtered belief, innovation.
    """
    if adapter is None:
        predicted = filter_.predict(carried, motion, dt, u, t)
        belief, innovation = filter_.update(predicted, sensor, z, pose)
        return belief, predicted, belief, innovation
    memory = carried.memories[which]
    motion, sensor = adapter.tuned(memory, motion, sensor)
    predicted = filter_.predict(carried.belief, motion, dt, u, t)
    belief, innovation = filter_.update(predicted, sensor, z, pose)
    done = Step(dt, pose, predicted.moments(), belief.moments(), innovation)
    learnt = adapter.adapt(memory, done, motion, sensor)
    before, after = carried.memories[:which], carried.memories[which + 1 :]
    return Adapted(belief, (*before, learnt, *after)), predicted, belief, innovation


def lanes_of(value: Any, index: Any) -> Any:
    """Some lanes of a belief, picked on its last batch axis; a slice gives views."""
    if isinstance(value, np.ndarray):
        shared = value.shape[-1] == 1 and isinstance(index, slice)
        return value if shared else value[..., index]
    if isinstance(value, tuple):
        return tuple(lanes_of(v, index) for v in value)
    if not attrs.has(type(value)):
        return value
    made = object.__new__(type(value))
    for field in attrs.fields(type(value)):
        object.__setattr__(made, field.name, lanes_of(getattr(value, field.name), index))
    return made


def joined(parts: Sequence[Any]) -> Any:
    """Beliefs side by side, as `lanes_of` with slices of two lanes or more has parted them."""
    first = parts[0]
    if isinstance(first, np.ndarray):
        return first if first.shape[-1] == 1 else np.concatenate(parts, axis=-1)
    if isinstance(first, tuple):
        return tuple(joined(some) for some in zip(*parts, strict=True))
    if not attrs.has(type(first)):
        return first
    made = object.__new__(type(first))
    for field in attrs.fields(type(first)):
        some = [getattr(part, field.name) for part in parts]
        object.__setattr__(made, field.name, joined(some))
    return made
