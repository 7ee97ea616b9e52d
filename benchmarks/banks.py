"""Filters and smoothers that keep several Gaussians: compiled beside the arrays, one run and many.

Of a compiled step the first use is told too, from an empty folder and from a full one.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import measure
import numpy as np
from common import MICRO, RUNS, SEED, agreed, compiled, table

import tracker as tk
from tracker.compile import run
from tracker_motion import constant_velocity, switching
from tracker_sensors import position

STEPS = 40
"""Of many runs, and of a short record; a long one has `LONG`."""
LONG = 120
MEMBERS = (8, 16, 32)
DENSITIES = (0.01, 1.0, 100.0, 10.0)
ROUNDS = 7


def banks() -> None:
    """Gaussian sums, banks over range and the smoother of modes, compiled beside the arrays."""
    compiled("on")
    kinds = "gaussian_sum", "range_parameterised"
    rows = [_row(f"{kind} {k}", _filter) for kind in kinds for k in MEMBERS]
    rows += [_row(f"imm_smoother {count}", _smoother) for count in (2, 3, 4)]
    titles = (
        "", "1,000 runs: arrays, us", "compiled, us", "campaign, us", "one run of 40: arrays, us",
        "compiled, us", f"of {LONG}: arrays, us", "compiled, us", "first use, s", "from the cache, s",
    )  # fmt: skip
    table("A step and run of mixtures", titles, rows)


def _row(name: str, make: Callable[[str, int, int], Any]) -> tuple[str, ...]:
    cells = [name.replace(" ", " of ")]
    for runs, steps in ((RUNS, STEPS), (1, STEPS), (1, LONG)):
        work, campaign, why = make(name, runs, steps)
        works = {choice: _under(choice, work) for choice in (("off",) if why else ("off", "on"))}
        if not why:
            compiled("on")
            one = work()
            compiled("off")
            other = work()
            size = np.abs(other.mean) + np.sqrt(np.einsum("kii...->ki...", other.cov))
            agreed(f"{name}, {runs} x {steps}", one.mean / size, other.mean / size)
        if runs > 1 and not why:
            works["campaign"] = _under("on", campaign)
        seconds = measure.interleaved(works, ROUNDS)
        of = {k: f"{np.median(v) / steps / runs * MICRO:,.3g}" for k, v in seconds.items()}
        cells += [of["off"], of.get("on", "-")]
        if runs > 1:
            cells.append(of.get("campaign", "-"))
    compiled("on")
    with tempfile.TemporaryDirectory() as folder:
        cells += ["-", "-"] if why else [_first(name, folder), _first(name, folder)]
    return tuple(cells)


def _under(choice: str, work: Callable[[], Any]) -> Callable[[], Any]:
    def under() -> Any:
        compiled(choice)
        return work()

    return under


def _filter(name: str, runs: int, steps: int) -> tuple[Callable[[], Any], Callable[[], Any], str]:
    """Filtering, the scoring of a campaign, and why it is not compiled."""
    kind, members = name.split()
    if kind == "gaussian_sum":
        scene = tk.scenario("two_stations", steps=steps)
    else:
        scene = tk.scenario("moving_observer", path="manoeuvring")  # of 120 steps
    simulation = scene.simulate(SEED, runs)
    rule = tk.filters.make(kind, filter="ekf1", components=int(members))
    built = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
    whole, cut = simulation.record, slice(0, steps)
    record = tk.Record(
        whole.t[cut], whole.z[cut], pose=None if whole.pose is None else whole.pose[cut]
    )
    return _works(built, record, simulation.prior, simulation.start, simulation.truth[cut])


def _smoother(name: str, runs: int, steps: int) -> tuple[Callable[[], Any], Callable[[], Any], str]:
    count = int(name.split()[1])
    chain = 0.9 * np.eye(count) + 0.1 / (count - 1) * (1.0 - np.eye(count))
    motion = switching([constant_velocity(density) for density in DENSITIES[:count]], chain)
    rng = np.random.default_rng(SEED)
    z = np.cumsum(rng.standard_normal((steps, 2, runs)), axis=0)
    built = tk.estimator("imm", motion=motion, sensor=position(1.0), smoother="imm_smoother")
    prior = tk.Gaussian(np.zeros((4, runs)), np.repeat(np.eye(4)[..., None], runs, axis=2))
    record = tk.Record(np.arange(1.0, steps + 1.0), z)
    return _works(built, record, prior, 0.0, np.zeros((steps, 4, runs)))


def _works(
    built: tk.Estimator, record: tk.Record, prior: Any, start: Any, truth: Any
) -> tuple[Callable[[], Any], Callable[[], Any], str]:
    smooth = built.smoother is not None
    why = run.reason(built) or (run.why_not_backwards(built) if smooth else "")

    def campaign() -> Any:
        return run.scored(built, record, prior, start, truth)

    if not smooth:
        return lambda: tk.filter(built, record, prior, start=start).filtered, campaign, why
    history = tk.filter(built, record, prior, start=start)
    return lambda: tk.estimation.smoothed(built, history).smoothed, campaign, why


def _first(name: str, folder: str) -> str:
    """Seconds of CPU time of the first use in a process of its own, less those of the second."""
    environment = {**os.environ, "TRACKER_CACHE": folder, "TRACKER_COMPILE": "on"}
    told = subprocess.run(
        [sys.executable, __file__, name],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return told.stdout.split()[-1]


if __name__ == "__main__":
    work, _, _ = (_smoother if "smoother" in sys.argv[1] else _filter)(sys.argv[1], 1, STEPS)
    times = []
    for _ in range(2):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    print(f"{times[0] - times[1]:.2g}")
