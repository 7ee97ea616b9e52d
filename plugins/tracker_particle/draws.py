"""Random numbers that belong to a lane, a step and a purpose; what they are used for lives elsewhere.

A belief carries a key per lane and the number of steps since it began. Every draw is a function of
those two and of what it is for, never of what was drawn before or for whom else: methods stay pure,
and a lane's numbers do not depend on its company.

The generator is SFC64, seeded by three words (two of the key; step and purpose) as its author seeds
it. At 1,000 particles the draws are most of a step, and it is four times as fast as Philox.
"""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.types import Array

Keys = npt.NDArray[np.uint64]

START, NOISE, RESAMPLING, KERNEL, FIRST_STAGE, BACKWARD = range(6)
"""What a draw is for; never renumbered."""

STREAMS = 8
"""Generators side by side behind the normals of a lane: as many as a vector has places, so that
machine code can run them all at once (`tracker_particle.kernels`)."""

MIXING = 18
"""Outputs that are thrown away after seeding (PractRand, sfc.cpp)."""

_WORDS = struct.Struct("=4Q")


def word(step: int, purpose: int) -> int:
    """The third word of a seed; the lowest byte is the number of the stream."""
    return (step << 16) + (purpose << 8)


class _Source(threading.local):
    """One generator per thread, set anew before every use: it remembers nothing between draws."""

    def __init__(self) -> None:
        self.bits = np.random.SFC64(0)
        self.generator = np.random.Generator(self.bits)
        words = np.ones(4, dtype=np.uint64)
        self.words = memoryview(words.data).cast("B")
        self.state: Any = {**self.bits.state, "state": {"state": words}}

    def fill(self, out: Array, first: int, second: int, third: int) -> None:
        """Fill a row with the uniforms of these three words."""
        _WORDS.pack_into(self.words, 0, first, second, third, 1)
        self.bits.state = self.state
        self.bits.random_raw(MIXING, output=False)
        self.generator.random(out=out)


_source = _Source()


def keys(rng: np.random.Generator | Sequence[np.random.Generator], batch: tuple[int, ...]) -> Keys:
    """Two words per lane, ``(2, *batch)``, from one generator or from one for each lane."""
    lanes = math.prod(batch)
    if isinstance(rng, np.random.Generator):
        words = rng.integers(0, 2**64, size=(lanes, 2), dtype=np.uint64)
    else:
        words = np.empty((lanes, 2), dtype=np.uint64)
        for row, own in zip(words, rng, strict=True):
            row[:] = own.integers(0, 2**64, size=2, dtype=np.uint64)
    return np.ascontiguousarray(words.T).reshape(2, *batch)


def uniforms(key: Keys, step: int, purpose: int, count: int) -> Array:
    """Uniforms in [0, 1), ``(count, *batch)``."""
    first, second = key.reshape(2, -1).tolist()
    out = np.empty((len(first), count))
    for row, one, two in zip(out, first, second, strict=True):
        _source.fill(row, one, two, word(step, purpose))
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
            _source.fill(stream, one, two, third + j)
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
