"""Which candidates are better when there are several objectives: dominance, fronts, crowding, volume.

Costs are ``(objectives, N)`` of one restart. How new candidates are made belongs to the algorithms.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.errors import ShapeError, wording
from tracker.types import Array

Places = npt.NDArray[np.intp]


def dominance(cost: Any, violation: Any = None) -> npt.NDArray[np.bool_]:
    """Who dominates whom, ``(N, N)``: entry ``[i, j]`` if i dominates j.

    i dominates j if it is nowhere worse and somewhere better. With constraints: what violates them
    less dominates what violates them more, and costs count only between those that violate nothing.

    Shapes:
        cost ``(objectives, N)``; violation ``(N,)``, 0 where no constraint is violated, or None.

    Reference:
        Deb, Pratap, Agarwal and Meyarivan 2002, sections III-A and VI (definition 1).
    """
    f = np.asarray(cost, dtype=np.float64)
    if f.ndim != 2:
        raise ShapeError(
            wording("cost", got=f"shape {f.shape}", expected="(objectives, N)",
                    do="pass the candidates of one restart")
        )  # fmt: skip
    no_worse = np.ones((f.shape[1],) * 2, dtype=bool)
    better = np.zeros_like(no_worse)
    for row in f:
        no_worse &= row[:, None] <= row
        better |= row[:, None] < row
    better &= no_worse
    if violation is None or not np.any(violation):
        return better
    v = np.asarray(violation, dtype=np.float64)
    better &= (v[:, None] == 0.0) & (v == 0.0)
    better |= v[:, None] < v
    return better


def fronts(cost: Any, violation: Any = None, enough: int | None = None) -> list[Places]:
    """Fronts, best first: places of those dominated by none but members of earlier fronts.

    ``enough`` stops when that many have a front. Arguments as `dominance`.

    Reference:
        Deb et al. 2002, fast-non-dominated-sort.

    Example:
    >>> [front.tolist() for front in fronts([[1.0, 2.0, 3.0], [3.0, 2.0, 3.0]])]
    [[0, 1], [2]]
    """
    beats = dominance(cost, violation)
    count = len(beats)
    wanted = count if enough is None else min(enough, count)
    above = np.add.reduce(beats, axis=0, dtype=np.intp)
    out, found = [], 0
    while found < wanted:
        front = np.flatnonzero(above == 0)
        out.append(front)
        found += front.size
        above -= np.add.reduce(beats[front], axis=0, dtype=np.intp)
        above[front] = -1
    return out


def crowding(cost: Any) -> Array:
    """Crowding distance ``(N,)`` of the members of one front: how far apart their neighbours are.

    The sum over objectives of the difference between the next on either side, relative to the range
    in the front; infinite at the ends.

    Reference:
        Deb et al. 2002, crowding-distance-assignment. Some programs divide by the number of
        objectives; the paper does not.

    Example:
    >>> crowding([[0.0, 1.0, 3.0, 4.0], [4.0, 3.0, 1.0, 0.0]]).tolist()
    [inf, 1.5, 1.5, inf]
    """
    f = np.asarray(cost, dtype=np.float64)
    count = f.shape[1]
    out = np.zeros(count)
    if count <= 2:
        out[:] = math.inf
        return out
    f = np.where(np.isfinite(f), f, 0.0)  # who has an infinite cost shares a front with its like
    order = f.argsort(axis=1, kind="stable")
    sorted_ = np.take_along_axis(f, order, axis=1)
    width = sorted_[:, -1] - sorted_[:, 0]
    gaps = (sorted_[:, 2:] - sorted_[:, :-2]) / np.where(width > 0.0, width, 1.0)[:, None]
    for places, gap in zip(order, gaps, strict=True):
        out[places[1:-1]] += gap
        out[places[[0, -1]]] = math.inf
    return out


def hypervolume(cost: Any, reference: Any) -> float:
    """The volume between a reference point and what the candidates dominate; larger is better.

    Shapes:
        cost ``(objectives, N)``; reference ``(objectives,)``. Candidates that do not dominate the
        reference add nothing.

    Reference:
        Zitzler and Thiele 1998; computed slice by slice, which suits two or three objectives.

    Example:
    >>> hypervolume([[1.0, 2.0], [2.0, 1.0]], [3.0, 3.0])
    3.0
    """
    f, corner = np.asarray(cost, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    f = f[:, (f < corner[:, None]).all(axis=0)]
    if not f.size:
        return 0.0
    if len(f) == 1:
        return float(corner[0] - f.min())
    order = f[-1].argsort(kind="stable")
    levels = np.append(f[-1, order], corner[-1])
    if len(f) == 2:
        reach = np.minimum.accumulate(f[0, order])
        return float(np.sum((corner[0] - reach) * np.diff(levels)))
    slabs = (
        (levels[k + 1] - levels[k]) * hypervolume(f[:-1, order[: k + 1]], corner[:-1])
        for k in range(len(order))
        if levels[k + 1] > levels[k]
    )
    return float(sum(slabs))
