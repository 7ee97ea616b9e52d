"""Choosing which particles go on, how often each: four schemes, exchangeable, each O(N).

A scheme is a value that says how many uniforms it needs for N particles and turns weights and
uniforms into ancestors. Expected counts are ``N w`` in all of them; they differ in the variance. When
to resample, and what becomes of the chosen, is a filter's affair.

Reference: Douc, Cappé and Moulines 2005, Comparison of resampling schemes for particle filtering;
    Hol, Schön and Gustafsson 2006, On resampling algorithms for particle filters.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, wording
from tracker.types import Array

_GRAIN = 1e-9
_BELOW_ONE = 1.0 - 2.0**-53

Ancestors = npt.NDArray[np.intp]


class Scheme(Protocol):
    """How ancestors are chosen.

    Laws: the expected number of copies of a particle is N times its weight; a particle of weight
    zero has none; ancestors come in ascending order; a lane without weights keeps its particles.
    """

    def numbers(self, count: int) -> int:
        """How many uniforms a lane of ``count`` particles needs."""
        ...

    def __call__(self, weights: Array, uniform: Array) -> Ancestors:
        """Ancestors ``(N, *batch)`` for weights ``(N, *batch)`` and uniforms ``(numbers, *batch)``.

        Weights need not sum to one.
        """
        ...


@attrs.frozen
class Systematic:
    """One uniform moves a comb of N teeth over the cumulated weights: the usual choice.

    Reference: Carpenter, Clifford and Fearnhead 1999; Kitagawa 1996.
    """

    def __str__(self) -> str:
        return "systematic"

    def numbers(self, count: int) -> int:  # noqa: ARG002 - the protocol's
        """One."""
        return 1

    def __call__(self, weights: Array, uniform: Array) -> Ancestors:
        """Ancestors, ``(N, *batch)``."""
        below = np.add.accumulate(weights, axis=0)
        below *= len(weights) / below[-1]
        below -= np.minimum(uniform, 1.0 - _GRAIN)  # N - u must not round to N - 1
        return _ancestors(np.ceil(below, out=below))


@attrs.frozen
class Stratified:
    """One uniform in each of N equal strata of the cumulated weights.

    Reference: Kitagawa 1996, appendix A.
    """

    def __str__(self) -> str:
        return "stratified"

    def numbers(self, count: int) -> int:
        """One for each particle."""
        return count

    def __call__(self, weights: Array, uniform: Array) -> Ancestors:
        """Ancestors, ``(N, *batch)``."""
        count = len(weights)
        below = _cumulated(weights)
        below *= count
        stratum = np.floor(below)
        inside = below - stratum
        own = np.fmin(stratum, count - 1).astype(np.intp)  # a lane that is NaN looks anywhere
        # All teeth of earlier strata lie below, and that of the own stratum perhaps.
        stratum += np.take_along_axis(uniform, own, axis=0) < inside
        return _ancestors(stratum)


@attrs.frozen
class Multinomial:
    """N independent draws: the scheme that theory begins with, and the one of largest variance.

    Reference: Gordon, Salmond and Smith 1993; sorted uniforms from exponential spacings, Devroye
        1986, chapter V, theorem 2.2.
    """

    def __str__(self) -> str:
        return "multinomial"

    def numbers(self, count: int) -> int:
        """One for each spacing between N sorted numbers."""
        return count + 1

    def __call__(self, weights: Array, uniform: Array) -> Ancestors:
        """Ancestors, ``(N, *batch)``."""
        spacings = np.cumsum(-np.log1p(-uniform), axis=0)
        teeth = np.fmin(spacings[:-1] / spacings[-1], _BELOW_ONE)
        return _ancestors(_merged(_cumulated(weights), teeth))


@attrs.frozen
class Residual:
    """``floor(N w)`` copies of each particle for certain, and multinomial draws for the rest.

    Reference: Liu and Chen 1998, section 3.2.
    """

    def __str__(self) -> str:
        return "residual"

    def numbers(self, count: int) -> int:
        """As many as the multinomial scheme."""
        return count + 1

    def __call__(self, weights: Array, uniform: Array) -> Ancestors:
        """Ancestors, ``(N, *batch)``."""
        count = len(weights)
        share = weights * (count / np.add.reduce(weights, axis=0))
        # Without the grain, shares that should be whole and are an ulp below would be left to chance.
        certain = np.floor(share + _GRAIN)
        left = np.maximum(share - certain, 0.0)
        open_ = count - np.add.reduce(certain, axis=0)
        spacings = np.cumsum(-np.log1p(-uniform), axis=0)
        known = np.where(np.isfinite(open_), open_, 0.0).astype(np.intp)
        last = np.take_along_axis(spacings, known[None], axis=0)
        places = np.arange(count).reshape(-1, *(1,) * (weights.ndim - 1))
        teeth = np.where(places < known, np.fmin(spacings[:-1] / last, _BELOW_ONE), np.inf)
        # Where nothing is left to chance any weights do.
        drawn = _merged(_cumulated(np.where(open_ > 0, left, 1.0)), teeth)
        return _ancestors(np.cumsum(certain, axis=0) + np.where(open_ > 0, drawn, 0.0))


SYSTEMATIC = Systematic()
SCHEMES: Mapping[str, Scheme] = MappingProxyType({
    "systematic": SYSTEMATIC,
    "stratified": Stratified(),
    "residual": Residual(),
    "multinomial": Multinomial(),
})  # fmt: skip
"""The schemes by name."""


def scheme(value: str | Scheme) -> Scheme:
    """The scheme of that name, or the one that is given.

    Raises:
        DomainError: if there is no scheme of that name.
    """
    if not isinstance(value, str):
        return value
    if value not in SCHEMES:
        raise DomainError(
            wording(
                "parameter 'resampling'",
                got=repr(value),
                expected=f"one of {', '.join(SCHEMES)}, or a scheme",
                do="choose one of them",
            )
        )
    return SCHEMES[value]


# ------------------------------------------------------------------------------------- inside
def _cumulated(weights: Array) -> Array:
    """Cumulated weights that end at one exactly, from the last particle that has any weight on."""
    total = np.add.accumulate(weights, axis=0)
    total /= total[-1].copy()
    return total


def _merged(edges: Array, teeth: Array) -> Array:
    """How many of the ascending teeth lie below each of the ascending edges, ``(N, *batch)``.

    Two ascending runs are merged, which is what a stable sort does in O(N).
    """
    count = len(edges)
    # Edges first, so that of equals the edge comes first: a tooth on an edge is not below it.
    order = np.argsort(np.concatenate([edges, teeth]), axis=0, kind="stable")
    edge = order < count
    teeth_so_far = np.cumsum(~edge, axis=0)
    batch = edges.shape[1:]
    # Each lane has as many edges as any other: they come out in order, lane by lane.
    picked = np.moveaxis(teeth_so_far, 0, -1)[np.moveaxis(edge, 0, -1)]
    below = np.moveaxis(picked.reshape(*batch, count), -1, 0).astype(np.float64)
    return np.where(np.isnan(edges), np.nan, below)


def _ancestors(copies: Array) -> Ancestors:
    """Ancestors from the number of copies that a particle and all before it have together.

    Where these are not numbers, every particle is its own ancestor: such a lane has diverged.
    """
    count, batch = len(copies), copies.shape[1:]
    lost = np.isnan(copies[-1])
    if np.count_nonzero(lost):
        own = np.arange(1.0, count + 1.0).reshape(-1, *(1,) * len(batch))
        copies = np.where(lost, own, copies)
    places: Any = copies.astype(np.intp)
    if not batch:
        return np.add.accumulate(np.bincount(places, minlength=count + 1)[:count])
    lanes = copies[0].size
    flat = places.reshape(count, lanes) + np.arange(lanes) * (count + 1)
    begun = np.bincount(flat.ravel(), minlength=lanes * (count + 1)).reshape(lanes, count + 1)
    out = np.add.accumulate(begun[:, :count], axis=1)
    return np.ascontiguousarray(out.T).reshape(count, *batch)
