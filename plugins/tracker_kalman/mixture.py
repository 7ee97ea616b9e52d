"""What filters that keep several Gaussians do the same way; what makes each of them itself lives with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import finite, mahalanobis, mix, without_missing
from tracker.errors import CapabilityError, wording
from tracker.models import absolute, isnan, less, where
from tracker.models.graph import Node
from tracker.protocols import SensorModel
from tracker.recursion import is_random, lanes_of
from tracker.types import Innovation


def made(value: Any, kind: str = "filter") -> Any:
    """A component, or the registered one of that name."""
    if not isinstance(value, str):
        return value
    from tracker.registry import default_registry

    return default_registry().get(kind, value).make()


def gaussian_member(value: Any) -> Any:
    """A filter, itself or by its name, that can be a member of a mixture.

    Raises:
        CapabilityError: if it draws random numbers: members are begun, mixed and merged as Gaussians.
    """
    rule = made(value)
    if is_random(rule):
        raise CapabilityError(
            wording(
                "a member of a mixture",
                got=f"filter {type(rule).__name__}, which draws random numbers",
                expected="a Gaussian filter: mixing would replace its particles by their moments",
                do="pass for example 'ekf1' or 'ukf', or use the particle filter by itself",
            )
        )
    return rule


def begun(rule: Any, state: Any) -> Any:
    """A Gaussian as the kind of belief that a filter keeps."""
    return rule.begin(state) if hasattr(rule, "begin") else state


def of_each(work: Callable[..., Any], *values: Any) -> Any:
    """What ``work`` makes of beliefs, projections or arrays with an axis of members before the batch.

    On lanes members are lanes, too: they are worked at once. On graph nodes, which know of no lanes,
    one is worked after the other, and what comes out is put side by side.
    """
    count = _nodes_of(values)
    if not count:
        return work(*values)
    parts = [work(*lanes_of(values, k)) for k in range(count)]
    return _beside(parts)


def _nodes_of(value: Any) -> int:
    """How many members a value over graph nodes has; 0 if it is not made of nodes."""
    if isinstance(value, np.ndarray):
        return value.shape[-1] if value.dtype.hasobject else 0
    if attrs.has(type(value)):
        value = tuple(getattr(value, field.name) for field in attrs.fields(type(value)))
    return max(map(_nodes_of, value), default=0) if isinstance(value, tuple) else 0


def _beside(parts: Sequence[Any]) -> Any:
    """Values of the same kind, side by side along a last axis; settings are those of the first."""
    first = parts[0]
    if isinstance(first, (np.ndarray, Node, float)):
        return np.stack(parts, axis=-1).astype(object, copy=False)
    if isinstance(first, tuple):
        return tuple(_beside(some) for some in zip(*parts, strict=True))
    if not attrs.has(type(first)):
        return first
    made = object.__new__(type(first))
    for field in attrs.fields(type(first)):
        some = [getattr(part, field.name) for part in parts]
        object.__setattr__(made, field.name, _beside(some))
    return made


def chosen(condition: Any, belief: Any, other: Any) -> Any:
    """A belief where the condition holds, lane by lane, and elsewhere another, or a number throughout.

    Shapes:
        condition ``(*batch)``; beliefs of the same kind and shapes.
    """
    if isinstance(belief, np.ndarray):
        if not belief.dtype.hasobject:
            return belief if np.all(condition) else np.where(condition, belief, other)
        return where(condition, belief, other)
    single = isinstance(other, float)
    if isinstance(belief, tuple):
        others = (other,) * len(belief) if single else other
        return tuple(chosen(condition, a, b) for a, b in zip(belief, others, strict=True))
    if not attrs.has(type(belief)):
        return belief
    new = object.__new__(type(belief))
    for field in attrs.fields(type(belief)):
        part = other if single else getattr(other, field.name)
        part = chosen(condition, getattr(belief, field.name), part)
        object.__setattr__(new, field.name, part)
    return new


def together(z: Any, S: Any, weights: Any, sensor: SensorModel) -> tuple[Any, Any]:
    """The predicted measurement and its covariance, over all members.

    Shapes:
        z ``(m, K, *batch)``; S ``(m, m, K, *batch)``; weights ``(K, *batch)``.
    """
    return mix(z, S, weights, sensor.space.circular)


def innovation(
    sensor: SensorModel, z: Any, zhat: Any, S: Any, loglik: Any, count: Any
) -> Innovation:
    """The innovation of a mixture: NIS from its moments, the log-likelihood as it was found.

    A lane whose log-likelihood is not finite is not ok.
    """
    v = sensor.residual(z, zhat)
    whole, _ = without_missing(S, S, v)
    measured = np.stack([where(isnan(e), 0.0, e) for e in v])
    sound = less(absolute(loglik), math.inf)
    nis = where(sound, mahalanobis(measured, whole), math.nan)
    loglik = where(sound, where(less(0.0, count), loglik, 0.0), math.nan)
    return Innovation(v, S, nis, loglik, count, finite(nis))
