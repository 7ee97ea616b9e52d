"""Random numbers that belong to a restart and a generation; what they are used for lives elsewhere.

A memory carries a key per restart and the number of its generation. Numbers are a function of these
alone, never of what was drawn before or for whom else (`tracker.draws`).
"""

from __future__ import annotations

import numpy as np

from tracker.draws import Keys, keys, seeded
from tracker.types import Array

__all__ = ["BEGIN", "Keys", "keys", "uniforms"]

BEGIN = 2**32
"""Added to the generation for what is drawn once, at the beginning."""

_MIXING = 12
"""Outputs thrown away after seeding: the rounds of its author's four-word seed (PractRand, sfc.cpp)."""


def uniforms(key: Keys, generation: int, count: int) -> Array:
    """Uniforms in [0, 1), ``(count, restarts)``, the restarts on one axis; the caller's to write over."""
    words = key.ravel().tolist()
    restarts = len(words) // 2
    if restarts == 1:
        return seeded(words[0], words[1], generation).random(_MIXING + count)[_MIXING:, None]
    out = np.empty((restarts, _MIXING + count))
    for row, first, second in zip(out, words[:restarts], words[restarts:], strict=True):
        seeded(first, second, generation).random(out=row)
    return np.ascontiguousarray(out.T)[_MIXING:]
