"""How far innovations are from what a filter expects of them: the degree of mismatch, and its window.

What an adapter does about it lives in the adapter's own module.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.adaptation import Window
from tracker.algebra import residual
from tracker.models import absolute, isnan, less, maximum, minimum, where
from tracker.types import Array, Innovation, Step

LARGEST = 1e150
"""Squares are cut here, so that sums and differences of them are numbers."""


@attrs.frozen(eq=False)
class Squares:
    """Mean squares over the last so many steps, of what was measured in them.

    Sums are kept by adding what comes and taking away what falls out of the window. What rounding
    leaves behind by that - after a gross outlier, everything - is gone within another window: a
    second sum, begun anew each time a window has passed, then takes over.

    Shapes:
        window ``(length, 2 k, *batch)``: squares, then whether there was one; total, fresh, count
        ``(k, *batch)``; steps ``(1, *batch)``, which goes on from twice the length at the length.
    """

    window: Window
    total: Any
    fresh: Any
    count: Any
    steps: Any
    length: int

    @classmethod
    def of(cls, length: int, k: int, batch: tuple[int, ...]) -> Squares:
        """No squares yet."""
        zero = np.zeros((k, *batch))
        window = Window.of(length, np.zeros((2 * k, *batch)))
        return cls(window, zero, zero, zero, np.zeros((1, *batch)), length)

    def after(self, values: Any) -> Squares:
        """With the squares of one more step, ``(k, *batch)``, NaN where there is none."""
        k, n = len(values), float(self.length)
        missing = isnan(values)
        new, seen = where(missing, 0.0, minimum(values, LARGEST)), where(missing, 0.0, 1.0)
        oldest = self.window.oldest
        steps = where(less(2.0 * n - 0.5, self.steps), n, self.steps) + 1.0
        # After n, 2 n, 3 n, ... steps the second sum is that of exactly the window.
        whole = where(
            less(absolute(steps - n), 0.5), 1.0, where(less(2.0 * n - 0.5, steps), 1.0, 0.0)
        )
        over = less(0.5, whole)
        fresh = self.fresh + new
        return Squares(
            self.window.pushed(np.concatenate([new, seen])),
            where(over, fresh, self.total + new - oldest[:k]),
            where(over, 0.0, fresh),
            self.count + seen - oldest[k:],
            steps,
            self.length,
        )

    @property
    def mean(self) -> Any:
        """Mean of what was measured, ``(k, *batch)``; 0 where nothing was."""
        return self.total / maximum(self.count, 1.0)

    @property
    def known(self) -> Any:
        """How many squares the mean is of, ``(k, *batch)``; 0 until a window has passed."""
        return where(less(self.steps, self.length - 0.5), 0.0, self.count)

    @property
    def trusted(self) -> Any:
        """Whether a window has passed, and half of it was measured, ``(k, *batch)``."""
        return less(0.5 * self.length - 0.25, self.known)


def diagonal_of(A: Any) -> Any:
    """The diagonal of matrices, ``(n, *batch)``."""
    n = len(A)
    out = np.empty((n, *A.shape[2:]), dtype=A.dtype)
    for i in range(n):
        out[i] = A[i, i]
    return out


def corrections(step: Step, circular: tuple[bool, ...]) -> tuple[Any, Any]:
    """Squares of what the update added to the state, and their expectation ``P- - P+``.

    By both, process noise is judged in the state's own components, whatever was measured and by
    whichever filter. NaN where nothing was expected to change.

    Shapes:
        both ``(n, *batch)``.
    """
    gone = residual(step.filtered.mean, step.predicted.mean, circular)
    expected = diagonal_of(step.predicted.cov) - diagonal_of(step.filtered.cov)
    # Relative to what was there, lest rounding be taken for information.
    nothing = less(expected, 1e-12 * diagonal_of(step.predicted.cov) + 1e-290)
    measured = where(less(step.innovation.count, 0.5), np.nan, 1.0)
    return where(nothing, np.nan, gone * gone * measured), where(nothing, np.nan, expected)


@attrs.frozen(eq=False)
class Mismatch:
    """Theory, sample and their difference over time, as the thesis draws them.

    Shapes:
        theory S, sample C and dom ``S - C``: each ``(T, m, m, *batch)``.
    """

    theory: Array = attrs.field(repr=False)
    sample: Array = attrs.field(repr=False)
    dom: Array = attrs.field(repr=False)

    def cost(self, alpha: float = 1000.0) -> Array:
        """``alpha`` times the sum over components of the RMS over time of the diagonal, ``(*batch)``.

        Source: paper 4, eq. 3-19.
        """
        return np.asarray(alpha * np.sqrt(np.mean(self._diagonal**2, axis=0)).sum(axis=0))

    def rms(self, alpha: float = 1000.0) -> Array:
        """``alpha`` times the RMS of each diagonal entry over time, ``(m, *batch)``.

        Source: paper 4, eq. 3-18.
        """
        return np.asarray(alpha * np.sqrt(np.mean(self._diagonal**2, axis=0)))

    @property
    def _diagonal(self) -> Array:
        return np.asarray(np.einsum("kii...->ki...", self.dom))


def degree_of_mismatch(innovation: Innovation, window: int = 25) -> Mismatch:
    """Innovation covariance as the filter has it, as a moving window has it, and their difference.

    The sample is zero until a window has passed, as the thesis sets it; steps in which a pair of
    components was not measured are left out of its mean.

    Shapes:
        innovation with a leading time axis, as in a `tracker.types.History`.
    Source: paper 4, eq. 3-3 to 3-6.

    Example:
    >>> v, S = np.ones((30, 1)), np.ones((30, 1, 1))
    >>> told = Innovation(v, S, v[:, 0], v[:, 0], v[:, 0], v[:, 0] > 0)
    >>> found = degree_of_mismatch(told)
    >>> float(found.sample[23, 0, 0]), float(found.sample[24, 0, 0]), float(found.dom[24, 0, 0])
    (0.0, 1.0, 0.0)
    """
    v = innovation.residual
    products = v[:, :, None] * v[:, None]
    seen = ~np.isnan(products)
    products = np.where(seen, products, 0.0)
    sample = np.zeros_like(products)
    for k in range(window - 1, len(v)):
        part = slice(k - window + 1, k + 1)
        sample[k] = products[part].sum(axis=0) / np.maximum(seen[part].sum(axis=0), 1)
    return Mismatch(innovation.S, sample, innovation.S - sample)
