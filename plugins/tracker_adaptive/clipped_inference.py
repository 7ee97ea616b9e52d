"""Mamdani's own inference: rules clip their output sets, and what the union balances on is the answer.

Exact: the union of clipped polygons is integrated piece by piece, not sampled. NumPy only; a filter's
loop wants `tracker_adaptive.fuzzy_system`, which is smooth and can be compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from tracker.errors import DomainError, wording
from tracker.models.parameters import one_of
from tracker.types import Array
from tracker_adaptive.fuzzy_rules import Is, worth
from tracker_adaptive.fuzzy_sets import (
    FuzzySet,
    GaussianSet,
    SampledSet,
    TriangularSet,
)
from tracker_adaptive.fuzzy_system import FuzzySystem

GAUSSIAN_PIECES = 200
"""Straight pieces that a GaussianSet output set is made of, over the range."""


@attrs.frozen(eq=False)
class Union:
    """The union of an output's clipped sets, as straight pieces.

    Shapes:
        edges ``(pieces, 2, *batch)``, where each piece begins and ends; height likewise, the membership
        at its two ends. Pieces are in order, and fill the range; some have no width.
    """

    edges: Array = attrs.field(repr=False)
    height: Array = attrs.field(repr=False)

    @property
    def area(self) -> Array:
        """Area under the union, ``(*batch)``."""
        return np.asarray(self._areas.sum(axis=0))

    @property
    def _areas(self) -> Array:
        width = self.edges[:, 1] - self.edges[:, 0]
        return np.asarray(0.5 * width * (self.height[:, 0] + self.height[:, 1]))

    def centroid(self) -> Array:
        """Where the union balances, ``(*batch)``; NaN where it is empty."""
        a, b = self.edges[:, 0], self.edges[:, 1]
        low, high = self.height[:, 0], self.height[:, 1]
        moments = (b - a) * (low * (2.0 * a + b) + high * (a + 2.0 * b)) / 6.0
        return _ratio(moments.sum(axis=0), self.area)

    def bisector(self) -> Array:
        """Where half of the area is on either side, ``(*batch)``; NaN where it is empty."""
        areas = self._areas
        passed = np.cumsum(areas, axis=0)
        half = 0.5 * passed[-1]
        k = np.argmax(passed >= half, axis=0)[None]

        def at(values: Array) -> Array:
            return np.asarray(np.take_along_axis(values, k, axis=0)[0])

        a, b = at(self.edges[:, 0]), at(self.edges[:, 1])
        low, high = at(self.height[:, 0]), at(self.height[:, 1])
        left = half - (at(passed) - at(areas))
        slope = np.divide(high - low, b - a, out=np.zeros_like(a), where=b > a)
        # low s + slope s^2 / 2 = left, by the root that does not cancel
        root = np.sqrt(np.maximum(low * low + 2.0 * slope * left, 0.0)) + low
        part = np.divide(2.0 * left, root, out=np.zeros_like(a), where=root > 0)
        return np.where(passed[-1] > 0, np.minimum(a + part, b), np.nan)

    def maxima(self) -> tuple[Array, Array, Array]:
        """Mean, smallest and largest place of the greatest membership, each ``(*batch)``."""
        both = (2 * len(self.edges), *self.edges.shape[2:])
        flat, heights = self.edges.reshape(both), self.height.reshape(both)
        wide = np.repeat(self.edges[:, 1] > self.edges[:, 0], 2, axis=0).reshape(heights.shape)
        heights = np.where(wide, heights, -1.0)
        top = heights.max(axis=0)
        best = heights >= top - 1e-12
        low = np.where(best, flat, np.inf).min(axis=0)
        high = np.where(best, flat, -np.inf).max(axis=0)
        none = top <= 0.0
        # The mean over all places at the top: over flat pieces by their width.
        level = (np.abs(self.height - top) <= 1e-12).all(axis=1)
        width = np.where(level, self.edges[:, 1] - self.edges[:, 0], 0.0)
        middle = 0.5 * (self.edges[:, 0] + self.edges[:, 1])
        mean = np.where(width.sum(axis=0) > 0, _ratio((width * middle).sum(axis=0), width.sum(axis=0)),
                        0.5 * (low + high))  # fmt: skip
        mean, low, high = (np.where(none, np.nan, v) for v in (mean, low, high))
        return mean, low, high


def _ratio(a: Any, b: Any) -> Array:
    found = np.divide(a, b, out=np.full(np.shape(b), np.nan), where=np.asarray(b) > 0)
    return np.asarray(found)


def _corners(one: FuzzySet, low: float, high: float) -> list[float]:
    """Where a set bends."""
    if isinstance(one, SampledSet):
        return list(one.places)
    if isinstance(one, GaussianSet):
        return [float(v) for v in np.linspace(low, high, GAUSSIAN_PIECES + 1)]
    if isinstance(one, TriangularSet):
        return [one.left, one.peak, one.right]
    return [one.left, one.top_left, one.top_right, one.right]


def _lines(one: FuzzySet, a: Array, b: Array) -> tuple[Array, Array]:
    """Memberships just inside the ends of intervals in which a set is straight."""
    if isinstance(one, GaussianSet):
        return one.membership(a), one.membership(b)
    # At the ends themselves a set may jump; within, two places tell of the line.
    first, second = one.membership(0.75 * a + 0.25 * b), one.membership(0.25 * a + 0.75 * b)
    return 1.5 * first - 0.5 * second, 1.5 * second - 0.5 * first


def _strengths(system: FuzzySystem, inputs: tuple[Any, ...]) -> dict[str, Array]:
    """How far each output term applies: "and" the smaller, "or" the larger, the largest of its rules."""
    known = dict(zip((v.name for v in system.inputs), system.inputs, strict=True))
    values = {
        v.name: np.asarray(v.within(np.asarray(x, dtype=np.float64)))
        for v, x in zip(system.inputs, inputs, strict=True)
    }

    def member(claim: Is) -> Any:
        return known[claim.variable].terms[claim.term].membership(values[claim.variable])

    out: dict[str, Any] = {}
    for rule in system.rules:
        found = rule.weight * worth(rule.antecedent, member, np.minimum, np.maximum)
        out[rule.term] = np.maximum(out[rule.term], found) if rule.term in out else found
    shape = np.broadcast_shapes(*(np.shape(v) for v in values.values()))
    return {term: np.broadcast_to(found, shape) for term, found in out.items()}


def union_of(system: FuzzySystem, *inputs: Any) -> Union:
    """The union of the output's sets, each clipped at the strength of its rules.

    Shapes:
        inputs scalars or ``(*batch)``.

    Raises:
        DomainError: if the output has no range, or numbers that differ per lane.
    """
    output = system.output
    if output.range is None or any(np.ndim(v) for v in output.numbers().values()):
        raise DomainError(
            wording(
                f"output {output.name!r} of a clipped fuzzy system",
                got="no range" if output.range is None else "numbers that differ per lane",
                expected="a range, and the same sets in every lane",
                do="give Variable(..., range=(low, high)), and one system per set of numbers",
            )
        )
    low, high = output.range
    strengths = _strengths(system, inputs)
    sets = [output.terms[term] for term in strengths]
    grid = np.unique([low, high, *(c for one in sets for c in _corners(one, low, high))])
    grid = grid[(grid >= low) & (grid <= high)]
    a, b = grid[:-1], grid[1:]
    levels = np.stack(list(strengths.values()))  # (terms, *batch)
    batch = levels.shape[1:]
    lines = [_lines(one, a, b) for one in sets]
    lead = (len(a), *(1,) * len(batch))
    start = np.stack([p.reshape(lead) for p, _ in lines])  # (terms, pieces, 1...)
    slope = np.stack([(q - p).reshape(lead) for p, q in lines])
    cap = levels[:, None]

    # Where a line meets its cap, another line, or another's cap, the union may bend: as parts of a piece.
    zero = np.zeros((len(a), *batch))
    cuts = [zero, zero + 1.0]

    def meets(value: Any, change: Any) -> None:
        part = np.divide(-value, change, out=np.zeros(np.broadcast_shapes(np.shape(value), np.shape(change))),
                         where=change != 0)  # fmt: skip
        cuts.append(np.clip(part, 0.0, 1.0) + zero)

    for i in range(len(sets)):
        for j in range(len(sets)):
            meets(start[i] - cap[j], slope[i] + 0.0 * cap[j])
            if i < j:
                meets(start[i] - start[j], slope[i] - slope[j])
    parts = np.sort(np.stack(cuts, axis=1), axis=1)  # (pieces, cuts, *batch)
    heights = np.max(
        np.minimum(start[:, :, None] + slope[:, :, None] * parts, cap[:, None]), axis=0
    )
    heights = np.maximum(heights, 0.0)
    at = (
        a.reshape(-1, *(1,) * (parts.ndim - 1))
        + (b - a).reshape(-1, *(1,) * (parts.ndim - 1)) * parts
    )

    def pairs(values: Array) -> Array:
        both = np.stack([values[:, :-1], values[:, 1:]], axis=2)
        return both.reshape(both.shape[0] * both.shape[1], 2, *batch)

    return Union(pairs(at), pairs(heights))


_READINGS: dict[str, Callable[[Union], Array]] = {
    "centroid": Union.centroid,
    "bisector": Union.bisector,
    "mean of maxima": lambda union: union.maxima()[0],
    "smallest of maxima": lambda union: union.maxima()[1],
    "largest of maxima": lambda union: union.maxima()[2],
}


def clipped(system: FuzzySystem, *inputs: Any, reading: str = "centroid") -> Any:
    """Mamdani's answer: smallest and largest for "and" and "or", sets clipped, united, and read off.

    ``reading`` is "centroid", "bisector", or "mean", "smallest" or "largest of maxima". Where no
    rule applies it is the system's ``otherwise``. Triangles, trapezia and sampled sets are
    integrated exactly; a GaussianSet output set is taken for 200 straight pieces.

    Shapes:
        inputs scalars or ``(*batch)``; the answer likewise.

    Raises:
        DomainError: if the output has no range, or for an unknown reading.
    Source: Mamdani and Assilian (1975); Wang, A Course in Fuzzy Systems and Control, 1997, section 8.1.

    Example:
    >>> from tracker_adaptive.fuzzy_system import Variable
    >>> x = Variable("x", {"on": TriangularSet(0.0, 1.0, 2.0)})
    >>> y = Variable("y", {"up": TriangularSet(0.0, 0.0, 3.0)}, range=(0.0, 3.0))
    >>> round(float(clipped(FuzzySystem(x, y, [("x is on", "up")]), 1.0)), 12)
    1.0
    """
    read = _READINGS[one_of("reading", reading, tuple(_READINGS))]
    union = union_of(system, *inputs)
    found = np.where(union.area > 0.0, read(union), system.otherwise)
    return float(found) if found.ndim == 0 else found
