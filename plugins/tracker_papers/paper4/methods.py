"""What paper 4 compares: filters told the wrong noise, filters told the right one, and those that adapt.

Filters and adapters are named here and made by the registry; their mathematics is in their plugins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.adaptation import with_noise
from tracker.models import sqrt
from tracker.simulation import Simulation
from tracker.types import Array, Gaussian
from tracker_papers.underwater_multipath import PRESETS
from tracker_sensors.multipath_delays import multipath_delays
from tracker_sensors.stack import stack

HAND = 0.125
"""Unit of the five rules made by hand, in variances told: the feasibility trial's in chapters 3 and 4."""

HAND_ANGLES = 1.25
"""The same in chapter 5, where the variances told are a tenth of the true ones."""

BASELINES: Mapping[str, tuple[str, dict[str, Any]]] = MappingProxyType({
    "covariance matching": ("innovation_matching", {}),
    "innovation-adaptive": ("innovation_adaptive", {}),
    "Sage-Husa": ("sage_husa", {}),
})  # fmt: skip
"""Noise adapters that the thesis does not compare with, at their default settings."""

WRAPPED: Mapping[str, str] = MappingProxyType({
    "variational Bayes": "variational_bayes",
    "strong tracking": "strong_tracking",
    "SVSF": "smooth_variable_structure",
})  # fmt: skip
"""Adaptive filters that are filters of their own."""

TERMS = ("NM", "NS", "ZE", "PS", "PM")
ANSWERS = ("IL", "I", "M", "D", "DL")
"""Terms of the degree of mismatch, and what the noise then does (section 3.3)."""


def estimator(scene: tk.Scenario, name: str, adapter: Any = None, **options: Any) -> Any:
    """A filter on the models that a scenario tells its estimators."""
    made = tk.filters.make(name, **options) if options else name
    return tk.estimator(made, motion=scene.motion, sensor=scene.sensor, adapter=adapter)


def fuzzy(what: str, systems: int, *, scale: float = HAND, **options: Any) -> Any:
    """The adapter of fuzzy R or fuzzy Q with the five rules by hand, one system for each entry."""
    one: Any = tk.adapters.make(f"fuzzy_{what}_noise", scale=scale, **options)
    return attrs.evolve(one, system=one.system * systems)


def fuzzy_r(scene: tk.Scenario, scale: float = HAND) -> Any:
    """Fuzzy R, one system for each measured component (eq. 3-7)."""
    return fuzzy("measurement", scene.sensor.space.size, scale=scale)


def fuzzy_q(scene: tk.Scenario, scale: float = HAND, cross: str = "signed") -> Any:
    """Fuzzy Q of the linear example (eq. 3-9, 3-21): the mismatch of Z1, of Z2, and that of both together."""
    names = scene.sensor.space.names
    sources = [names[0], names[1], (names[0], names[1])]
    return fuzzy("process", 3, scale=scale, sources=sources, cross=cross)


def with_numbers(adapter: Any, numbers: Array, entries: int) -> Any:
    """A fuzzy adapter whose systems have these centres, widths and answers; its unit becomes one.

    Shapes:
        numbers ``(15 entries, *batch)``: for each entry five centres, five widths, five answers, in
        variances told.
    """
    many = len(adapter.system) > 1
    values: dict[str, Any] = {"scale": 1.0}
    for entry in range(entries):
        prefix = f"entry{entry + 1}_" if many else ""
        block = numbers[15 * entry : 15 * entry + 15]
        for i, (term, answer) in enumerate(zip(TERMS, ANSWERS, strict=True)):
            values[f"{prefix}dom_{term}_centre"] = block[i]
            values[f"{prefix}dom_{term}_width"] = block[5 + i]
            values[f"{prefix}adjustment_{answer}_centre"] = block[10 + i]
    return adapter.with_parameters(**values)


def bounds(largest: Array) -> Array:
    """Where the numbers of `with_numbers` may lie, ``(15 entries, 2)``, by the largest mismatch met.

    Centres within twice it, each on its side of zero; widths 2 to 60 % of it; answers up to a
    quarter of it, each with its sign: the choices of section 8 of the digest, where the thesis is
    silent.
    """
    out = []
    for size in np.atleast_1d(largest):
        sides = ((-2.0, 0.0), (-1.0, 0.0), (-0.5, 0.5), (0.0, 1.0), (0.0, 2.0))
        out += [(a * size, b * size) for a, b in sides]
        out += [(0.02 * size, 0.6 * size)] * 5
        answers = ((0.0, 0.25), (0.0, 0.25), (-0.01, 0.01), (-0.25, 0.0), (-0.25, 0.0))
        out += [(a * size, b * size) for a, b in answers]
    return np.array(out)


UNITS = 3
"""Hidden units of the neural network that takes the fuzzy system's place: 9 numbers instead of 15."""


def network_r(scene: tk.Scenario, scale: float = HAND) -> Any:
    """A network in the place of each fuzzy system of `fuzzy_r`."""
    one: Any = tk.adapters.make("neural_measurement_noise", scale=scale)
    return attrs.evolve(one, network=one.network * scene.sensor.space.size)


def with_network(adapter: Any, numbers: Array, entries: int) -> Any:
    """An adapter whose networks have these weights, biases and answers; its unit becomes one.

    Shapes:
        numbers ``(9 entries, *batch)``: for each entry three weights, three biases, three answers.
    """
    many = len(adapter.network) > 1
    values: dict[str, Any] = {"scale": 1.0}
    for entry in range(entries):
        prefix = f"entry{entry + 1}_" if many else ""
        block = numbers[3 * UNITS * entry : 3 * UNITS * (entry + 1)]
        for j in range(UNITS):
            for place, part in enumerate(("weight", "bias", "answer")):
                values[f"{prefix}unit{j + 1}_{part}"] = block[UNITS * place + j]
    return adapter.with_parameters(**values)


def network_bounds(largest: Array) -> Array:
    """Where the numbers of `with_network` may lie: steps at once to slopes over the whole mismatch.

    Answers are those of `bounds`; their sign makes a mismatch lower the noise where it is positive.
    """
    out: list[tuple[float, float]] = []
    for size in np.atleast_1d(largest):
        out += [(0.2 / size, 20.0 / size)] * UNITS
        out += [(-4.0, 4.0)] * UNITS
        out += [(-0.25 * size, 0.0)] * UNITS
    return np.array(out)


def by_hand(scale: float, entries: int) -> Array:
    """The five rules made by hand as the numbers of `with_numbers`, ``(15 entries,)``."""
    one = np.array(
        [-8.0, -2.0, 0.0, 2.0, 8.0, 2.5, 2.0, 1.0, 2.0, 2.5, 0.5, 0.12, 0.0, -0.12, -0.5]
    )
    return np.tile(scale * one, entries)


def linear_estimators(scene: tk.Scenario, right: tk.Scenario, hand: Any) -> dict[str, Any]:
    """Chapter 3: the filter told wrongly, the one told the truth, and the one that adapts by hand."""
    return {
        "kf": estimator(scene, "kf"),
        "true": estimator(right, "kf"),
        "hand": estimator(scene, "kf", hand),
    }


def underwater_estimators(scene: tk.Scenario, right: tk.Scenario, scale: float) -> dict[str, Any]:
    """Chapters 4 and 5: EKF, UKF, EKF told the truth, EKF with fuzzy R by hand."""
    return {
        "ekf": estimator(scene, "ekf1"),
        "ukf": estimator(scene, "ukf"),
        "true": estimator(right, "ekf1"),
        "hand": estimator(scene, "ekf1", fuzzy_r(scene, scale)),
    }


def fairly_begun(scene: tk.Scenario) -> tk.Scenario:
    """The scenario with a prior that holds its true start: its covariance and the square of how far it is off.

    The thesis begins up to ten standard deviations off, which no consistent filter expects.
    """
    off = np.diag((np.asarray(scene.start) - scene.prior.mean) ** 2)
    prior = Gaussian(scene.prior.mean, scene.prior.cov + off)
    return attrs.evolve(scene, prior=prior, name=f"{scene.name}, fairly begun")


def likeliest_noise(scene: tk.Scenario, runs: Simulation) -> Array:
    """R by expectation maximisation from runs without their truth, ``(m, m)``: a diagonal."""
    return tk.expectation_maximisation(
        estimator(scene, "ekf1"), runs.record, runs.prior, start=runs.start, process="fixed",
        measurement="diagonal",
    ).R  # fmt: skip


def underwater_baselines(scene: tk.Scenario, scale: float, R: Array) -> dict[str, Any]:
    """What the thesis lacks, under water: `baselines`, and the rest that this framework has.

    Fuzzy Q, by itself and with fuzzy R; a network in the place of the fuzzy system; and the EKF told
    ``R``, `likeliest_noise` of the runs that others are tuned on.
    """
    hand = fuzzy_r(scene, scale)
    joint = tk.adapters.make("joint_noise", measurement=hand, process="fuzzy_process_noise")
    return {
        "EM": tk.estimator("ekf1", motion=scene.motion, sensor=with_noise(scene.sensor, R)),
        "fuzzy Q": estimator(scene, "ekf1", "fuzzy_process_noise"),
        "fuzzy R and Q": estimator(scene, "ekf1", joint),
        "network by hand": estimator(scene, "ekf1", network_r(scene, scale)),
        **baselines(scene, "ekf1"),
    }


def baselines(scene: tk.Scenario, name: str) -> dict[str, Any]:
    """What the thesis lacks: other adapters beside the same filter, and adaptive filters around it."""
    out = {
        label: estimator(scene, name, tk.adapters.make(adapter, **options))
        for label, (adapter, options) in BASELINES.items()
    }
    for label, wrapped in WRAPPED.items():
        options = {} if wrapped == "smooth_variable_structure" else {"inner": name}
        out[label] = estimator(scene, wrapped, **options)
    return out


# ------------------------------------------------------------------------ printed equations
@attrs.frozen
class _PrintedJacobian:
    """Derivatives of both delays, those of the bottom path as eq. 4-25 and 4-30 print them."""

    positional: tuple[str, ...] = ("x", "y", "z")
    keywords: tuple[str, ...] = ("sx", "sy", "sz", "depth", "height", "speed")

    def __call__(
        self,
        x: Any,
        y: Any,
        z: Any,
        *,
        sx: Any,
        sy: Any,
        sz: Any,
        depth: Any,
        height: Any,
        speed: Any,
    ) -> Any:
        dx, dy, dz = x - sx, y - sy, z - sz
        r2 = dx**2 + dy**2 + dz**2
        r = sqrt(r2)
        up = sqrt(r2 + 4.0 * depth**2 - 4.0 * depth * dz)
        down = sqrt(r2 + 4.0 * height**2 - 4.0 * height * dz)  # 4-30: plus is right
        surface = (
            dx * (1.0 / up - 1.0 / r) / speed,
            dy * (1.0 / up - 1.0 / r) / speed,
            ((dz - 2.0 * depth) / up - dz / r) / speed,
        )
        bottom = (
            dx * (1.0 / down - 1.0 / r) / speed,
            dy * (1.0 / down - 1.0 / r) / speed,
            ((dz - 2.0 * height) / down - dz / r) / speed,  # 4-25: plus is right
        )
        return (surface, bottom)


def with_printed_jacobian(scene: tk.Scenario, preset: str = "M1", shrink: float = 1.0) -> Any:
    """EKF of chapter 4 whose Jacobian of the bottom path is the printed one, told R divided by ``shrink``."""
    return tk.estimator("ekf1", motion=scene.motion, sensor=printed_sensor(preset, shrink))


def printed_sensor(preset: str = "M1", shrink: float = 1.0) -> Any:
    """Both hydrophones with the printed Jacobian; what they measure is right."""
    channel = PRESETS[preset]
    sigma = float(np.sqrt(1e-3 / shrink))
    right = multipath_delays(sigma, depth=channel.depth, height=channel.height)
    wrong: Callable[..., Any] = _PrintedJacobian()
    sensor = attrs.evolve(right, derivative=wrong)
    return stack([sensor.at(sx=x, sy=y, sz=z) for x, y, z in channel.places])
