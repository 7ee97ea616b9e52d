"""The whole family of filters and smoothers beside EKF1, and beside the libraries that have them.

Costs are of the scored steps of 1,000 runs x 500 steps on two bearings (n = 4, m = 2), simulation left
out; of other libraries, of one run. Particle filters are in `particles`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import measure
import numpy as np
import peers
from common import (
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
    table,
)
from targets import Verdict

import tracker as tk
from tracker.compile import run
from tracker_motion import constant_velocity, switching
from tracker_sensors import position

FAMILY: dict[str, tuple[str, dict[str, Any], str | None]] = {
    "ekf1": ("ekf1", {}, None),
    "ekf1 + rts": ("ekf1", {}, "rts"),
    "ekf1 + two_filter": ("ekf1", {}, "two_filter"),
    "ekf1 + square_root_rts": ("ekf1", {}, "square_root_rts"),
    "ekf1 + fixed_lag, 10 steps": ("ekf1", {}, "fixed_lag"),
    "ekf1_joseph": ("ekf1_joseph", {}, None),
    "ekf2": ("ekf2", {}, None),
    "iekf": ("iekf", {}, None),
    "square_root": ("square_root", {}, None),
    "information": ("information", {}, None),
    "ukf": ("ukf", {}, None),
    "ukf_symmetric": ("ukf_symmetric", {}, None),
    "ukf_general, kappa -1": ("ukf_general", {"kappa": -1.0}, None),
    "ukf_spherical_simplex": ("ukf_spherical_simplex", {}, None),
    "ukf_minimal_simplex": ("ukf_minimal_simplex", {}, None),
    "ukf + rts": ("ukf", {}, "rts"),
    "ukf + sigma_point_rts": ("ukf", {}, "sigma_point_rts"),
    "ukf_square_root": ("ukf_square_root", {}, None),
    "ckf": ("ckf", {}, None),
    "ckf5": ("ckf5", {}, None),
    "ghkf": ("ghkf", {}, None),
    "iplf, 3 iterations": ("iplf", {"iterations": 3}, None),
    "schmidt, velocity considered": ("schmidt", {"considered": ["vx", "vy"]}, None),
    "huber": ("huber", {}, None),
    "student_t": ("student_t", {}, None),
}
WANTED = {
    "ekf1 + rts": 4.0,
    "ekf2": 2.0,
    "ukf": 4.0,
    "ukf_symmetric": 4.0,
    "imm of three models": 8.0,
}
DYNAMAX_UKF = 25.0
THEIRS = {
    "filterpy ekf": "ekf1",
    "filterpy ukf": "ukf",
    "filterpy kf + rts, positions": "kf + rts, positions",
    "filterpy imm, positions": "imm, positions",
    "Stone Soup ekf": "ekf1",
    "Stone Soup ukf": "ukf",
}
NEAR = {"Stone Soup ekf": 1e-4, "Stone Soup ukf": 2e-2}
DENSITIES = (0.01, 0.1, 1.0)
SWITCHING = 0.9 * np.eye(3) + 0.05 * (1.0 - np.eye(3))


def family() -> None:
    """Every filter of the family beside EKF1, filterpy, Stone Soup and dynamax."""
    compiled("on")
    scene = tk.scenario("two_stations", steps=STEPS)
    simulation = scene.simulate(SEED, RUNS)
    works: dict[str, Callable[[], Any]] = {}
    for label, (name, options, smoother) in FAMILY.items():
        works[label] = _scored(
            tk.estimator(
                tk.filters.make(name, **options),
                motion=scene.motion,
                sensor=scene.sensor,
                smoother=smoother,
            ),
            simulation,
        )
    motion = switching([constant_velocity(density) for density in DENSITIES], SWITCHING)
    works["imm of three models"] = _scored(
        tk.estimator("imm", motion=motion, sensor=scene.sensor), simulation
    )
    works["imm of three models + imm_smoother"] = _scored(
        tk.estimator("imm", motion=motion, sensor=scene.sensor, smoother="imm_smoother"), simulation
    )
    theirs, counts = _peers(scene, simulation)
    works["imm, positions"], more = _positions(motion)
    works["kf + rts, positions"], smoothed = _smoothed_positions()
    more |= smoothed
    theirs |= more
    counts |= dict.fromkeys(more, STEPS)
    per = dict.fromkeys(works, RUNS * STEPS)
    seconds = measure.interleaved(works | theirs)
    report(seconds, per | counts, NANO, "ns a step and run")

    verdicts = [
        Verdict(f"{label} / ekf1", _times(seconds, label, "ekf1"), most, at_least=False)
        for label, most in WANTED.items()
    ]
    if "dynamax ukf, vmap" in theirs:
        found = _times(seconds, "dynamax ukf, vmap", "ukf")
        verdicts.append(Verdict("dynamax ukf, vmap / ukf", found, DYNAMAX_UKF, at_least=True))
    ratios = [
        (f"{label}, one run / {ours}", f"{_times(seconds, label, ours) * RUNS:,.0f}")
        for label, ours in THEIRS.items()
        if label in theirs
    ]
    table("Beside others", ("", "times"), ratios)
    rows = [verdict.cells() for verdict in verdicts]
    table("Verdicts", ("", "found", "wanted", ""), rows)


def _times(seconds: Any, slow: str, fast: str) -> float:
    return measure.ratio(seconds[slow], seconds[fast])


def _scored(estimator: Any, simulation: Any) -> Callable[[], Any]:
    why = run.reason(estimator) or (estimator.smoother and run.why_not_backwards(estimator))
    if why:
        raise SystemExit(f"{type(estimator.filter).__name__} runs on arrays: {why}")
    given = (simulation.record, simulation.prior, simulation.start, simulation.truth)
    return lambda: run.scored(estimator, *given)


def _peers(scene: Any, simulation: Any) -> tuple[dict[str, Callable[[], Any]], dict[str, int]]:
    """The peers' versions, after each was found to agree with ours."""
    problem = {"stations": STATIONS, **PROBLEM}
    z, mean, cov = one_run(simulation)
    history = {
        name: tk.filter(
            tk.estimator(name, motion=scene.motion, sensor=scene.sensor),
            simulation.record,
            simulation.prior,
            start=simulation.start,
        ).filtered.mean
        for name in ("ekf1", "ukf")
    }
    works: dict[str, Callable[[], Any]] = {}
    counts: dict[str, int] = {}
    for label, make, ours in (
        ("filterpy ekf", peers.filterpy_ekf, "ekf1"),
        ("filterpy ukf", peers.filterpy_ukf, "ukf"),
        ("Stone Soup ekf", peers.stonesoup_ekf, "ekf1"),
        ("Stone Soup ukf", peers.stonesoup_ukf, "ukf"),
    ):
        made = optional(label, functools.partial(make, z, mean, cov, **problem))
        if made is not None:
            # Stone Soup differentiates by differences, and its state order has other roots.
            agreed(label, history[ours][..., 0], made(), NEAR.get(label, 1e-9))
            works[label], counts[label] = made, STEPS
    lanes_first = (
        np.moveaxis(simulation.record.z, -1, 0),
        np.broadcast_to(np.moveaxis(simulation.prior.mean.reshape(4, -1), -1, 0), (RUNS, 4)),
        np.broadcast_to(np.moveaxis(simulation.prior.cov.reshape(4, 4, -1), -1, 0), (RUNS, 4, 4)),
    )
    made = optional("dynamax", lambda: peers.dynamax_ukf(*lanes_first, **problem))
    if made is not None:
        # It cannot be told that azimuths wrap, and adds 1e-9 to variances before it divides by them.
        turned = (np.abs(np.diff(simulation.record.z, axis=0)) > np.pi).any(axis=(0, 1))
        ours, found = np.moveaxis(history["ukf"], -1, 0)[~turned], made()[~turned]
        near = np.abs(ours - found).max(axis=(1, 2)) < 1e-3
        agreed(f"dynamax ukf, {near.sum()} of {len(near)} runs", ours[near], found[near], 1e-3)
        works["dynamax ukf, vmap"], counts["dynamax ukf, vmap"] = made, RUNS * STEPS
    return works, counts


def _measured_positions(motion: Any) -> tuple[tk.Scenario, Any]:
    scene = tk.Scenario(
        name="positions",
        motion=motion,
        truth_motion=constant_velocity(0.1),
        sensor=position(0.1),
        prior=tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0])),
        t=PROBLEM["dt"] * np.arange(1, STEPS + 1),
    )
    return scene, scene.simulate(SEED, RUNS)


def _smoothed_positions() -> tuple[Callable[[], Any], dict[str, Callable[[], Any]]]:
    """Filter and smoother on measured positions; filterpy's smoother is one of linear problems."""
    scene, simulation = _measured_positions(constant_velocity(0.1))
    estimator = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor, smoother="rts")
    z, mean, cov = one_run(simulation)
    problem = {"dt": PROBLEM["dt"], "density": 0.1, "sigma": 0.1}
    label = "filterpy kf + rts, positions"
    made = optional(label, lambda: peers.filterpy_smoother(z, mean, cov, **problem))
    if made is None:
        return _scored(estimator, simulation), {}
    record, prior = tk.Record(simulation.record.t, z), tk.Gaussian(mean, cov)
    ours = tk.smooth(estimator, record, prior, start=simulation.start).smoothed
    agreed(label, ours.mean, made[1]())
    return _scored(estimator, simulation), {label: made[1]}


def _positions(motion: Any) -> tuple[Callable[[], Any], dict[str, Callable[[], Any]]]:
    """Interacting models on measured positions, which filterpy has too."""
    scene, simulation = _measured_positions(motion)
    estimator = tk.estimator("imm", motion=motion, sensor=scene.sensor)
    z, mean, cov = one_run(simulation)
    problem = {"densities": DENSITIES, "transition_matrix": SWITCHING, "sigma": 0.1}
    label = "filterpy imm, positions"
    peer = optional(label, lambda: peers.filterpy_imm(z, mean, cov, dt=PROBLEM["dt"], **problem))
    if peer is None:
        return _scored(estimator, simulation), {}
    record = tk.Record(simulation.record.t, z)
    prior = tk.Gaussian(mean, cov)
    ours = tk.filter(estimator, record, prior, start=simulation.start).filtered.mean
    agreed(label, ours, peer())
    return _scored(estimator, simulation), {label: peer}
