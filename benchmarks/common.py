"""The problems that the benchmarks share, agreement before timing, and where results are written."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tracker as tk

RUNS = 1000
STEPS = 500
SEED = 7
STATIONS = ((1.0, 1.0), (4.0, 1.1))
PROBLEM = {"dt": 0.01, "density": 0.1, "sigma": float(np.deg2rad(2.0))}
REFERENCE_US = 22.3
"""What a step of filterpy's EKF takes on the machine for which targets in microseconds are given."""

NANO, MICRO = 1e9, 1e6
OUT = Path(__file__).resolve().parent.parent / "build" / "bench"
RESULTS = OUT / "results.md"


def agreed(what: str, ours: Any, theirs: Any, tolerance: float = 1e-9) -> None:
    """Stop unless two results are the same: a time means nothing otherwise."""
    difference = float(np.abs(np.asarray(ours) - np.asarray(theirs)).max())
    if not difference <= tolerance:
        sys.exit(
            f"{what}: results differ by {difference:.1e}, more than {tolerance:.0e}: not timed"
        )
    print(f"  {what}: results agree to {difference:.0e}")


def optional(what: str, make: Callable[[], Any]) -> Any:
    """What ``make`` makes, or None after a line that says what is missing."""
    try:
        return make()
    except ImportError as error:
        print(f"  {what} is not installed ({error}): left out")
        return None


def compiled(choice: str) -> None:
    os.environ["TRACKER_COMPILE"] = choice


def two_stations(missing: float = 0.0) -> tuple[tk.Estimator, Any]:
    scenario = tk.scenario("two_stations", steps=STEPS, detection_probability=1.0 - missing)
    estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor)
    return estimator, scenario.simulate(SEED, RUNS)


def one_run(simulation: Any, run: int = 0) -> tuple[Any, Any, Any]:
    prior = simulation.prior[run]
    return simulation.record.z[..., run].copy(), prior.mean, prior.cov


def report(
    seconds: Mapping[str, list[float]], per: Mapping[str, int], unit: float, name: str
) -> None:
    """Print medians, and write them down."""
    rows = []
    for label, times in seconds.items():
        middle, least = np.median(times) / per[label] * unit, min(times) / per[label] * unit
        rows.append((label, f"{middle:,.4g}", f"{least:,.4g}"))
    table("", ("", name, "least"), rows)


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, and add it to the results in Markdown."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    if title:
        print(f"  {title}")
    for row in rows if not title and len(header) < 2 else [header, *rows]:
        cells = [
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  " + "  ".join(cells).rstrip())
    lines = [f"| {' | '.join(row)} |" for row in rows]
    head = [f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    note(*([f"**{title}**", ""] if title else []), *head, *lines, "")


def note(*lines: str) -> None:
    """Add lines to the results."""
    with RESULTS.open("a", encoding="utf-8") as stream:
        stream.write("\n".join(lines) + "\n")


def begin(*lines: str) -> None:
    """Start the results anew."""
    OUT.mkdir(parents=True, exist_ok=True)
    RESULTS.write_text("", encoding="utf-8")
    note("# Results", "", *lines, "")
