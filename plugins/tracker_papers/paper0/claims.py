"""The six claims of paper 0 as rules on numbers: each is a function from what was measured to a claim.

Nothing is run here, so that every rule can be tried on numbers made up for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.metrics.consistency import Interval
from tracker.metrics.resampling import bootstrap_interval, ratio_of_medians
from tracker.reproduction import Claim, Paper, all_of, within
from tracker.types import Array, ArrayLike, as_array

EQUAL = 1.1
THREE = (2.5, 3.5)
START, MANOEUVRE = 2.0, 1.0
PEAK, REMOVED = 3.0, 0.9
COLLINEAR = 2.0
STRAIGHT_RATE, TURNING_RATE, LAG = 0.25, 0.75, 0.3
CROSSED = 20.0
"""The thresholds that the rules in paper.toml state."""

Rmse = Mapping[str, Mapping[str, Mapping[str, Array]]]
"""Preset -> method -> "filter" or "smoother" -> RMSE of each run, ``(runs,)``."""

Errors = Mapping[str, Mapping[str, Mapping[str, Array]]]
"""The same with the position error at each step, ``(T, runs)``."""


def _claim(
    paper: Paper, name: str, votes: Mapping[str, bool | None], found: Sequence[str]
) -> Claim:
    text, rule = paper.claims[name]
    return Claim(name, text, rule, dict(votes), " ".join(found))


def _at_most(interval: Interval, bound: float) -> bool | None:
    return within(interval, -np.inf, bound)


def _at_least(interval: Interval, bound: float) -> bool | None:
    return within(interval, bound, np.inf)


def _shown(interval: Interval) -> str:
    return f"{interval.value:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def equally_good(paper: Paper, rmse: Rmse, rng: np.random.Generator) -> Claim:
    """Claim 1."""
    votes: dict[str, bool | None] = {}
    found = []

    def spread(*samples: Array) -> Array:
        medians = np.stack([np.median(one, axis=-1) for one in samples])
        return np.asarray(medians.max(axis=0) / medians.min(axis=0))

    for preset, methods in rmse.items():
        parts = []
        for stage in ("filter", "smoother"):
            ratio = bootstrap_interval(spread, *(one[stage] for one in methods.values()), rng=rng)
            parts.append(_at_most(ratio, EQUAL))
            medians = {name: np.nanmedian(one[stage]) for name, one in methods.items()}
            listed = ", ".join(f"{name} {value:.4g}" for name, value in medians.items())
            found.append(f"{preset}, {stage}: largest over smallest {_shown(ratio)} ({listed}).")
        votes[preset] = all_of(parts)
    return _claim(paper, "1", votes, found)


def three_times(paper: Paper, rmse: Rmse, rng: np.random.Generator) -> Claim:
    """Claim 2."""
    votes, found = {}, []
    for preset, methods in rmse.items():
        ratios = {
            name: ratio_of_medians(one["filter"], one["smoother"], rng=rng)
            for name, one in methods.items()
        }
        votes[preset] = all_of(within(ratio, *THREE) for ratio in ratios.values())
        listed = ", ".join(f"{name} {_shown(ratio)}" for name, ratio in ratios.items())
        found.append(f"{preset}: filter over smoother {listed}.")
    return _claim(paper, "2", votes, found)


@attrs.frozen(eq=False)
class Phases:
    """Which steps are the start, go straight, or are a manoeuvre and its aftermath; ``(T,)`` each, true or
    false.

    ``lost`` are those where the bearings hardly cross, and their aftermath; they are in no phase.
    """

    start: Any
    straight: Any
    manoeuvre: Any
    lost: Any


def phases(t: Array, path: Array, stations: ArrayLike) -> Phases:
    """The phases of a path ``(T, 4)`` by its turn rate; see the rule of claim 3.

    Steps at which the bearings cross at less than 20 degrees, and 0.3 s after them, belong to none:
    what happens there is claim 5.
    """
    places = as_array(stations, "stations")
    first, second = (np.arctan2(path[:, 1] - y, path[:, 0] - x) for x, y in places)
    lost = _and_after(t, np.abs(np.sin(first - second)) < np.sin(np.deg2rad(CROSSED)))
    heading = np.unwrap(np.arctan2(path[:, 3], path[:, 2]))
    rate = np.abs(np.gradient(heading, t))
    start = t <= t[0] + 0.1 * (t[-1] - t[0])
    manoeuvre = _and_after(t, rate > TURNING_RATE) & ~start
    straight = (rate < STRAIGHT_RATE) & ~manoeuvre & ~start
    return Phases(start & ~lost, straight & ~lost, manoeuvre & ~lost, lost)


def _and_after(t: Array, when: Any) -> Any:
    """The steps of ``when`` and those less than the lag after them: errors decay, they do not stop."""
    since = np.where(when & (t[:, None] >= t), t[:, None] - t, np.inf)
    return since.min(axis=1) < LAG + 1e-9


def start_floor_and_manoeuvre(
    paper: Paper, errors: Errors, parts: Mapping[str, Phases], rng: np.random.Generator
) -> Claim:
    """Claim 3."""
    votes, found = {}, []
    for preset, methods in errors.items():
        held = []
        for name, stages in methods.items():
            error, part = stages["filter"], parts[preset]
            floor = _rms(error[part.straight])
            start = ratio_of_medians(_rms(error[part.start]), floor, rng=rng)
            turn = ratio_of_medians(_rms(error[part.manoeuvre]), floor, rng=rng)
            held += [_at_least(start, START), _at_least(turn, MANOEUVRE)]
            found.append(
                f"{preset}, {name}: floor {np.median(floor):.3g}, start over floor {_shown(start)}, "
                f"manoeuvre over floor {_shown(turn)}."
            )
        votes[preset] = all_of(held)
    return _claim(paper, "3", votes, found)


def _rms(error: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def peaks_removed(paper: Paper, errors: Errors, rng: np.random.Generator) -> Claim:
    """Claim 4."""
    votes, found = {}, []

    def removed(before: Array, left: Array) -> Array:
        return np.asarray(1.0 - left.sum(axis=-1) / before.sum(axis=-1))

    for preset, methods in errors.items():
        held = []
        for name, stages in methods.items():
            limit = PEAK * np.median(stages["filter"], axis=0)
            before = stages["filter"] > limit
            left = before & (stages["smoother"] > limit)
            with np.errstate(invalid="ignore"):  # no peak at all in a resample
                share = bootstrap_interval(removed, before.sum(axis=0), left.sum(axis=0), rng=rng)
            held.append(_at_least(share, REMOVED))
            found.append(
                f"{preset}, {name}: {before.mean():.1%} of the steps are peaks, "
                f"{_shown(share)} of them are gone."
            )
        votes[preset] = all_of(held)
    return _claim(paper, "4", votes, found)


def collinear_is_worse(
    paper: Paper,
    rmse: Mapping[str, Mapping[float, Array]],
    crossings: str,
    rng: np.random.Generator,
) -> Claim:
    """Claim 5: RMSE of each run by stage and by the angle at which the bearings cross, in degrees."""
    votes, found = {}, []
    for stage, by_angle in rmse.items():
        for angle, words in ((0.0, "one side"), (180.0, "both sides")):
            ratio = ratio_of_medians(by_angle[angle], by_angle[90.0], rng=rng)
            votes[f"{stage} {words}"] = _at_least(ratio, COLLINEAR)
            found.append(
                f"{stage}, stations on {words} of the ship: {_shown(ratio)} times the error."
            )
    return _claim(paper, "5", votes, [*found, crossings])


def recommended(
    paper: Paper, rmse: Rmse, cost: Mapping[str, int | None], rng: np.random.Generator
) -> Claim:
    """Claim 6."""
    votes: dict[str, bool | None] = {}
    listed = ", ".join(f"{name} {count}" for name, count in cost.items())
    found = [f"Operations of a step, forwards and backwards: {listed}."]
    for preset, methods in rmse.items():
        held: list[bool | None] = []
        for name, one in methods.items():
            mine, other = cost["ekf1"], cost[name]
            if name == "ekf1":
                continue
            if mine is None or other is None:
                held.append(None)
                continue
            ratio = ratio_of_medians(one["smoother"], methods["ekf1"]["smoother"], rng=rng)
            worth = Interval(
                *(bound * other / mine for bound in (ratio.value, ratio.low, ratio.high))
            )
            held.append(_at_least(worth, 1.0))
            found.append(f"{preset}: cost times error of {name} over that of ekf1 {_shown(worth)}.")
        votes[preset] = all_of(held)
    return _claim(paper, "6", votes, found)
