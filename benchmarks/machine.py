"""What this machine could do at best: its rate of matrix products, and the operations of a step.

The limit of a step is its operations at that rate. No step can reach it: a matrix product has
nothing but independent multiplications and additions, a filter waits for square roots and
divisions, of which this counts each as one operation.
"""

from __future__ import annotations

import time

import numpy as np

from tracker.compile.program import Program, Rate
from tracker.models.graph import needed

_COUNTED = frozenset({"add", "sub", "mul", "recip", "sqrt"})
_SIZE = 1024


def matrix_product_rate(rounds: int = 9) -> float:
    """Operations a second of one core in a product of two large matrices of doubles."""
    A = np.random.default_rng(0).standard_normal((_SIZE, _SIZE))
    out = np.empty_like(A)
    np.matmul(A, A, out=out)
    seconds = []
    for _ in range(rounds):
        before = time.process_time()
        np.matmul(A, A, out=out)
        seconds.append(time.process_time() - before)
    return float(2 * _SIZE**3 / np.median(seconds))


def operations(program: Program) -> int:
    """Additions, multiplications, divisions and square roots of one step of one lane."""
    low = program.lowered()
    order = needed(low.roots(0))
    rates = low.rates(order)
    return sum(n.op in _COUNTED and rates[n.index] == Rate.BOTH for n in order)
