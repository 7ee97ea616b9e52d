"""Particle filters of one run: beside Stone Soup's, and what each of ours costs by number of particles.

The record is that of the two stations from where an EKF has settled: from the wide start a thousand
particles of any library lose the target, and what is timed would not be what anyone wants.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import measure
import numpy as np
import peers
from common import MICRO, PROBLEM, SEED, STATIONS, agreed, compiled, optional, report, table

import tracker as tk

PARTICLES = 1000
SETTLED, STEPS = 100, 300
FILTERS = ("bootstrap", "auxiliary", "regularised", "marginalised")
TARGET_US = 80.0


def settled() -> tuple[tk.Estimator, tk.Record, tk.Gaussian, float]:
    """The EKF, and the record from where it has settled, with its estimate as the prior."""
    scenario = tk.scenario("two_stations", steps=SETTLED + STEPS)
    ekf = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor)
    simulation = scenario.simulate(SEED, 1)
    t, z = simulation.record.t, simulation.record.z[..., 0]
    history = tk.filter(ekf, tk.Record(t, z), simulation.prior[0], start=simulation.start)
    record = tk.Record(t[SETTLED:], z[SETTLED:])
    return ekf, record, history.filtered.at(SETTLED - 1), float(t[SETTLED - 1])


def particles() -> None:
    """One run of particle filters, 1,000 particles, beside Stone Soup's; then other numbers of them."""
    ekf, record, prior, start = settled()
    exact = tk.filter(ekf, record, prior, start=start)
    sigma = np.sqrt(np.einsum("tii->ti", exact.filtered.cov))

    def ours(name: str, count: int = PARTICLES) -> Callable[[], Any]:
        rule = tk.filters.make(name, particles=count)
        estimator = tk.estimator(rule, motion=ekf.motion, sensor=ekf.sensors[0])

        def run() -> Any:
            rng = np.random.default_rng(SEED)
            return tk.filter(estimator, record, prior, start=start, rng=rng).filtered.mean

        return run

    compiled("on")
    works = {f"{name}, {PARTICLES:,} particles": ours(name) for name in FILTERS}
    peer = optional(
        "Stone Soup",
        lambda: peers.stonesoup_particles(
            record.z,
            prior.mean,
            prior.cov,
            count=PARTICLES,
            stations=STATIONS,
            seed=SEED,
            **PROBLEM,
        ),
    )
    if peer is not None:
        works["Stone Soup, 1,000 particles"] = peer
    for label, work in works.items():
        # All approximate the same posterior: their means lie within a standard deviation of the EKF's.
        off = np.sqrt(np.mean(((work() - exact.filtered.mean) / sigma) ** 2))
        agreed(f"{label} and EKF, in standard deviations", off, 0.0, 0.7)
    seconds = measure.interleaved(works)
    report(seconds, dict.fromkeys(works, STEPS), MICRO, "us a step")
    found = np.median(seconds[f"bootstrap, {PARTICLES:,} particles"]) / STEPS * MICRO
    word = "as wanted" if found <= TARGET_US else "MISSED"
    print(f"  bootstrap: {found:.0f} us a step (at most {TARGET_US:.0f}: {word})")
    if peer is not None:
        slow = seconds["Stone Soup, 1,000 particles"]
        times = measure.ratio(slow, seconds[f"bootstrap, {PARTICLES:,} particles"])
        print(f"  Stone Soup / bootstrap: {times:.0f} times")
    rows = []
    for count in (96, 496, 1000, 4000, 16000):
        both = {}
        for choice in ("on", "off"):
            run = ours("bootstrap", count)

            def chosen(choice: str = choice, run: Callable[[], Any] = run) -> Any:
                compiled(choice)
                return run()

            both[choice] = chosen
        times = measure.interleaved(both, 3)
        cells = (f"{np.median(times[c]) / STEPS * MICRO:,.0f}" for c in ("on", "off"))
        rows.append((f"{count:,}", *cells))
    compiled("on")
    table("bootstrap, us a step", ("particles", "compiled", "on arrays"), rows)
