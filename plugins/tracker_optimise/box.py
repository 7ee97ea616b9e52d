"""What every optimiser here shares: the box it searches, seen as the unit cube, and how it is begun.

Memories keep individuals in the unit cube, where bounds are 0 and 1 and no parameter's unit matters.
How individuals move belongs to the optimisers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, ShapeError, wording
from tracker.types import Array, brief
from tracker_optimise.draws import BEGIN, Keys, keys, uniforms

_WORST = np.array(math.inf)


@attrs.frozen(eq=False)
class Box:
    """Bounds of the parameters, with axes for population and restarts.

    Shapes:
        low, width, high ``(d, 1, *ones)``: one 1 for each batch axis of the restarts.
    """

    low: Array = attrs.field(repr=brief)
    width: Array = attrs.field(repr=brief)
    high: Array = attrs.field(repr=brief)
    rounds: bool
    """Whether rounding may lead beyond the upper bounds."""

    @classmethod
    def of(cls, bounds: Any, axes: int) -> Box:
        """From bounds ``(d, 2)``, for restarts on so many batch axes.

        Raises:
            ShapeError: if bounds are not ``(d, 2)``.
            DomainError: if a bound is not finite, or a lower one is above its upper one.
        """
        pairs = np.array(bounds, dtype=np.float64)
        if pairs.ndim != 2 or pairs.shape[1:] != (2,) or not len(pairs):
            raise ShapeError(
                wording("bounds", got=f"shape {pairs.shape}", expected="(d, 2), d at least 1",
                        do="pass one row [low, high] per parameter")
            )  # fmt: skip
        width = pairs[:, 1] - pairs[:, 0]
        if not (np.isfinite(width).all() and (width >= 0.0).all()):
            bad = int(np.flatnonzero(~(np.isfinite(width) & (width >= 0.0)))[0])
            raise DomainError(
                wording(f"bounds of parameter {bad}", got=pairs[bad].tolist(),
                        expected="two finite numbers, low <= high", do="correct that row")
            )  # fmt: skip
        shape = (len(pairs), 1, *(1,) * axes)
        low, high = (np.ascontiguousarray(row).reshape(shape) for row in pairs.T)
        width = width.reshape(shape)
        # Sums and products are monotone: if the upper corner is inside, everything is.
        return cls(low, width, high, bool((low + width > high).any()))

    def outside(self, unit: Array) -> Array:
        """Candidates ``(d, population, *restarts)`` of individuals in the unit cube; never beyond."""
        out = unit * self.width
        out += self.low
        return np.minimum(out, self.high, out=out) if self.rounds else out

    def inside(self, x: Array) -> Array:
        """Individuals in the unit cube of candidates; a parameter without width is at 0."""
        width = np.where(self.width > 0.0, self.width, 1.0)
        return (x - self.low) / width


@attrs.frozen(eq=False)
class Beginning:
    """What an optimiser begins with: the box, keys, and a first population ``(d, P, *restarts)``."""

    box: Box
    key: Keys
    asked: Array
    spare: Array
    """Uniforms for what else is drawn at the beginning, ``(count, lanes)``."""


def begin(
    bounds: Any,
    population: int,
    rng: np.random.Generator | Sequence[np.random.Generator],
    restarts: tuple[int, ...],
    start: Any,
    spare: int = 0,
) -> Beginning:
    """A first population: given individuals first, the others uniform in the box.

    Shapes:
        bounds ``(d, 2)``; start ``(d, k)`` for all restarts or ``(d, k, *restarts)``, k at most the
        population, or None.

    Raises:
        ShapeError: if shapes do not fit.
        DomainError: if bounds make no box, or a given individual lies outside it.
    """
    restarts = tuple(restarts)
    box = Box.of(bounds, len(restarts))
    d = len(box.low)
    key = keys(rng, restarts)
    drawn = uniforms(key, BEGIN, d * population + spare)
    asked = drawn[: d * population].reshape(d, population, *restarts)
    if start is not None:
        given = _given(start, box, population, restarts)
        asked = np.concatenate([given, asked[:, given.shape[1] :]], axis=1)
    return Beginning(box, key, asked, drawn[d * population :])


def _given(start: Any, box: Box, population: int, restarts: tuple[int, ...]) -> Array:
    given = np.asarray(start, dtype=np.float64)
    d = len(box.low)
    if given.ndim == 2:
        given = given.reshape(*given.shape, *(1,) * len(restarts))
    fits = given.ndim == 2 + len(restarts) and len(given) == d and given.shape[1] <= population
    fits = fits and all(a in {1, b} for a, b in zip(given.shape[2:], restarts, strict=True))
    if not fits:
        raise ShapeError(
            wording("individuals to start from", got=f"shape {np.shape(start)}",
                    expected=f"({d}, k) or ({d}, k, *restarts) with k at most {population} and "
                    f"restarts {restarts}",
                    do="put one individual in each column")
        )  # fmt: skip
    if not ((given >= box.low) & (given <= box.high)).all():
        raise DomainError(
            wording("individuals to start from", got="one outside the bounds, or NaN",
                    expected="parameters within their bounds", do="widen the bounds, or move it")
        )  # fmt: skip
    unit = box.inside(given)
    return np.broadcast_to(unit, (d, unit.shape[1], *restarts))


def told(cost: Any, asked: Array, rows: int = 1) -> Array:
    """The cost ``(rows, population, lanes)`` of what was asked; NaN is the worst, infinity.

    Raises:
        ShapeError: if it is not ``(rows, population, *restarts)``.
    """
    given = np.asarray(cost, dtype=np.float64)
    wanted = (rows, *asked.shape[1:])
    if given.shape != wanted:
        more = (
            " A cost of several objectives needs an optimiser for that: nsga2." if rows == 1 else ""
        )
        raise ShapeError(
            wording("cost", got=f"shape {given.shape}", do="return one number per candidate",
                    expected=f"(objectives, population, *restarts) = {wanted}") + more
        )  # fmt: skip
    return flat(np.fmin(given, _WORST))


def flat(asked: Array) -> Array:
    """Individuals with the restarts on one axis: ``(d, population, lanes)``."""
    if asked.ndim == 3:
        return asked
    return asked.reshape(*asked.shape[:2], math.prod(asked.shape[2:]))


def picked(x: Array, index: npt.NDArray[np.intp]) -> Array:
    """Individuals ``x (d, P, lanes)`` at places ``index (k, lanes)`` of their own restart: ``(d, k, lanes)``."""
    d, _, count = x.shape
    if count == 1:
        out: Array = x.take(index.reshape(-1), axis=1)
    else:
        out = x.reshape(d, -1).take(index * count + np.arange(count), axis=1)
    return out


def parts(drawn: Array, sizes: Sequence[int]) -> list[Array]:
    """Rows of what was drawn, cut into parts of these sizes."""
    out, at = [], 0
    for size in sizes:
        out.append(drawn[at : at + size])
        at += size
    return out
