"""Angles on a circle of 2 pi: wrapping, differences and means that are exact at the cut.

Functions of arrays for users and metrics; filters subtract with `tracker.algebra.residual`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.models.functions import wrap
from tracker.types import Array, ArrayLike, as_array

__all__ = ["circular_mean", "difference", "wrap"]


def difference(a: ArrayLike, b: ArrayLike) -> Any:
    """The shortest turn from ``b`` to ``a``, in (-pi, pi].

    Example:
    >>> float(difference(3.0, -3.0).round(4))
    -0.2832
    """
    return wrap(np.asarray(as_array(a, "a") - as_array(b, "b")))


def circular_mean(angles: ArrayLike, weights: ArrayLike | None = None, axis: int = 0) -> Array:
    """The mean direction, in (-pi, pi]: that of the (weighted) sum of unit vectors.

    NaN where the vectors cancel, for then there is no mean direction, and where an angle is NaN. It
    is the mean of the turns from any direction near the angles only to second order: sigma points
    use differences about ``h(x)`` instead.

    Shapes:
        angles of any shape; weights ``(angles.shape[axis],)`` or None for equal ones; the axis is
        summed over.
    Reference:
        Mardia and Jupp, Directional Statistics, section 2.2.1.
    Laws:
        turning all angles turns the mean; whole turns change nothing (tests/property/test_angles.py).

    Example:
    >>> circular_mean([3.1, -3.1]).round(6) == round(np.pi, 6)
    np.True_
    """
    values = np.moveaxis(as_array(angles, "angles"), axis, -1)
    count = values.shape[-1]
    each = np.full(count, 1.0 / max(count, 1)) if weights is None else as_array(weights, "weights")
    with np.errstate(invalid="ignore"):
        east, north = np.cos(values) @ each, np.sin(values) @ each
    length = np.hypot(east, north)
    rounding = 4.0 * np.finfo(np.float64).eps * np.abs(each).sum()
    mean = np.where(length > rounding, np.arctan2(north, east), np.nan)
    # -pi is the same direction as pi, and outside the interval.
    return np.asarray(np.where(mean == -np.pi, np.pi, mean))
