"""Fuzzy sets of one number: Gaussian, triangular, trapezoidal, and sampled; rules live elsewhere."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from tracker.errors import DomainError, wording
from tracker.models import exp, less, maximum, minimum, where
from tracker.models.graph import Node
from tracker.models.parameters import checked_parameters


def _number(_instance: Any, attribute: Any, value: Any) -> None:
    checked_parameters({attribute.name: value})


def _ordered(kind: str, **corners: Any) -> None:
    """Refuse corners that run backwards; graph nodes were checked as numbers."""
    names = list(corners)
    for a, b in itertools.pairwise(names):
        if isinstance(corners[a], Node) or isinstance(corners[b], Node):
            continue
        if np.any(np.asarray(corners[a]) > np.asarray(corners[b])):
            raise DomainError(
                wording(
                    f"{kind} set",
                    got=f"{a} = {corners[a]}, {b} = {corners[b]}",
                    expected=f"{' <= '.join(names)}",
                    do="give the corners from left to right",
                )
            )


@attrs.frozen(eq=False)
class GaussianSet:
    """``exp(-((x - centre) / width)^2)``.

    The width is that of the thesis: sqrt(2) standard deviations. As printed, eq. 3-10 lacks the
    square, and its "membership" would exceed one to the left of the centre.

    Shapes:
        centre, width scalars or ``(*batch)``; x likewise.
    Source: paper 4, eq. 3-10.

    Example:
    >>> round(GaussianSet(0.0, 2.0).membership(2.0), 4)
    0.3679
    """

    kind: ClassVar[str] = "gaussian"

    centre: Any = attrs.field(validator=_number)
    width: Any = attrs.field(validator=_number)

    def __attrs_post_init__(self) -> None:
        if not isinstance(self.width, Node) and not np.all(np.asarray(self.width) > 0.0):
            raise DomainError(
                wording(
                    "gaussian set",
                    got=f"width = {self.width}",
                    expected="a width above zero",
                    do="give centre and width",
                )
            )

    @property
    def middle(self) -> Any:
        """Where it is likeliest: what a centre-average defuzzifier takes for the set."""
        return self.centre

    def exponent(self, x: Any) -> Any:
        """The logarithm of the membership, bounded so that differences of two are numbers."""
        distance = (x - self.centre) * (1.0 / self.width)
        return maximum(-(distance * distance), -1e300)

    def membership(self, x: Any) -> Any:
        """How much x belongs to the set, 0 to 1."""
        return exp(self.exponent(x))


def _rise(x: Any, low: Any, high: Any) -> Any:
    """0 up to low, 1 from high on, linear between; a step where the two are equal."""
    steep = less(low, high)
    ramp = (x - low) / where(steep, high - low, 1.0)
    return maximum(minimum(where(steep, ramp, where(less(x, high), 0.0, 1.0)), 1.0), 0.0)


@attrs.frozen(eq=False)
class TrapezoidalSet:
    """Zero up to ``left`` and from ``right`` on, one between ``top_left`` and ``top_right``.

    Shapes:
        corners scalars or ``(*batch)``.

    Example:
    >>> TrapezoidalSet(1.0, 3.0, 6.0, 8.0).membership(2.0)
    0.5
    """

    kind: ClassVar[str] = "trapezoidal"

    left: Any = attrs.field(validator=_number)
    top_left: Any = attrs.field(validator=_number)
    top_right: Any = attrs.field(validator=_number)
    right: Any = attrs.field(validator=_number)

    def __attrs_post_init__(self) -> None:
        _ordered(self.kind, **{f.name: getattr(self, f.name) for f in attrs.fields(type(self))})

    @property
    def middle(self) -> Any:
        """The middle of the top."""
        return 0.5 * (self.top_left + self.top_right)

    def membership(self, x: Any) -> Any:
        """How much x belongs to the set, 0 to 1; NaN for NaN."""
        up, down = _rise(x, self.left, self.top_left), _rise(-x, -self.right, -self.top_right)
        return minimum(up, down)


@attrs.frozen(eq=False)
class TriangularSet:
    """Zero up to ``left`` and from ``right`` on, one at ``peak``.

    Shapes:
        corners scalars or ``(*batch)``.

    Example:
    >>> TriangularSet(0.0, 0.0, 5.0).membership(0.0)
    1.0
    """

    kind: ClassVar[str] = "triangular"

    left: Any = attrs.field(validator=_number)
    peak: Any = attrs.field(validator=_number)
    right: Any = attrs.field(validator=_number)

    def __attrs_post_init__(self) -> None:
        _ordered(self.kind, **{f.name: getattr(self, f.name) for f in attrs.fields(type(self))})

    @property
    def middle(self) -> Any:
        """The peak."""
        return self.peak

    def membership(self, x: Any) -> Any:
        """How much x belongs to the set, 0 to 1; NaN for NaN."""
        return minimum(_rise(x, self.left, self.peak), _rise(-x, -self.right, -self.peak))


def _floats(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


@attrs.frozen
class SampledSet:
    """Any set, by its membership at some places and straight lines between them; zero outside.

    Not traced: it is what other programs' sets become.

    Raises:
        DomainError: unless there are at least two places, in order, with memberships in [0, 1].

    Example:
    >>> float(SampledSet((0.0, 2.0), (0.0, 1.0)).membership(1.5))
    0.75
    """

    kind: ClassVar[str] = "sampled"

    places: tuple[float, ...] = attrs.field(converter=_floats)
    values: tuple[float, ...] = attrs.field(converter=_floats)

    def __attrs_post_init__(self) -> None:
        x, y = np.array(self.places), np.array(self.values)
        fits = len(x) == len(y) and len(x) >= 2
        if not fits or not np.all(np.diff(x) >= 0) or not np.all((y >= 0) & (y <= 1)):
            raise DomainError(
                wording(
                    "sampled set",
                    got=f"{len(x)} places, {len(y)} memberships",
                    expected="as many, at least two; places in order; memberships in [0, 1]",
                    do="sort the places, and scale the memberships to 1",
                )
            )

    @property
    def middle(self) -> float:
        """The middle of where the membership is largest."""
        top = max(self.values)
        best = [x for x, y in zip(self.places, self.values, strict=True) if math.isclose(y, top)]
        return 0.5 * (best[0] + best[-1])

    def membership(self, x: Any) -> Any:
        """How much x belongs to the set, 0 to 1."""
        return np.interp(x, self.places, self.values, left=0.0, right=0.0)


FuzzySet = GaussianSet | TriangularSet | TrapezoidalSet | SampledSet
"""A fuzzy set of one number."""

SETS: dict[str, type[Any]] = {one.kind: one for one in (GaussianSet, TriangularSet, TrapezoidalSet)}
"""Sets that are given by a few numbers, by their name."""


def numbers_of_set(one: FuzzySet) -> dict[str, Any]:
    """The numbers that a set is given by, by name; none for a sampled one."""
    if isinstance(one, SampledSet):
        return {}
    return {f.name: getattr(one, f.name) for f in attrs.fields(type(one))}
