"""Speed beside other libraries and beside code written by hand: `./x bench [NAME ...]`.

Every benchmark first checks that all sides compute the same thing, then times them interleaved in
one process on one core. What is compared is written in `peers` and `handwritten`, how time is taken
in `measure`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import environment

if __name__ == "__main__" and "--here" not in sys.argv:
    environment.enter()

import banks
import common
import family
import handwritten
import measure
import numpy as np
import optimisers
import particles
import peers
import sweeps
import targets
import tuning
from common import (
    MICRO,
    NANO,
    PROBLEM,
    RUNS,
    SEED,
    STATIONS,
    STEPS,
    agreed,
    compiled,
    one_run,
    optional,
    report,
    two_stations,
)

import tracker as tk
from tracker.algebra import at_once
from tracker.estimation import steps as recursion


def means_of(estimator: tk.Estimator, simulation: Any) -> Any:
    """The recursion of every run at once, means kept: no history of covariances."""
    record, prior = simulation.record, simulation.prior
    means = np.empty((len(record), prior.n, *record.batch))
    with at_once():
        for k, _, _, state, _ in recursion(estimator, record, prior, simulation.start):
            means[k] = state.mean
    return means


def reduced(estimator: tk.Estimator, simulation: Any) -> tuple[Any, ...]:
    """The recursion with what a study keeps of it: sums per run, never a history."""
    squared, nis, loglik, count = (np.zeros(RUNS) for _ in range(4))
    with at_once():
        rows = recursion(estimator, simulation.record, simulation.prior, simulation.start)
        for k, _, _, state, innovation in rows:
            miss = simulation.truth[k, :2] - state.mean[:2]
            squared += miss[0] * miss[0] + miss[1] * miss[1]
            nis += innovation.nis
            loglik += innovation.loglik
            count += innovation.count
    return squared, nis, loglik, count


# ------------------------------------------------------------------------------ benchmarks
def monte_carlo() -> None:
    """1,000 runs x 500 steps of EKF1 on two bearings, against one run of the peers, per step."""
    whole, masked = two_stations(), two_stations(0.1)
    z, mean, cov = one_run(whole[1])
    problem = {"stations": STATIONS, **PROBLEM}
    compiled("off")
    kept = means_of(*whole)
    works: dict[str, Callable[[], Any]] = {
        "arrays: filter alone, per lane": lambda: means_of(*whole),
        "arrays: filter, reductions, 10 % missing, per lane": lambda: reduced(*masked),
    }
    per = dict.fromkeys(works, RUNS * STEPS)
    others = {}
    for label, make, tolerance in (
        ("filterpy, one run", lambda: peers.filterpy_ekf(z, mean, cov, **problem), 1e-9),
        # Stone Soup differentiates by differences: the same filter, but not the same digits.
        ("Stone Soup, one run", lambda: peers.stonesoup_ekf(z, mean, cov, **problem), 1e-4),
    ):
        run = optional(label, make)
        if run is not None:
            agreed(label, kept[..., 0], run(), tolerance)
            others[label] = run
    per |= dict.fromkeys(others, STEPS)
    seconds = measure.interleaved(works | others)
    report(seconds, per, NANO, "ns")
    for ours in works:
        for theirs in others:
            times = measure.ratio(seconds[theirs], seconds[ours]) * per[ours] / per[theirs]
            wanted = 100 if theirs.startswith("filterpy") else 1000
            word = "as wanted" if times >= wanted else "MISSED"
            print(f"  {theirs} / {ours}: {times:.0f} times (at least {wanted}: {word})")


def public() -> None:
    """What a user calls: tk.filter with its whole history, tk.monte_carlo with its simulation."""
    estimator, simulation = two_stations(0.1)
    scenario = tk.scenario("two_stations", steps=STEPS, detection_probability=0.9)
    record, prior, start = simulation.record, simulation.prior, simulation.start

    def filtered(choice: str) -> Any:
        compiled(choice)
        return tk.filter(estimator, record, prior, start=start)

    def campaign(choice: str) -> Any:
        compiled(choice)
        return tk.monte_carlo(estimator, scenario, runs=RUNS, seed=SEED)

    compiled("off")
    works: dict[str, Callable[[], Any]] = {
        "arrays: tk.filter, every moment kept": lambda: filtered("off"),
        "arrays: tk.monte_carlo, simulation included": lambda: campaign("off"),
        "simulation alone": lambda: scenario.simulate(SEED, RUNS),
    }
    compiled("on")
    if "compiled" in estimator.explain():
        agreed(
            "arrays and compiled",
            filtered("off").filtered.mean,
            filtered("on").filtered.mean,
        )
        works["compiled: tk.filter, every moment kept"] = lambda: filtered("on")
        works["compiled: tk.monte_carlo, simulation included"] = lambda: campaign("on")
    seconds = measure.interleaved(works)
    report(seconds, dict.fromkeys(works, RUNS * STEPS), NANO, "ns per step and lane")


def online() -> None:
    """One step on line through Estimator.step, against filterpy's predict and update."""
    estimator, simulation = two_stations()
    z, mean, cov = one_run(simulation)

    def stepping(choice: str) -> Callable[[], Any]:
        def run() -> Any:
            compiled(choice)
            state: Any = tk.Gaussian(mean, cov)
            means = np.empty((STEPS, 4))
            for k in range(STEPS):
                state, _ = estimator.step(state, z[k], PROBLEM["dt"])
                means[k] = state.mean
            return means

        return run

    works = {"Estimator.step, arrays": stepping("off")}
    if optional("llvmlite", lambda: __import__("llvmlite")) is not None:
        works["Estimator.step, compiled where possible"] = stepping("on")
    peer = optional(
        "filterpy", lambda: peers.filterpy_ekf(z, mean, cov, stations=STATIONS, **PROBLEM)
    )
    if peer is not None:
        for label, work in works.items():
            agreed(label, work(), peer())
        works["filterpy, predict and update"] = peer
    seconds = measure.interleaved(works, 15)
    report(seconds, dict.fromkeys(works, STEPS), MICRO, "us per step")
    if peer is not None:
        for label in list(works)[:-1]:
            share = measure.ratio(seconds[label], seconds["filterpy, predict and update"])
            word = "as wanted" if share <= 1.0 else "MISSED"
            print(f"  {label} takes {share:.2f} of filterpy's time (at most 1: {word})")


def by_hand() -> None:
    """The array interpretation against NumPy written by hand for this one problem, masks on."""
    estimator, simulation = two_stations(0.1)
    record, prior = simulation.record, simulation.prior

    def hand() -> Any:
        return handwritten.filtered(record.z, prior.mean, prior.cov, stations=STATIONS, **PROBLEM)[
            0
        ]

    compiled("off")
    works = {
        "by hand": hand,
        "arrays": lambda: means_of(estimator, simulation),
    }
    agreed("arrays and by hand", works["arrays"](), hand())
    seconds = measure.interleaved(works, 15)
    report(seconds, dict.fromkeys(works, RUNS * STEPS), NANO, "ns per step and lane")
    times = measure.ratio(seconds["arrays"], seconds["by hand"])
    word = "as wanted" if times <= 1.48 else "MISSED"
    print(
        f"  arrays / by hand: {times:.2f} (at most 150 / 125 to 150 / 101 = 1.20 to 1.48: {word})"
    )


def smoother() -> None:
    """Filter and RTS smoother, against filterpy's on a linear problem of the same size."""
    scenario = tk.scenario("line", axes=2, steps=STEPS, dt=PROBLEM["dt"], sigma=PROBLEM["sigma"])
    estimator = tk.estimator("kf", motion=scenario.motion, sensor=scenario.sensor, smoother="rts")
    simulation = scenario.simulate(SEED, RUNS)
    record, prior, start = simulation.record, simulation.prior, simulation.start
    z, mean, cov = one_run(simulation)
    single = tk.Record(record.t, z)
    lone = tk.Gaussian(mean, cov)
    compiled("off")
    works: dict[str, Callable[[], Any]] = {
        "arrays: filter, 1,000 lanes, per lane": lambda: tk.filter(
            estimator, record, prior, start=start
        ),
        "arrays: filter and RTS, 1,000 lanes, per lane": lambda: tk.smooth(
            estimator, record, prior, start=start
        ),
        "arrays: filter, one run": lambda: tk.filter(estimator, single, lone, start=start),
        "arrays: filter and RTS, one run": lambda: tk.smooth(estimator, single, lone, start=start),
    }
    per = {label: STEPS if "one run" in label else STEPS * RUNS for label in works}
    peer = optional("filterpy", lambda: peers.filterpy_smoother(z, mean, cov, **PROBLEM))
    if peer is not None:
        trajectory = works["arrays: filter and RTS, one run"]().smoothed
        agreed("filterpy, smoothed", trajectory.mean, peer[1]())
        works |= {
            "filterpy: filter, one run": peer[0],
            "filterpy: filter and RTS, one run": peer[1],
        }
        per |= dict.fromkeys(list(works)[-2:], STEPS)
    report(measure.interleaved(works, 7), per, MICRO, "us per step")


def batch() -> None:
    """Cost per lane against the number of lanes: where the array interpretation pays."""
    scenario = tk.scenario("two_stations", steps=50, detection_probability=0.9)
    estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor)
    compiled("off")
    works, per = {}, {}
    for lanes in (1, 2, 10, 30, 100, 300, 1000, 2000, 10_000):
        simulation = scenario.simulate(SEED, lanes)
        if lanes == 1:
            record = tk.Record(simulation.record.t, simulation.record.z[..., 0])
            alone = (record, simulation.prior[0], simulation.start)
            works["one run without a batch axis"] = lambda alone=alone: tk.filter(
                estimator, alone[0], alone[1], start=alone[2]
            )
            per["one run without a batch axis"] = 50
            continue
        label = f"{lanes} lanes"
        works[label] = lambda s=simulation: tk.filter(estimator, s.record, s.prior, start=s.start)
        per[label] = 50 * lanes
    report(measure.interleaved(works, 7), per, NANO, "ns per step and lane")


LISTING = """
import sys, time
before = time.process_time()
import numpy
between = time.process_time()
import tracker
after = time.process_time()
own = sorted(m for m in sys.modules if m.partition('.')[0] == 'tracker')
heavy = sorted({m.partition('.')[0] for m in sys.modules} & set(
    'scipy matplotlib llvmlite numba pandas sympy hypothesis pyproj pluggy rich'.split()))
print(between - before, after - between, len(own), ','.join(heavy) or 'none')
"""


def imports() -> None:
    """`import tracker`: its CPU time beyond NumPy's, and what it loads."""
    rows = []
    for _ in range(measure.ROUNDS):
        answer = subprocess.run(
            [sys.executable, "-c", LISTING], check=True, capture_output=True, text=True
        )
        rows.append(answer.stdout.split())
    numpy_, ours = (np.median([float(row[i]) for row in rows]) * 1e3 for i in (0, 1))
    print(f"  NumPy {numpy_:.0f} ms of CPU time, tracker {ours:.1f} ms more")
    print(f"  modules of tracker loaded: {rows[0][2]}; other heavy packages: {rows[0][3]}")
    if rows[0][3] != "none":
        print("  MISSED: import tracker must load NumPy and nothing else that is heavy")


BENCHMARKS: dict[str, Callable[[], None]] = {
    "targets": targets.targets,
    "tuning": tuning.tuning,
    "family": family.family,
    "banks": banks.banks,
    "particles": particles.particles,
    "optimisers": optimisers.optimisers,
    "sweeps": sweeps.sweeps,
    "monte_carlo": monte_carlo,
    "online": online,
    "by_hand": by_hand,
    "public": public,
    "smoother": smoother,
    "batch": batch,
    "imports": imports,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="./x bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--here", action="store_true", help="in this environment, not .venv-bench")
    names = parser.parse_args().names or list(BENCHMARKS)
    for name in names:
        if name not in BENCHMARKS:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(BENCHMARKS)}")
    measure.on_one_core()
    packages = ("numpy", "scipy", "llvmlite", "filterpy", "stonesoup", "dynamax", "jax")
    machine = (measure.processor(), measure.versions(*packages))
    print(*machine, sep="\n")
    common.begin(*machine)
    for name in names:
        print(f"\n{name}: {BENCHMARKS[name].__doc__}", flush=True)
        common.note(f"## {name}", "", str(BENCHMARKS[name].__doc__), "")
        BENCHMARKS[name]()
    print(f"\ntables: {common.RESULTS}")


if __name__ == "__main__":
    main()
