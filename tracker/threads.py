"""Work shared out among threads; what the work is, and that its order does not matter, is the caller's."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tracker.errors import DomainError, wording


def each(work: Callable[[Any], object], items: Sequence[Any], workers: int) -> None:
    """``work(item)`` for every item, by so many threads; the first failure is raised.

    Raises:
        DomainError: for fewer than one worker.
    """
    if workers < 1:
        raise DomainError(
            wording("argument 'workers'", got=workers, expected="at least 1", do="pass more")
        )
    if workers == 1 or len(items) < 2:
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, items))


def shares(count: int, workers: int, multiple: int = 1) -> list[tuple[int, int]]:
    """``range(count)`` cut into at most ``workers`` parts that begin at multiples.

    Example:
    >>> shares(10, 2, multiple=4), shares(3, 8)
    ([(0, 8), (8, 10)], [(0, 1), (1, 2), (2, 3)])
    """
    blocks = -(-count // multiple)
    parts = max(1, min(workers, blocks))
    bounds = [min(count, -(-blocks * i // parts) * multiple) for i in range(parts + 1)]
    return [(a, b) for a, b in itertools.pairwise(bounds) if b > a]
