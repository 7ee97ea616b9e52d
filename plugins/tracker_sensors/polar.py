"""Places by range, azimuth and elevation, and back; what a sensor measures of them lives with the sensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.models import one_of
from tracker.types import Array, ArrayLike, as_array

CONVENTIONS = ("math", "north")


def to_polar(
    dx: ArrayLike, dy: ArrayLike, dz: ArrayLike = 0.0, *, convention: str = "math"
) -> tuple[Array, Array, Array]:
    """Slant range, azimuth and elevation of an offset; z is up.

    ``convention`` 'math' counts azimuth counter-clockwise from the x axis, 'north' clockwise from y.

    Shapes:
        scalars or ``(*batch)``, broadcast; result alike.
    Units:
        m; rad, azimuth in (-pi, pi], elevation in [-pi/2, pi/2].

    Raises:
        DomainError: for another convention.
    Reference:
        paper 4, eq. 4-7, with the sign of 4-8 corrected (``R^2 = rho^2 + RZ^2``), and 5-3 to 5-6.
    Laws:
        `from_polar` is its inverse.

    Example:
    >>> [round(float(v), 4) for v in to_polar(0.0, 3.0, 4.0)]
    [5.0, 1.5708, 0.9273]
    """
    one_of("convention", convention, CONVENTIONS)
    x, y, z = (as_array(v, name) for v, name in ((dx, "dx"), (dy, "dy"), (dz, "dz")))
    level = np.hypot(x, y)
    azimuth = np.arctan2(y, x) if convention == "math" else np.arctan2(x, y)
    return _alike(np.hypot(level, z), azimuth, np.arctan2(z, level))


def from_polar(
    distance: ArrayLike,
    azimuth: ArrayLike,
    elevation: ArrayLike = 0.0,
    *,
    convention: str = "math",
) -> tuple[Array, Array, Array]:
    """The offset ``dx, dy, dz`` of a slant range, azimuth and elevation: the inverse of `to_polar`.

    Raises:
        DomainError: for another convention.
    Reference:
        paper 4, eq. 4-5, 4-6 ('north').
    """
    one_of("convention", convention, CONVENTIONS)
    r, a, e = (
        as_array(v, name)
        for v, name in ((distance, "distance"), (azimuth, "azimuth"), (elevation, "elevation"))
    )
    level = r * np.cos(e)
    along, across = level * np.cos(a), level * np.sin(a)
    x, y = (along, across) if convention == "math" else (across, along)
    return _alike(x, y, r * np.sin(e))


def _alike(*values: Any) -> tuple[Array, Array, Array]:
    one, two, three = np.broadcast_arrays(*values)
    return np.array(one), np.array(two), np.array(three)
