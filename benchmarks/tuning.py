"""One generation of a tuner: a swarm of 50 individuals on 20 runs of 500 steps of an adaptive EKF.

The adapter is the fuzzy one of paper 4, of which fifteen numbers are tuned. The peer is filterpy in a
Python loop with the same adapter written by hand: one run is timed, and multiplied by 1,000.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import measure
import numpy as np
from common import NANO, PROBLEM, STATIONS, STEPS, agreed, compiled, optional, table
from handwritten import TAU, transition, white_acceleration
from targets import Verdict, two_directions

import tracker as tk
from tracker.trials import Trials, numbers, place
from tracker_adaptive import FuzzyMeasurementNoise

INDIVIDUALS, RUNS, GENERATIONS, SEED = 50, 20, 5, 7
LANES = INDIVIDUALS * RUNS


def problem(scenario: tk.Scenario, adapted: bool) -> tuple[tk.Estimator, list[str]]:
    adapter = FuzzyMeasurementNoise() if adapted else None
    estimator = tk.estimator(
        "ekf1", motion=scenario.motion, sensor=scenario.sensor, adapter=adapter
    )
    named = [n for n in numbers(estimator) if n.startswith(("adapter.dom", "adapter.adjustment"))]
    return estimator, named if adapted else ["motion.density"]


def trials_of(estimator: tk.Estimator, named: list[str], simulation: Any, wanted: str) -> Trials:
    return Trials(
        estimator,
        [[place(estimator, name)] for name in named],
        simulation.record,
        simulation.prior,
        simulation.start,
        simulation.truth,
        [wanted],
        together=INDIVIDUALS,
    )


def generations(scenario: tk.Scenario, adapted: bool, wanted: str) -> Callable[[], Any]:
    """A search of so many generations, as `tk.tune` makes it: runs are simulated and laid out before."""
    estimator, named = problem(scenario, adapted)
    trials = trials_of(estimator, named, scenario.simulate(SEED, RUNS), wanted)
    given = np.array([numbers(estimator)[name] for name in named])
    half = 0.2 * np.abs(given) + 0.05
    bounds = np.stack([given - half, given + half], axis=1)
    if not adapted:
        bounds = np.array([[0.5, 2.0]]) * given[:, None]

    def cost(x: Any) -> Any:
        total = trials(x.reshape(len(x), -1))[wanted].sum(axis=0)
        return np.sqrt(total / STEPS).mean(axis=-1).reshape(x.shape[1:])

    return lambda: tk.optimise(
        cost, bounds, "particle_swarm", evaluations=INDIVIDUALS * GENERATIONS, seed=SEED
    )


def by_filterpy(z: Any, x0: Any, P0: Any, truth: Any) -> Callable[[], Any]:
    """filterpy's EKF and the fuzzy adapter in plain Python; the sum of squared position errors."""
    from filterpy.kalman import ExtendedKalmanFilter

    dt, density, sigma = PROBLEM["dt"], PROBLEM["density"], PROBLEM["sigma"]
    given = FuzzyMeasurementNoise()
    known, window = given.parameters, given.window
    inputs = ("NM", "NS", "ZE", "PS", "PM")
    rules = [
        (known[f"dom_{a}_centre"], known[f"dom_{a}_width"], known[f"adjustment_{b}_centre"])
        for a, b in zip(inputs, ("IL", "I", "M", "D", "DL"), strict=True)
    ]

    def adjustment(dom: float) -> float:
        above = below = 0.0
        for centre, width, output in rules:
            strength = math.exp(-(((dom - centre) / width) ** 2))
            above += output * strength
            below += strength
        return above / below

    def h(x: Any) -> Any:
        return np.array([np.arctan2(x[1] - sy, x[0] - sx) for sx, sy in STATIONS])

    def jacobian(x: Any) -> Any:
        rows = []
        for sx, sy in STATIONS:
            dx, dy = x[0] - sx, x[1] - sy
            square = dx * dx + dy * dy
            rows.append([-dy / square, dx / square, 0.0, 0.0])
        return np.array(rows)

    def difference(a: Any, b: Any) -> Any:
        return (a - b + math.pi) % TAU - math.pi

    def run() -> Any:
        ekf = ExtendedKalmanFilter(dim_x=4, dim_z=2)
        ekf.x, ekf.P = np.array(x0), np.array(P0)
        ekf.F, ekf.Q = transition(dt), white_acceleration(dt, density)
        scale, squares, total = np.ones(2), np.zeros((window, 2)), 0.0
        for k in range(len(z)):
            ekf.R = sigma**2 * np.diag(scale)
            ekf.predict()
            ekf.update(z[k], jacobian, h, residual=difference)
            squares[k % window] = ekf.y**2
            if k >= window - 1:
                dom = np.diag(ekf.S) - squares.mean(axis=0)
                for i in range(2):
                    moved = known["scale"] * adjustment(dom[i] / (known["scale"] * sigma**2))
                    scale[i] = max(scale[i] + moved, known["floor"])
            miss = truth[k, :2] - ekf.x[:2]
            total += miss @ miss
        return total

    return run


def tuning() -> None:
    """One generation of PSO: 50 individuals x 20 runs x 500 steps of an adaptive EKF; filterpy in a loop."""
    compiled("require")
    small, large = tk.scenario("two_stations", steps=STEPS), two_directions()
    works: dict[str, Callable[[], Any]] = {}
    for label, scenario in (("n = 4, m = 2", small), ("n = 6, m = 4", large)):
        works |= {
            f"{label}, EKF, RMSE": generations(scenario, adapted=False, wanted="squared_error"),
            f"{label}, adaptive EKF, RMSE": generations(
                scenario, adapted=True, wanted="squared_error"
            ),
            f"{label}, adaptive EKF, mismatch": generations(
                scenario, adapted=True, wanted="mismatch"
            ),
        }
    estimator, named = problem(small, adapted=True)
    simulation = small.simulate(SEED, RUNS)
    given = np.array([[numbers(estimator)[name]] for name in named])
    ours = trials_of(estimator, named, simulation, "squared_error")(given)["squared_error"][0, 0]
    prior = simulation.prior[0]
    peer = optional(
        "filterpy",
        lambda: by_filterpy(
            simulation.record.z[..., 0], prior.mean, prior.cov, simulation.truth[..., 0]
        ),
    )
    if peer is not None:
        agreed("filterpy with the adapter, one run", ours[0], peer())
    seconds = measure.interleaved(works)
    rows = []
    for label, times in seconds.items():
        one = float(np.median(times)) / GENERATIONS
        least = min(times) / GENERATIONS
        ns = f"{one / (LANES * STEPS) * NANO:.1f}"
        rows.append((label, f"{1e3 * one:.1f}", f"{1e3 * least:.1f}", ns))
    verdicts = [
        Verdict(f"a generation, {label}", float(np.median(seconds[f"{label}, adaptive EKF, RMSE"]))
                / GENERATIONS * 1e3, wanted, at_least=False, unit="ms")
        for label, wanted in (("n = 4, m = 2", 12.0), ("n = 6, m = 4", 30.0))
    ]  # fmt: skip
    if peer is not None:
        label = "n = 4, m = 2, adaptive EKF, RMSE"
        loop = measure.interleaved({"peer": peer}, 7)["peer"]
        one = float(np.median(loop))
        name = f"filterpy in a loop, n = 4, m = 2 (one run x {LANES})"
        rows.append((name, f"{1e3 * one * LANES:,.0f}", f"{1e3 * min(loop) * LANES:,.0f}",
                     f"{one / STEPS * NANO:,.0f}"))  # fmt: skip
        times = one * LANES / (float(np.median(seconds[label])) / GENERATIONS)
        print(f"  filterpy in a loop takes {times:,.0f} times as long")
    header = ("", "ms a generation", "least", "ns a step and lane")
    table("One generation, optimiser included, simulation left out", header, rows)
    table("Targets", ("", "found", "target", "verdict (1 or more is met)"),
          [verdict.cells() for verdict in verdicts])  # fmt: skip
