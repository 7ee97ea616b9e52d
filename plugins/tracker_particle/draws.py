"""Random numbers that belong to a lane, a step and a purpose; what they are used for lives elsewhere.

A belief carries a key per lane and the number of steps since it began. Every draw is a function of
those two and of what it is for, never of what was drawn before or for whom else: methods stay pure,
and a lane's numbers do not depend on its company.

The generator (`tracker.draws`) is seeded by two words of the key, and one of step and purpose.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tracker.draws import Keys, keys, seeded
from tracker.types import Array

__all__ = [
    "BACKWARD", "FIRST_STAGE", "KERNEL", "MIXING", "NOISE", "RESAMPLING", "START", "STREAMS",
    "Keys", "keys", "normals", "uniforms", "word",
]  # fmt: skip

START, NOISE, RESAMPLING, KERNEL, FIRST_STAGE, BACKWARD = range(6)
"""What a draw is for; never renumbered."""

STREAMS = 8
"""Generators side by side behind the normals of a lane: as many as a vector has places, so that
machine code can run them all at once (`tracker_particle.kernels`)."""

MIXING = 18
"""Outputs that are thrown away after seeding (PractRand, sfc.cpp)."""


def word(step: int, purpose: int) -> int:
    """The third word of a seed; the lowest byte is the number of the stream."""
    return (step << 16) + (purpose << 8)


def _fill(out: Array, first: int, second: int, third: int) -> None:
    """Fill a row with the uniforms of these three words."""
    generator = seeded(first, second, third)
    generator.bit_generator.random_raw(MIXING, output=False)
    generator.random(out=out)


def uniforms(key: Keys, step: int, purpose: int, count: int) -> Array:
    """Uniforms in [0, 1), ``(count, *batch)``."""
    first, second = key.reshape(2, -1).tolist()
    out = np.empty((len(first), count))
    for row, one, two in zip(out, first, second, strict=True):
        _fill(row, one, two, word(step, purpose))
    return np.ascontiguousarray(out.T).reshape(count, *key.shape[1:])


def normals(key: Keys, step: int, purpose: int, rows: int, count: int) -> Array:
    """Standard normals, ``(rows, count, *batch)``.

    Reference:
        Box and Muller 1958, with sine and cosine from the tangent of half the angle: NumPy has a
        vector form of the tangent, and none of them.
    """
    first, second = key.reshape(2, -1).tolist()
    half, groups = -(-rows // 2), -(-count // STREAMS)
    drawn = np.empty((len(first), 2 * half, groups, STREAMS))
    third = word(step, purpose)
    streams = np.empty((STREAMS, groups * 2 * half))
    for own, one, two in zip(drawn, first, second, strict=True):
        for j, stream in enumerate(streams):
            _fill(stream, one, two, third + j)
        own[:] = streams.reshape(STREAMS, groups, 2 * half).T
    _box_muller(drawn[:, :half], drawn[:, half:])
    flat = drawn.reshape(len(drawn), 2 * half, groups * STREAMS)[:, :rows, :count]
    out: Array = flat[0] if len(drawn) == 1 else np.ascontiguousarray(np.moveaxis(flat, 0, -1))
    return out.reshape(rows, count, *key.shape[1:])


def _box_muller(a: Any, b: Any) -> None:
    """Two arrays of uniforms become normals."""
    np.subtract(1.0, a, out=a)  # in (0, 1]
    np.log(a, out=a)
    a *= -2.0
    np.sqrt(a, out=a)
    b -= 0.5
    b *= math.pi
    np.tan(b, out=b)
    square = b * b
    np.divide(a, 1.0 + square, out=a)
    b *= a
    b += b
    np.subtract(1.0, square, out=square)
    a *= square
