"""Random numbers that belong to a restart and a generation; what they are used for lives elsewhere.

A memory carries two words per restart and the number of its generation. Numbers are a function of
these alone, never of what was drawn before or for whom else: methods stay pure, and a restart's
numbers do not depend on its company.
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

BEGIN = 2**32
"""Added to the generation for what is drawn once, at the beginning."""

_MIXING = 12
"""Outputs thrown away after seeding: the rounds of its author's four-word seed (PractRand, sfc.cpp)."""

_WORDS = struct.Struct("=4Q")


class _Source(threading.local):
    """One SFC64 generator per thread, set anew before every use: it remembers nothing in between."""

    def __init__(self) -> None:
        self.bits = np.random.SFC64(0)
        self.generator = np.random.Generator(self.bits)
        words = np.ones(4, dtype=np.uint64)
        self.words = memoryview(words.data).cast("B")
        self.state: Any = {**self.bits.state, "state": {"state": words}}

    def of(self, first: int, second: int, generation: int) -> np.random.Generator:
        """The generator of a restart in a generation, valid until the next call; not mixed yet."""
        _WORDS.pack_into(self.words, 0, first, second, generation, 1)
        self.bits.state = self.state
        return self.generator


_source = _Source()


def keys(rng: np.random.Generator | Sequence[np.random.Generator], batch: tuple[int, ...]) -> Keys:
    """Two words per restart, ``(2, *batch)``, from one generator or from one for each restart."""
    restarts = math.prod(batch)
    if isinstance(rng, np.random.Generator):
        words = rng.integers(0, 2**64, size=(restarts, 2), dtype=np.uint64)
    else:
        words = np.empty((restarts, 2), dtype=np.uint64)
        for row, own in zip(words, rng, strict=True):
            row[:] = own.integers(0, 2**64, size=2, dtype=np.uint64)
    return np.ascontiguousarray(words.T).reshape(2, *batch)


def uniforms(key: Keys, generation: int, count: int) -> Array:
    """Uniforms in [0, 1), ``(count, restarts)``, the restarts on one axis."""
    return numbers(key, generation, count, 0)[0]


def numbers(key: Keys, generation: int, uniform: int, normal: int) -> tuple[Array, Array]:
    """Uniforms in [0, 1) and standard normals, ``(uniform, restarts)`` and ``(normal, restarts)``."""
    first, second = key.reshape(2, -1).tolist()
    mixed = _MIXING + uniform
    out = np.empty((len(first), mixed + normal))
    for row, one, two in zip(out, first, second, strict=True):
        generator = _source.of(one, two, generation)
        generator.random(out=row[:mixed])
        if normal:
            generator.standard_normal(out=row[mixed:])
    turned = out.reshape(-1, 1) if len(first) == 1 else np.ascontiguousarray(out.T)
    return turned[_MIXING:mixed], turned[mixed:]
