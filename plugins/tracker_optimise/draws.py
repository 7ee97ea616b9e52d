"""Random numbers that belong to a restart and a generation; what they are used for lives elsewhere.

A memory carries a key per restart and the number of its generation. Numbers are a function of these
alone, never of what was drawn before or for whom else (`tracker.draws`).
"""

from __future__ import annotations

import numpy as np

from tracker.draws import Keys, keys, seeded
from tracker.types import Array

__all__ = ["BEGIN", "Keys", "keys", "numbers", "uniforms"]

BEGIN = 2**32
"""Added to the generation for what is drawn once, at the beginning."""

_MIXING = 12
"""Outputs thrown away after seeding: the rounds of its author's four-word seed (PractRand, sfc.cpp)."""


def uniforms(key: Keys, generation: int, count: int) -> Array:
    """Uniforms in [0, 1), ``(count, restarts)``, the restarts on one axis."""
    return numbers(key, generation, count, 0)[0]


def numbers(key: Keys, generation: int, uniform: int, normal: int) -> tuple[Array, Array]:
    """Uniforms in [0, 1) and standard normals, ``(uniform, restarts)`` and ``(normal, restarts)``."""
    first, second = key.reshape(2, -1).tolist()
    mixed = _MIXING + uniform
    out = np.empty((len(first), mixed + normal))
    for row, one, two in zip(out, first, second, strict=True):
        generator = seeded(one, two, generation)
        generator.random(out=row[:mixed])
        if normal:
            generator.standard_normal(out=row[mixed:])
    turned = out.reshape(-1, 1) if len(first) == 1 else np.ascontiguousarray(out.T)
    return turned[_MIXING:mixed], turned[mixed:]
