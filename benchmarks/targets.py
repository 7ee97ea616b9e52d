"""The compiled steps against their targets, each with a verdict: `./x bench targets`.

"Bound kernel" times are of the machine code alone, called on arrays that are ready;
"tk.monte_carlo after its simulation" adds the making of these arrays and the way back; "tk.monte_carlo" is what a
user calls, simulation included. What cost depends on is drawn in `sweeps`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import measure
import numpy as np
import peers
from common import (
    MICRO,
    NANO,
    PROBLEM,
    REFERENCE_US,
    RUNS,
    SEED,
    STATIONS,
    STEPS,
    agreed,
    compiled,
    one_run,
    optional,
    report,
    table,
    two_stations,
)
from machine import matrix_product_rate, operations

import tracker as tk
from tracker.compile import run
from tracker.models import ComponentSensor, diagonal
from tracker_motion import constant_velocity
from tracker_sensors import azimuth_elevation, stack

WIDE = "avx512f"


@attrs.frozen
class Verdict:
    """What was wanted, and what was found."""

    what: str
    found: float
    wanted: float
    at_least: bool
    unit: str = ""

    @property
    def met(self) -> bool:
        return self.found >= self.wanted if self.at_least else self.found <= self.wanted

    def cells(self) -> tuple[str, str, str, str]:
        sign = ">=" if self.at_least else "<="
        wanted = f"{sign} {self.wanted:,.4g} {self.unit}".rstrip()
        share = self.found / self.wanted if self.at_least else self.wanted / self.found
        word = "met" if self.met else "**not met**"
        return self.what, f"{self.found:,.3g} {self.unit}".rstrip(), wanted, f"{word} ({share:.2f})"


def two_directions(missing: float = 0.0) -> tk.Scenario:
    """S6: azimuth and elevation from two moving sensors, n = 6, m = 4."""
    t = np.arange(1.0, STEPS + 1)
    first = np.stack([-900 + 12 / 3.6 * t, -200 + 20 * np.sin(0.06 * t), -100 + 0 * t], axis=1)
    one = azimuth_elevation(np.sqrt(3e-4), np.sqrt(4e-5))
    start = np.array([-530.0, -50, -50, 14 / 3.6, 0.3 / 3.6, 0.1 / 3.6])
    return tk.Scenario(
        name="two_directions",
        motion=constant_velocity(density=1e-4, axes=3),
        sensor=stack([one, one]),
        prior=tk.Gaussian(start, np.diag([50.0, 15, 15, 5, 0.04, 0.04])),
        t=t,
        pose=np.concatenate([first, first + np.array([-90.0, 170.0, 0.0])], axis=1),
        detection_probability=1.0 - missing,
    )


def wide() -> bool:
    """Whether this processor has vectors of eight doubles."""
    cpu = Path("/proc/cpuinfo")
    return cpu.exists() and WIDE in cpu.read_text(encoding="utf-8")


def estimator_of(scenario: tk.Scenario, smoother: str | None = None) -> tk.Estimator:
    return tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor, smoother=smoother)


def bound(estimator: Any, simulation: Any, *keep: str) -> run.Prepared:
    truth = simulation.truth if "scores" in keep else None
    return run.prepared(
        estimator, simulation.record, simulation.prior, simulation.start, keep, truth
    )


def scored(estimator: Any, simulation: Any) -> Callable[[], Any]:
    given = (simulation.record, simulation.prior, simulation.start, simulation.truth)
    return lambda: run.scored(estimator, *given)


# ---------------------------------------------------------------------------------- the batch
def batched() -> list[Verdict]:
    whole, (estimator, simulation) = two_stations(), two_stations(0.1)
    scenario = tk.scenario("two_stations", steps=STEPS, detection_probability=0.9)
    larger = two_directions(0.1)
    S6, larger_runs = estimator_of(larger), larger.simulate(SEED, RUNS)
    smoothing = estimator_of(scenario, "rts")
    smoothing6 = estimator_of(larger, "rts")
    alone = scenario.simulate(SEED, 1)
    compiled("require")
    z, mean, cov = one_run(whole[1])
    problem = {"stations": STATIONS, **PROBLEM}

    kernel = "bound kernel, S0: filter alone"
    reduced = "bound kernel, S0: filter and reductions"
    after = "S0: tk.monte_carlo after its simulation"
    lone = "bound kernel, S0: one run, filter and reductions"
    kernel6 = "bound kernel, S6: filter and reductions"
    after6 = "S6: tk.monte_carlo after its simulation"
    smooth, smooth6 = f"{after}, with RTS", f"{after6}, with RTS"
    single = bound(estimator, alone, "scores")
    works: dict[str, Callable[[], Any]] = {
        kernel: bound(estimator, simulation),
        reduced: bound(estimator, simulation, "scores"),
        "bound kernel, S0: filter, means and covariances kept": bound(
            estimator, simulation, "filtered"
        ),
        after: scored(estimator, simulation),
        smooth: scored(smoothing, simulation),
        "S0: tk.monte_carlo, simulation included": lambda: tk.monte_carlo(
            estimator, scenario, runs=RUNS, seed=SEED
        ),
        lone: lambda: [single() for _ in range(20)],
        "bound kernel, S6: filter alone": bound(S6, larger_runs),
        kernel6: bound(S6, larger_runs, "scores"),
        after6: scored(S6, larger_runs),
        smooth6: scored(smoothing6, larger_runs),
    }
    per = dict.fromkeys(works, RUNS * STEPS) | {lone: 20 * STEPS}

    # The compiled filter computes what theirs does: means of all runs of the complete record.
    history = tk.filter(whole[0], whole[1].record, whole[1].prior, start=whole[1].start)
    ours = history.filtered.mean
    arrays = tk_on_arrays(estimator, simulation)
    made = run.scored(
        estimator, simulation.record, simulation.prior, simulation.start, simulation.truth
    )
    agreed("compiled and arrays, RMSE of every run", made["filter"].totals[0], arrays)
    theirs = {}
    peer = optional("filterpy", lambda: peers.filterpy_ekf(z, mean, cov, **problem))
    if peer is not None:
        agreed("filterpy, one run", ours[..., 0], peer())
        theirs["filterpy, one run"] = peer
        per["filterpy, one run"] = STEPS
    lanes_first = (
        np.moveaxis(whole[1].record.z, -1, 0),
        np.broadcast_to(np.moveaxis(whole[1].prior.mean.reshape(4, -1), -1, 0), (RUNS, 4)),
        np.broadcast_to(np.moveaxis(whole[1].prior.cov.reshape(4, 4, -1), -1, 0), (RUNS, 4, 4)),
    )
    vmapped = optional("dynamax", lambda: peers.dynamax_ekf(*lanes_first, **problem))
    if vmapped is not None:
        # It cannot be told that azimuths wrap, and adds 1e-9 to variances before it divides by them.
        whole_turn = (np.abs(np.diff(whole[1].record.z, axis=0)) > np.pi).any(axis=(0, 1))
        label = f"dynamax, {(~whole_turn).sum()} runs whose azimuths stay off pi"
        agreed(label, np.moveaxis(ours, -1, 0)[~whole_turn], vmapped()[~whole_turn], 1e-5)
        theirs["dynamax, vmap of 1,000 runs"] = vmapped
        per["dynamax, vmap of 1,000 runs"] = RUNS * STEPS
        theirs["dynamax, one run"] = peers.dynamax_ekf(z, mean, cov, **problem)
        per["dynamax, one run"] = STEPS
    seconds = measure.interleaved(works | theirs)
    report(seconds, per, NANO, "ns")

    rate = matrix_product_rate()
    counts = {
        kernel: operations(works[kernel].program),
        reduced: operations(works[reduced].program),
        kernel6: operations(works[kernel6].program),
    }
    print(f"  matrix products on this core: {rate / 1e9:.1f} GFLOP/s")
    rows = []
    for label, count in counts.items():
        found, limit = np.median(seconds[label]) / per[label], count / rate
        rows.append((label, f"{count}", f"{limit * NANO:.1f}", f"{limit / found:.0%}"))
    table("The machine's limit", ("", "operations", "ns at that rate", "reached"), rows)

    def times(slow: str, fast: str) -> float:
        return measure.ratio(seconds[slow], seconds[fast]) * per[fast] / per[slow]

    found = []
    for peer_name, wanted in (
        ("filterpy, one run", 2500 if wide() else 1200),
        ("dynamax, vmap of 1,000 runs", 20 if wide() else 12),
    ):
        if peer_name in theirs:
            for label in (reduced, kernel, after):
                what = f"{peer_name} / {label}"
                found.append(Verdict(what, times(peer_name, label), wanted, at_least=True))
    return [
        *found,
        Verdict("S0, filter + RTS / filter, scored", times(smooth, after), 4, at_least=False),
        Verdict("S6, filter + RTS / filter, scored", times(smooth6, after6), 4, at_least=False),
        Verdict("bound kernels, S6 / S0", times(kernel6, reduced), 4, at_least=False),
        Verdict("bound kernel, one run / 1,000 runs", times(lone, reduced), 12, at_least=False),
    ]


def tk_on_arrays(estimator: Any, simulation: Any) -> Any:
    """Squared position error of every run, summed over time, by the array interpretation."""
    compiled("off")
    history = tk.filter(estimator, simulation.record, simulation.prior, start=simulation.start)
    compiled("require")
    miss = history.filtered.mean[:, :2] - simulation.truth[:, :2]
    return (miss * miss).sum(axis=(0, 1))


# -------------------------------------------------------------------------------- one at a time
def stepping(estimator: Any, simulation: Any, steps: int, run_: int | None) -> Callable[[], Any]:
    """Steps on line of one run, or of all at once."""
    pick: Any = slice(None) if run_ is None else run_
    z = [simulation.record.z[k][..., pick].copy() for k in range(steps)]
    prior = simulation.prior if run_ is None else simulation.prior[run_]
    dt = float(PROBLEM["dt"])

    def work() -> Any:
        state: Any = prior
        for row in z:
            state, _ = estimator.step(state, row, dt)
        return state.mean

    return work


def on_line() -> list[Verdict]:
    scenario = tk.scenario("two_stations", steps=STEPS)
    estimator, simulation = estimator_of(scenario), scenario.simulate(SEED, 1024)
    compiled("require")
    one, many = "Estimator.step, one track", "Estimator.step, 1,024 tracks"
    works = {
        one: stepping(estimator, simulation, STEPS, 0),
        many: stepping(estimator, simulation, 100, None),
    }
    per = {one: STEPS, many: 100, "filterpy, one track": STEPS}
    z, mean, cov = one_run(simulation)
    peer = optional(
        "filterpy", lambda: peers.filterpy_ekf(z, mean, cov, stations=STATIONS, **PROBLEM)
    )
    if peer is not None:
        agreed("filterpy, one track", works[one](), peer()[-1])
        works["filterpy, one track"] = peer
    seconds = measure.interleaved(works, 15)
    report(seconds, per, MICRO, "us a step")
    if peer is None:
        return []
    scaled = {
        label: REFERENCE_US
        * measure.ratio(seconds[label], seconds["filterpy, one track"])
        * STEPS
        / per[label]
        for label in (one, many)
    }
    return [
        Verdict(
            f"{one}, where filterpy takes {REFERENCE_US} us",
            scaled[one],
            5,
            at_least=False,
            unit="us",
        ),
        Verdict(f"{many}, likewise", scaled[many], 25, at_least=False, unit="us"),
    ]


# ------------------------------------------------------------------------------------ first use
FIRST_USE = """
import sys, time
import numpy
before = time.process_time()
import tracker as tk
loaded = time.process_time()
sys.path.insert(0, sys.argv[1])
if sys.argv[2] == "S0":
    scenario = tk.scenario("two_stations", steps=2)
else:
    import targets
    targets.STEPS = 2
    scenario = targets.two_directions()
simulation = scenario.simulate(1, 8)
estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor)
given = (simulation.record, simulation.prior, simulation.start, simulation.truth)
from tracker.compile import run
start = time.process_time()
run.reason(estimator)
run.scored(estimator, *given)
print(time.process_time() - start, loaded - before)
"""


def first_use() -> list[Verdict]:
    """CPU time of the first campaign of a process, until its scores are there."""
    found, rows = [], []
    for size in ("S0", "S6"):
        for kind, wanted in (("cold", 0.2), ("cached", 0.04)):
            seconds = []
            with tempfile.TemporaryDirectory() as kept:
                for i in range(measure.ROUNDS + 1):
                    folder = Path(kept, str(i) if kind == "cold" else "one")
                    answer = subprocess.run(
                        [sys.executable, "-c", FIRST_USE, str(Path(__file__).parent), size],
                        env={**os.environ, "TRACKER_CACHE": str(folder)},
                        check=True,
                        capture_output=True,
                        text=True,
                    )
                    seconds.append([float(v) for v in answer.stdout.split()])
            first, load = np.median(seconds[1:], axis=0) * 1e3
            rows.append((f"{size}, {kind}", f"{first:.0f}", f"{load:.1f}"))
            what = f"{size}: first campaign of a process, {kind}"
            found.append(Verdict(what, first, wanted * 1e3, at_least=False, unit="ms"))
    table("First use", ("", "ms of CPU time", "import tracker, ms after NumPy"), rows)
    return found


# ---------------------------------------------------------------------------------------- mixed
def _measure(x: Any, y: Any, *, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    return np.arctan2(y - ay, x - ax), np.arctan2(y - by, x - bx)


def _derivative(x: Any, y: Any, *, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    rows = []
    for sx, sy in ((ax, ay), (bx, by)):
        dx, dy = x - sx, y - sy
        square = dx * dx + dy * dy
        rows.append((-dy / square, dx / square))
    return tuple(rows)


def mixed() -> list[Verdict]:
    """Two bearings that only NumPy can evaluate: compiled around them, against all on arrays."""
    scenario = tk.scenario("two_stations", steps=100, detection_probability=0.9)
    simulation = scenario.simulate(SEED, RUNS)
    sensor = ComponentSensor(
        name="opaque",
        measure=_measure,
        derivative=_derivative,
        noise=lambda *, sigma: diagonal(sigma**2, sigma**2),
        space=tk.Space.of("azimuth_1 [rad] circular", "azimuth_2 [rad] circular"),
        pose_space=tk.Space.of("ax [m]", "ay [m]", "bx [m]", "by [m]"),
        parameters={"sigma": PROBLEM["sigma"]},
    ).at(ax=1.0, ay=1.0, bx=4.0, by=1.1)
    estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=sensor)

    def filtered(choice: str) -> Any:
        compiled(choice)
        return tk.filter(estimator, simulation.record, simulation.prior, start=simulation.start)

    works = {
        "tk.filter, opaque sensor, on arrays": lambda: filtered("off"),
        "tk.filter, opaque sensor, compiled around it": lambda: filtered("on"),
    }
    compiled("on")
    print("  " + estimator.explain().splitlines()[0])
    agreed("mixed and arrays", filtered("on").filtered.mean, filtered("off").filtered.mean)
    seconds = measure.interleaved(works)
    report(seconds, dict.fromkeys(works, RUNS * 100), NANO, "ns per step and lane")
    times = measure.ratio(*seconds.values())
    return [Verdict("opaque sensor: arrays / compiled around it", times, 1, at_least=True)]


def targets() -> None:
    """Compiled steps against their targets: the batch, steps on line, first use, opaque sensors."""
    verdicts: list[Verdict] = []
    for part in (batched, on_line, first_use, mixed):
        print(f"\n targets, {part.__name__}", flush=True)
        verdicts += part()
    print()
    rows = [verdict.cells() for verdict in verdicts]
    table("Targets", ("", "found", "target", "verdict (1 or more is met)"), rows)
