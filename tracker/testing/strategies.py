"""Hypothesis strategies for states, poses, covariances, records: public, for anyone's property tests.

What is checked with what they draw belongs in `tracker.testing.laws`. Every strategy draws a seed and
a few numbers that shape the result, and builds the arrays from them: nothing is filtered away, and a
covariance is positive definite because it was made so.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tracker.types import EMPTY_SPACE, Array, Record, Space

__all__ = [
    "BATCHES",
    "batch_shapes",
    "covariances",
    "generators",
    "poses",
    "records",
    "states",
    "time_steps",
]

BATCHES: tuple[tuple[int, ...], ...] = ((), (3,), (2, 0), (2, 3))
"""The batch shapes that every component must take: one run, lanes, no lanes at all, a grid."""

# Half widths of what is drawn, by unit: a few kilometres, tens of metres per second, a slow turn.
_SPREAD = {"m": 3000.0, "m/s": 30.0, "m/s^2": 1.0, "rad": math.pi, "rad/s": 0.05}
_TOO_CLOSE = 400.0
_POSE_SPREAD = 150.0


def spread(space: Space) -> Array:
    """How far the components of a space typically reach from zero, ``(n,)``."""
    return np.array([_SPREAD.get(axis.unit, 1.0) for axis in space])


def generators(stream: int = 0) -> st.SearchStrategy[np.random.Generator]:
    """NumPy generators made from drawn seeds; equal seeds of different streams share no numbers.

    Example:
    >>> from hypothesis import given
    >>> @given(generators())
    ... def holds(rng):
    ...     assert abs(rng.uniform()) < 1
    """
    return st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng([stream, seed]))


def batch_shapes() -> st.SearchStrategy[tuple[int, ...]]:
    """Shapes of batch axes: `BATCHES`, the empty batch ``(2, 0)`` among them."""
    return st.sampled_from(BATCHES)


def time_steps(*, zero: bool = True) -> st.SearchStrategy[float]:
    """Time steps from milliseconds to ten seconds, and zero where allowed.

    Units:
        s.
    """
    some = st.floats(-3.0, 1.0).map(lambda exponent: 10.0**exponent)
    return st.one_of(st.just(0.0), some) if zero else some


def _spaces(of: Any, *names: str) -> Space:
    if isinstance(of, Space):
        return of
    for name in names:
        found = getattr(of, name, None)
        if isinstance(found, Space):
            return found
    return EMPTY_SPACE


@st.composite
def states(draw: st.DrawFn, of: Any, batch: tuple[int, ...] = ()) -> Array:
    """States that a tracker meets, by the units of a state space.

    Positions lie a few kilometres round the origin but not close to it, so that a sensor near the
    origin sees no singular geometry; rates of turn are sometimes exactly zero, where formulas
    switch. ``of`` is a `Space`, a sensor (its ``state``) or a motion (its ``space``).

    Shapes:
        ``(n, *batch)``.
    Units:
        those of the space.

    Example:
    >>> from tracker.types import PLANAR
    >>> from hypothesis import given
    >>> @given(states(PLANAR, batch=(3,)))
    ... def holds(x):
    ...     assert x.shape == (4, 3)
    """
    space = _spaces(of, "state", "space")
    rng = draw(generators(1))
    x = np.asarray(rng.uniform(-1.0, 1.0, (space.size, *batch)))
    for i, axis in enumerate(space):
        x[i] *= _SPREAD.get(axis.unit, 1.0)
        if axis.unit == "rad/s":
            x[i] *= rng.choice([0.0, 1e-6, 1.0, 1.0])
        if axis.unit == "m" and axis.name not in {"x", "y"}:  # heights and the like
            x[i] = 50.0 + np.abs(x[i]) / 3.0
    here = [i for i, axis in enumerate(space) if axis.name in {"x", "y"} and axis.unit == "m"]
    if here:
        radius = np.sqrt(sum(x[i] ** 2 for i in here))
        away = np.where(radius < _TOO_CLOSE, _TOO_CLOSE / np.maximum(radius, 1e-9), 1.0)
        for i in here:
            x[i] *= away
    return x


@st.composite
def poses(draw: st.DrawFn, of: Any, batch: tuple[int, ...] = ()) -> Array | None:
    """Poses of a sensor within 150 m of the origin; None where the sensor takes none.

    ``of`` is a pose space, or a sensor.

    Shapes:
        ``(p, *batch)``.
    """
    space = _spaces(of, "pose_space")
    rng = draw(generators(2))
    if not space.size:
        return None
    p = np.asarray(rng.uniform(-1.0, 1.0, (space.size, *batch)))
    for i, axis in enumerate(space):
        p[i] *= _POSE_SPREAD if axis.unit == "m" else _SPREAD.get(axis.unit, 1.0)
        if re.fullmatch(r"s?z(_\w+)?", axis.name):
            p[i] = np.abs(p[i]) / 10.0
    return p


@st.composite
def covariances(
    draw: st.DrawFn, n: int, batch: tuple[int, ...] = (), scale: Any = 1.0, decades: float = 8.0
) -> Array:
    """Covariances built from a drawn seed and a drawn conditioning, 1e-8 to 1e8.

    Eigenvalues fall (or rise) evenly in their logarithms over the drawn number of decades, along
    random axes; ``scale``, one number or one per component, are standard deviations.

    Shapes:
        ``(n, n, *batch)``, exactly symmetric.
    """
    rng, reach = draw(generators(3)), draw(st.floats(-decades, decades))
    lanes = int(np.prod(batch, dtype=int))
    axes, _ = np.linalg.qr(rng.standard_normal((lanes, n, n)))
    roots = 10.0 ** (np.linspace(0.0, reach, n) / 2.0)
    half = np.asarray(scale).reshape(-1, 1) * (axes * (roots / roots.max()))
    cov = half @ half.swapaxes(1, 2)
    cov = 0.5 * (cov + cov.swapaxes(1, 2))
    return np.ascontiguousarray(np.moveaxis(cov, 0, -1).reshape(n, n, *batch))


@st.composite
def records(
    draw: st.DrawFn, sensor: Any, steps: int = 6, batch: tuple[int, ...] = (), missing: float = 0.2
) -> Record:
    """Records of a sensor: uneven times, some steps of zero length, some components missing.

    The measurements are those of independent states, noise-free: right in units and range, with no
    motion behind them.

    Shapes:
        t ``(steps,)``; z ``(steps, m, *batch)``; pose ``(steps, p, *batch)`` or None.
    """
    rng = draw(generators(4))
    t = np.cumsum(rng.uniform(0.1, 2.0, steps) * rng.choice([0.0, 1.0, 1.0], steps))
    rows, where = [], []
    for _ in range(steps):
        pose = draw(poses(sensor, batch))
        rows.append(np.asarray(sensor.h(draw(states(sensor, batch)), pose)))
        where.append(pose)
    z = np.array(np.stack(rows))
    z[rng.uniform(size=z.shape) < missing] = np.nan
    return Record(
        t, z, pose=None if where[0] is None else np.stack([p for p in where if p is not None])
    )
