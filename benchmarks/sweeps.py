"""What the cost of a step depends on: lanes, state size, steps, tracks; a picture of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import measure
import numpy as np
import peers
from common import (
    MICRO,
    NANO,
    OUT,
    PROBLEM,
    SEED,
    STATIONS,
    STEPS,
    compiled,
    one_run,
    optional,
    table,
)
from machine import matrix_product_rate, operations
from pictures import LIMIT, Curve, draw
from targets import bound, estimator_of, scored, stepping

import tracker as tk
from tracker_motion import constant_acceleration, constant_velocity
from tracker_sensors import position

ROUNDS = 7
KERNEL = "compiled: filter alone (bound kernel)"
REDUCED = "compiled: filter and reductions (bound kernel)"
PUBLIC = "compiled: tk.monte_carlo after its simulation"
ARRAYS = "arrays: tk.filter, all moments kept"

Works = dict[tuple[str, int], tuple[Callable[[], Any], int]]
"""Curve and place on it: what to time, and how many steps of a lane that is."""


def timed(works: Works, unit: float) -> dict[str, Curve]:
    """Curves of medians, all points interleaved."""
    seconds = measure.interleaved({str(k): work for k, (work, _) in works.items()}, ROUNDS)
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for (label, x), (_, per) in works.items():
        xs, ys = curves.setdefault(label, ([], []))
        xs.append(x)
        ys.append(float(np.median(seconds[str((label, x))])) / per * unit)
    return dict(curves)


def shown(
    name: str, title: str, across: str, up: str, curves: Mapping[str, Curve], note: str = ""
) -> None:
    """A table and a picture."""
    places = sorted({x for xs, _ in curves.values() for x in xs})
    rows = [
        (label, *(f"{dict(zip(*curve, strict=True)).get(x, np.nan):,.3g}" for x in places))
        for label, curve in curves.items()
    ]
    cells = [tuple(c.replace("nan", "") for c in row) for row in rows]
    table(f"{title}: {up}", (across, *(f"{x:,.10g}" for x in places)), cells)
    draw(OUT / f"{name}.png", title, across, up, curves, f"{note}{measure.processor()}, one core")


def on_arrays(work: Callable[[], Any]) -> Callable[[], Any]:
    def run() -> None:
        compiled("off")
        work()
        compiled("require")

    return run


def repeated(work: Callable[[], Any], times: int) -> Callable[[], Any]:
    """Short work, often enough to be timed."""
    if times <= 1:
        return work
    return lambda: [work() for _ in range(times)]


def add(works: Works, label: str, x: int, work: Callable[[], Any], steps: int) -> None:
    times = max(1, 20_000 // steps)
    works[label, x] = (repeated(work, times), times * steps)


def lanes() -> None:
    scenario = tk.scenario("two_stations", steps=STEPS, detection_probability=0.9)
    estimator = estimator_of(scenario)
    complete = tk.scenario("two_stations", steps=STEPS).simulate(SEED, 10_000)
    works: Works = {}
    places: Sequence[int] = (1, 8, 32, 100, 1_000, 10_000)
    for count in places:
        compiled("require")
        simulation = scenario.simulate(SEED, count)
        work, steps = bound(estimator, simulation), count * STEPS
        add(works, KERNEL, count, work, steps)
        add(works, REDUCED, count, bound(estimator, simulation, "scores"), steps)
        add(works, PUBLIC, count, scored(estimator, simulation), steps)
        # On arrays fewer steps will do: each costs the same.
        short = tk.scenario("two_stations", steps=50, detection_probability=0.9)
        few = short.simulate(SEED, count)
        run = on_arrays(lambda f=few: tk.filter(estimator, f.record, f.prior, start=f.start))
        works[ARRAYS, count] = (run, 50 * count)
        if count <= 1000:
            prior = complete.prior[..., :count]
            given = (
                np.moveaxis(complete.record.z[..., :count], -1, 0),
                np.moveaxis(prior.mean, -1, 0),
                np.moveaxis(prior.cov, -1, 0),
            )
            vmapped = optional(
                "dynamax", lambda g=given: peers.dynamax_ekf(*g, stations=STATIONS, **PROBLEM)
            )
            if vmapped is not None:
                works["dynamax, vmap", count] = (vmapped, count * STEPS)
    z, mean, cov = one_run(complete)
    peer = optional(
        "filterpy", lambda: peers.filterpy_ekf(z, mean, cov, stations=STATIONS, **PROBLEM)
    )
    if peer is not None:
        works["filterpy, run after run", 1] = (peer, STEPS)
    curves = timed(works, NANO)
    if peer is not None:
        one = curves["filterpy, run after run"][1][0]
        curves["filterpy, run after run"] = (places, [one] * len(places))
    limit = operations(work.program) / matrix_product_rate() * NANO
    curves[f"{LIMIT}, filter alone"] = (places, [limit] * len(places))
    title = "EKF1 on two bearings (n = 4, m = 2), 500 steps"
    shown("lanes", title, "runs at once", "ns per step and run", curves)


def sizes() -> None:
    works: Works = {}
    limits: list[float] = []
    places = []
    rate = matrix_product_rate()
    for n, motion, axes in (
        (2, constant_velocity(density=0.1, axes=1), 1),
        (3, constant_acceleration(density=0.1, axes=1), 1),
        (4, constant_velocity(density=0.1, axes=2), 2),
        (6, constant_velocity(density=0.1, axes=3), 3),
        (9, constant_acceleration(density=0.1, axes=3), 3),
    ):
        scenario = tk.Scenario(
            name="positions",
            motion=motion,
            sensor=position(3.0, axes=axes),
            prior=tk.Gaussian(np.zeros(n), np.eye(n) * 4.0),
            t=np.arange(1.0, 101.0),
        )
        estimator, simulation = estimator_of(scenario), scenario.simulate(SEED, 1000)
        compiled("require")
        work = bound(estimator, simulation)
        works[KERNEL, n] = (work, 100_000)
        works[REDUCED, n] = (bound(estimator, simulation, "scores"), 100_000)
        works[PUBLIC, n] = (scored(estimator, simulation), 100_000)
        works[ARRAYS, n] = (
            on_arrays(
                lambda e=estimator, s=simulation: tk.filter(e, s.record, s.prior, start=s.start)
            ),
            100_000,
        )
        F, Q, H = (np.asarray(a) for a in (
            motion.jacobian(np.zeros(n), 1.0), motion.Q(np.zeros(n), 1.0), np.eye(axes, n)
        ))  # fmt: skip
        z, mean, cov = one_run(simulation)
        peer = optional(
            "filterpy",
            lambda g=(z, mean, cov, F, Q, H): peers.filterpy_linear(*g, 9.0 * np.eye(len(g[5]))),
        )
        if peer is not None:
            works["filterpy, one run", n] = (peer, 100)
        places.append(n)
        limits.append(operations(work.program) / rate * NANO)
    curves = timed(works, NANO)
    curves[f"{LIMIT}, filter alone"] = (places, limits)
    title = "Positions measured, 1 to 3 axes, velocity or acceleration; 1,000 runs"
    shown("sizes", title, "state components n", "ns per step and run", curves)


def lengths() -> None:
    works: Works = {}
    places = (1, 10, 100, 1_000, 10_000)
    for steps in places:
        scenario = tk.scenario("two_stations", steps=steps, detection_probability=0.9)
        estimator = estimator_of(scenario)
        compiled("require")
        for count in (1, 256):
            simulation = scenario.simulate(SEED, count)
            told = "1 run" if count == 1 else f"{count} runs"
            work = bound(estimator, simulation, "scores")
            total = steps * count
            add(
                works, f"compiled, {told}: filter and reductions (bound kernel)", steps, work, total
            )
            add(works, f"compiled, {told}: tk.monte_carlo after its simulation", steps,
                scored(estimator, simulation), total)  # fmt: skip
    curves = timed(works, NANO)
    limit = operations(work.program) / matrix_product_rate() * NANO
    curves[f"{LIMIT}, filter and reductions"] = (places, [limit] * len(places))
    title = "EKF1 on two bearings (n = 4, m = 2): the length of a record"
    shown("steps", title, "steps of the record", "ns per step and run", curves)


def tracks() -> None:
    scenario = tk.scenario("two_stations", steps=STEPS)
    estimator = estimator_of(scenario)
    works: Works = {}
    places = (1, 8, 64, 256, 1024, 4096)
    most = scenario.simulate(SEED, places[-1])
    compiled("require")
    for count in places:
        some = most if count == places[-1] else scenario.simulate(SEED, count)
        ticks = STEPS if count < 64 else 100
        work = stepping(estimator, some, ticks, 0 if count == 1 else None)
        works["compiled: Estimator.step", count] = (work, ticks)
        array = stepping(estimator, some, 50, 0 if count == 1 else None)
        works["arrays: Estimator.step", count] = (on_arrays(array), 50)
    program = bound(estimator, most).program
    z, mean, cov = one_run(most)
    peer = optional(
        "filterpy", lambda: peers.filterpy_ekf(z, mean, cov, stations=STATIONS, **PROBLEM)
    )
    if peer is not None:
        works["filterpy, track after track", 1] = (peer, STEPS)
    curves = timed(works, MICRO)
    if peer is not None:
        one = curves["filterpy, track after track"][1][0]
        curves["filterpy, track after track"] = (places, [one * p for p in places])
    limit = operations(program) / matrix_product_rate() * MICRO
    curves[f"{LIMIT}, filter alone"] = (places, [limit * p for p in places])
    title = "One tick on line: EKF1 on two bearings (n = 4, m = 2)"
    shown("tracks", title, "tracks", "us per tick of all tracks", curves)


def sweeps() -> None:
    """Cost against runs at once, state size, steps and tracks, with what the core could do at best."""
    for part in (lanes, sizes, lengths, tracks):
        print(f"\n sweeps, {part.__name__}", flush=True)
        part()
