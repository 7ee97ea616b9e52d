"""Operators of evolutionary algorithms on individuals in the unit cube: crossovers and mutations.

Each takes the uniforms that it needs and draws none itself; who mates with whom is the algorithms'.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.types import Array

_LEAST_GAP = 1e-14
"""Parents closer than this in a parameter have children equal to them in it (Deb's own code)."""

_ZERO, _ONE = np.array(0.0), np.array(1.0)  # ufuncs take arrays faster than Python's numbers


def simulated_binary(first: Array, second: Array, u: Array, index: float) -> tuple[Array, Array]:
    """Two children of two parents, spread as by one-point crossover of binary strings, in bounds.

    Shapes:
        parents and uniforms ``u`` alike, any shape.

    Reference:
        Deb and Agrawal 1995; within bounds as Deb's program does, and as K. Deb, An efficient
        constraint handling method for genetic algorithms, 2000, writes it.
    """
    low, high = np.minimum(first, second), np.maximum(first, second)
    gap = high - low
    wide = np.maximum(gap, _LEAST_GAP)
    children = []
    for room in (low, 1.0 - high):
        alpha = 2.0 - (1.0 + 2.0 * room / wide) ** -(index + 1.0)
        inner = u * alpha
        beta = np.where(inner <= 1.0, inner, 1.0 / np.maximum(2.0 - inner, 1e-300)) ** (
            1.0 / (index + 1.0)
        )
        children.append(beta * gap)
    middle = low + high
    return 0.5 * (middle - children[0]), 0.5 * (middle + children[1])


def polynomial_step(x: Array, u: Array, index: float) -> Array:
    """A step of polynomial mutation that stays in bounds: small ones are likely, large ones possible.

    Reference:
        Deb and Goyal 1996; within bounds as in Deb 2000.
    """
    below = u < 0.5
    room = np.where(below, 1.0 - x, x)  # 1 - delta of the side the step goes to
    double = np.where(below, 2.0 * u, 2.0 * (1.0 - u))
    power = (double + (1.0 - double) * room ** (index + 1.0)) ** (1.0 / (index + 1.0))
    return np.where(below, power - 1.0, 1.0 - power)


def within(x: Array) -> Array:
    """Back into the unit cube, to the nearest point; in place."""
    np.maximum(x, _ZERO, out=x)
    np.minimum(x, _ONE, out=x)
    return x


def permutations(u: Array) -> Any:
    """Permutations from uniforms ``(k, ...)``, along the first axis."""
    return u.argsort(axis=0, kind="stable")
