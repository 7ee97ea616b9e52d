"""A progress bar with the time left, for whatever turns out to last; nothing is computed here.

It appears only after two seconds, only on a terminal, and on the error stream, so that what is fast
stays quiet and what is piped stays clean.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

T = TypeVar("T")

PATIENCE = 2.0
"""Seconds before a bar appears."""


def progress(
    iterable: Iterable[T], label: str, total: int | None = None, *, quiet: bool = False
) -> Iterator[T]:
    """Go through ``iterable``, showing how far that is.

    ``total`` is the number of items where the iterable has no length; without either there is a
    count but no time left.

    Example:
    >>> [2 * run for run in progress(range(3), "runs")]
    [0, 2, 4]
    """
    if total is None and isinstance(iterable, Sized):
        total = len(iterable)
    with progress_of(label, quiet=quiet) as report:
        for done, item in enumerate(iterable, 1):
            yield item
            report(done, total)


@contextmanager
def progress_of(label: str, *, quiet: bool = False) -> Iterator[Callable[[int, int | None], None]]:
    """Yield a function to be told how many steps are done, and of how many; the bar goes at the end.

    Example:
    >>> with progress_of("scans") as report:
    ...     report(1, 2)
    """
    start = time.monotonic()
    shown: list[Any] = []

    def report(done: int, total: int | None) -> None:
        passed = time.monotonic() - start
        if quiet or passed < PATIENCE or not sys.stderr.isatty():
            return
        if not shown:
            bar = stack.enter_context(_bar())
            shown.extend((bar, bar.add_task(label, total=total, left="")))
        bar, task = shown
        # From the whole time so far: the bar's own estimate would know nothing of its first seconds.
        left = "" if total is None else _spoken(passed / done * (total - done))
        bar.update(task, completed=done, total=total, left=left)

    with ExitStack() as stack:
        yield report


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[left]}"),
        console=Console(stderr=True),
        transient=True,
    )


def _spoken(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s left"
    return f"{seconds / 60:.0f} min left" if seconds < 6000 else f"{seconds / 3600:.1f} h left"
