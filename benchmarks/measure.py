"""Timing that survives a shared machine: CPU time, interleaved rounds, medians, ratios per round.

What is timed is decided elsewhere.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path

import numpy as np

ROUNDS = 9
"""Timed rounds; an odd number of at least seven, so that the median is one of them."""


def on_one_core() -> None:
    """Stay on one core where the system can be told so."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def interleaved(
    works: Mapping[str, Callable[[], object]], rounds: int = ROUNDS
) -> dict[str, list[float]]:
    """CPU seconds of each piece of work in each round; every round does every piece once."""
    for work in works.values():
        work()
    seconds: dict[str, list[float]] = {label: [] for label in works}
    for _ in range(rounds):
        for label, work in works.items():
            before = time.process_time()
            work()
            seconds[label].append(time.process_time() - before)
    return seconds


def ratio(of: list[float], to: list[float]) -> float:
    """Median over rounds of how many times one took what the other took."""
    return float(np.median(np.asarray(of) / np.asarray(to)))


def processor() -> str:
    """The processor's own name, where the system tells it."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def versions(*packages: str) -> str:
    """Versions of what is installed among some distributions."""
    found = [f"Python {platform.python_version()}"]
    for name in packages:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} missing")
    return ", ".join(found)
