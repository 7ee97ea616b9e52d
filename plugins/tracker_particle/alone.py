"""Lanes of many particles, one after the other: a cloud that fits the cache is worked while it is there.

What is done to a cloud lives in the filters; so does the arithmetic over all lanes at once, which pays
where particles are few or models differ from lane to lane.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.models.parameters import numbers_of
from tracker.types import Array, Innovation, Projection

FEW = 100
"""Up to so many particles, the calls cost more than the arithmetic: lanes are worked together."""


def are(log_weights: Array, model: Any) -> bool:
    """Whether the lanes of a belief are worked one after the other with this model."""
    if log_weights.ndim == 1 or len(log_weights) <= FEW or not log_weights.size:
        return False
    return not any(np.ndim(value) for value in numbers_of(model).values())


def predicted(rule: Any, state: Any, batch: tuple[int, ...], motion: Any, *given: Any) -> Any:
    """What ``rule.predict`` makes of each lane; given dt, u and t, shared or per lane."""
    dt, u, t = given
    return _joined(
        [
            rule.predict(cut(state, at), motion, _of(dt, 0, at), _of(u, 1, at), _of(t, 0, at))
            for at in np.ndindex(*batch)
        ],
        batch,
    )


def updated(
    rule: Any,
    state: Any,
    batch: tuple[int, ...],
    sensor: Any,
    z: Any,
    pose: Any,
    projection: Projection | None,
) -> tuple[Any, Innovation]:
    """What ``rule.update`` makes of each lane."""
    done = [
        rule.update(
            cut(state, at), sensor, z[(slice(None), *at)], _of(pose, 1, at), cut(projection, at)
        )
        for at in np.ndindex(*batch)
    ]
    told = [attrs.astuple(innovation, recurse=False) for _, innovation in done]
    fields = [np.stack(values, axis=-1) for values in zip(*told, strict=True)]
    shaped = [field.reshape(*field.shape[:-1], *batch) for field in fields]
    return _joined([state for state, _ in done], batch), Innovation(*shaped)


def lane_first(values: Array, batch: tuple[int, ...]) -> Array:
    """The same array, with each lane in one piece of memory."""
    count = len(batch)
    if not count:
        return values
    axes = tuple(range(-count, 0))
    first = np.ascontiguousarray(np.moveaxis(values, axes, range(count)))
    return np.moveaxis(first, range(count), axes)


def cut(value: Any, at: tuple[int, ...]) -> Any:
    """One lane of a belief."""
    if isinstance(value, np.ndarray):
        index: Any = (..., *at)
        return value[index]
    if not attrs.has(type(value)):
        return value
    made = object.__new__(type(value))
    for field in attrs.fields(type(value)):
        object.__setattr__(made, field.name, cut(getattr(value, field.name), at))
    return made


# ------------------------------------------------------------------------------------- inside
def _of(value: Any, lead: int, at: tuple[int, ...]) -> Any:
    """An argument of one lane: numbers with axes beyond their own have one for each."""
    if np.ndim(value) <= lead:
        return value
    index: Any = (..., *at)
    own = np.asarray(value)[index]
    return own if lead else float(own)


def _known(part: Any, name: str) -> Any:
    """A field of a lane; moments, lest they depend on whether all lanes have found them already."""
    if name == "known":
        return part.moments()
    if name == "known_size":
        return part.effective_sample_size
    return None if name == "memory" else getattr(part, name)


def _joined(parts: list[Any], batch: tuple[int, ...]) -> Any:
    """The belief whose lanes are these."""
    first = parts[0]
    if any(part is None for part in parts):
        return None
    if isinstance(first, (np.ndarray, np.floating, float)):
        stacked = np.stack(parts)  # each lane stays in one piece
        whole = stacked.reshape(*batch, *stacked.shape[1:])
        return np.moveaxis(whole, range(len(batch)), range(-len(batch), 0))
    if not attrs.has(type(first)):
        return first
    made = object.__new__(type(first))
    for field in attrs.fields(type(first)):
        own = [_known(part, field.name) for part in parts]
        object.__setattr__(made, field.name, _joined(own, batch))
    return made
