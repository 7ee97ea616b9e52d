"""Errors of estimates against the truth; whether an estimate knew them is `consistency`'s question."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.algebra import residual
from tracker.types import Array, Space


def error(truth: Array, mean: Array, space: Space) -> Array:
    """``mean - truth``, wrapped where a state component lives on a circle.

    Shapes:
        truth, mean ``(T, n, *batch)``; result alike.
    """
    first = residual(np.moveaxis(mean, 1, 0), np.moveaxis(truth, 1, 0), space.circular)
    return np.moveaxis(first, 0, 1)


def squared_position_error(errors: Array, space: Space) -> Array:
    """Squared Euclidean error of the position components (paper 0, eq. 36, squared).

    Shapes:
        errors ``(T, n, *batch)``; result ``(T, *batch)``.
    """
    part = errors[:, list(space.position)]
    return np.einsum("tk...,tk...->t...", part, part)  # type: ignore[no-any-return]


def rmse(squared: Array, axis: Any = None) -> Any:
    """Root of the mean of squared errors: over a run (paper 0, eq. 37), over runs, or both."""
    return np.sqrt(np.mean(squared, axis=axis))
