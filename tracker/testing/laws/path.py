"""Laws of observers' paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, law
from tracker.types import Array

_BEGINS, _ENDS = -100.0, 1000.0


def _times(case: Case, shape: tuple[int, ...]) -> Array:
    return np.asarray(case.rng.uniform(_BEGINS, _ENDS, shape))


def _poses(path: Any, t: Array) -> tuple[Any, ...]:
    return (path.pose(t[0]),)


@calls_of("path")
def path_calls(_path: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a path is asked: times are its batch."""
    given = (Given("t", _times(case, (1, *batch)), 1),)
    return [Call("pose", _poses, given, (1,), batch)]


@law("path", name="a pose at every time")
def everywhere(path: Any, case: Case) -> None:
    """There is a pose of the same components, all finite, at any time: before the start as well."""
    size = len(np.asarray(path.pose(0.0)))
    for shape in ((), (5,), (2, 0), (2, 3)):
        pose = np.asarray(path.pose(_times(case, shape)))
        assert pose.shape == (size, *shape), (
            f"poses at times of shape {shape} have shape {pose.shape}: expected {(size, *shape)}"
        )
        assert np.isfinite(pose).all(), "a pose is not finite"


@law("path", name="goes, does not jump", examples=3)
def goes(path: Any, case: Case) -> None:
    """In ever shorter times it goes ever less far, wherever it goes farthest: an observer has a speed."""
    ends = np.sort(np.concatenate([[_BEGINS, _ENDS], _times(case, (200,))]))
    early, late = ends[:-1], ends[1:]
    whole = float(np.abs(np.diff(np.asarray(path.pose(ends)), axis=-1)).max(initial=0.0))
    for _ in range(35):  # of each stretch the half on which it goes farther
        middle = 0.5 * (early + late)
        a, b, c = (np.asarray(path.pose(t)) for t in (early, middle, late))
        first = np.abs(b - a).max(axis=0) >= np.abs(c - b).max(axis=0)
        early, late = np.where(first, early, middle), np.where(first, middle, late)
    left = np.abs(np.asarray(path.pose(late)) - np.asarray(path.pose(early))).max(axis=0)
    at = int(np.argmax(left))
    assert left[at] <= 1e-6 * max(1.0, whole), f"it jumps by {left[at]:.3g} at t = {late[at]:.6g}"
