"""The seven claims of paper 4 as rules on numbers: each is a function from what was measured to a claim.

Nothing is run here, so that every rule can be tried on numbers made up for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tracker.metrics.consistency import Interval
from tracker.metrics.resampling import bootstrap_interval, ratio_of_medians
from tracker.reproduction import Claim, Paper, all_of, within
from tracker.types import Array

BETTER = 0.98
SETTLED, GOOD = 0.1, (0.8, 1.25)
IMPROVED = 1.1
JUMPED, SOON = 0.5, 75
NEAR, MOST = 0.1, 0.9
LEVEL = 0.05
"""The thresholds that the rules in paper.toml state."""

RANKS = (("ica", "pso"), ("pso", "ga"))
"""Which optimiser is claimed to be at least as good as which."""


def _claim(
    paper: Paper, name: str, votes: Mapping[str, bool | None], found: Sequence[str]
) -> Claim:
    text, rule = paper.claims[name]
    return Claim(name, text, rule, dict(votes), " ".join(found))


def _shown(interval: Interval) -> str:
    return f"{interval.value:.3g} [{interval.low:.3g}, {interval.high:.3g}]"


def _at_most(interval: Interval, bound: float) -> bool | None:
    return within(interval, -np.inf, bound)


def _at_least(interval: Interval, bound: float) -> bool | None:
    return within(interval, bound, np.inf)


# ------------------------------------------------------------------------------ the rank test
def signed_rank(first: Array, second: Array) -> tuple[float, float]:
    """Wilcoxon's signed-rank test of paired samples: probability of chance of "first is lower", "higher".

    Both one-sided; 1 where the samples do not differ at all.

    Reference:
        Wilcoxon (1945); exact for up to 50 pairs without ties, as SciPy computes it.
    """
    from scipy.stats import wilcoxon

    off = np.asarray(first) - np.asarray(second)
    if not np.any(off) or not np.isfinite(off).all():
        return 1.0, 1.0
    return (
        float(wilcoxon(off, alternative="less").pvalue),
        float(wilcoxon(off, alternative="greater").pvalue),
    )


def holm(chances: Sequence[float]) -> list[float]:
    """Probabilities of several tests, corrected so that any false alarm is as rare as for one.

    Reference:
        Holm (1979), A simple sequentially rejective multiple test procedure.

    Example:
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    order = np.argsort(chances)
    out, largest = [0.0] * len(chances), 0.0
    for place, index in enumerate(order):
        largest = max(largest, min(1.0, (len(chances) - place) * chances[index]))
        out[index] = largest
    return out


def ranking(values: Mapping[str, Array]) -> tuple[bool | None, str]:
    """Whether optimisers are in the claimed order, and the tests in words.

    Shapes:
        values ``(restarts,)`` by optimiser, paired.
    """
    from scipy.stats import friedmanchisquare

    lower, higher = [], []
    for a, b in RANKS:
        less, more = signed_rank(values[a], values[b])
        lower.append(less)
        higher.append(more)
    lower, higher = holm(lower), holm(higher)
    words = []
    votes: list[bool | None] = []
    for (a, b), less, more in zip(RANKS, lower, higher, strict=True):
        votes.append(True if less < LEVEL else False if more < LEVEL else None)
        gain = float(np.median(np.asarray(values[a]) / np.asarray(values[b]))) - 1.0
        words.append(
            f"{a.upper()} against {b.upper()}: median difference {100 * gain:+.2f} %, p = {less:.2g} that it "
            f"is lower and {more:.2g} that it is higher by chance"
        )
    together = float(friedmanchisquare(*values.values()).pvalue) if len(values) > 2 else np.nan
    count = len(next(iter(values.values())))
    said = (
        f"{'; '.join(words)} ({count} restarts; Friedman's test of all three p = {together:.2g})."
    )
    return all_of(votes), said


# ----------------------------------------------------------------------------------- claims
def fuzzy_beats(
    paper: Paper, rmse: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 1a: RMSE ``(n, runs)`` by experiment and filter."""
    votes: dict[str, bool | None] = {}
    found = []
    for experiment, by in rmse.items():
        for name in ("ga", "pso", "ica"):
            ratios = [
                ratio_of_medians(tuned, plain, rng=rng)
                for tuned, plain in zip(by[name], by["kf"], strict=True)
            ]
            votes[f"{experiment}, {name.upper()}"] = all_of(_at_most(r, 1.0) for r in ratios)
            words = ", ".join(f"X{k} {_shown(r)}" for k, r in enumerate(ratios, 1))
            found.append(f"Experiment {experiment}, {name.upper()}: tuned over untuned {words}.")
    return _claim(paper, "1a", votes, found)


def in_order(paper: Paper, name: str, values: Mapping[str, Mapping[str, Array]]) -> Claim:
    """Claims 1b and 1c: cost or error ``(restarts,)`` by experiment and optimiser."""
    votes, found = {}, []
    for experiment, by in values.items():
        votes[f"experiment {experiment}"], words = ranking(by)
        found.append(f"Experiment {experiment}: {words}")
    return _claim(paper, name, votes, found)


def measurement_rather_than_process(
    paper: Paper, rmse: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 2: RMSE ``(n, runs)`` by experiment ("R", "Q") and filter ("kf", "ica")."""
    votes, found = {}, []

    def factors(a: Array, b: Array, c: Array, d: Array) -> Array:
        m = [np.median(one, axis=-1) for one in (a, b, c, d)]
        return np.asarray((m[0] / m[1]) / (m[2] / m[3]))

    for state in range(3):
        samples = [rmse[e][f][state] for e in ("R", "Q") for f in ("kf", "ica")]
        ratio = bootstrap_interval(factors, *samples, rng=rng)
        votes[f"X{state + 1}"] = _at_least(ratio, 1.0) if state < 2 else _at_most(ratio, 1.0)
        both = [float(np.median(samples[k]) / np.median(samples[k + 1])) for k in (0, 2)]
        found.append(
            f"X{state + 1}: adapting R divides the error by {both[0]:.2f}, adapting Q by {both[1]:.2f}; "
            f"ratio {_shown(ratio)}."
        )
    return _claim(paper, "2", votes, found)


def fuzzy_then_unscented_then_extended(
    paper: Paper, place: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 3: position RMSE ``(runs,)`` by table and filter ("fuzzy", "ukf", "ekf")."""
    votes, found = {}, []
    for table, by in place.items():
        for better, worse in (("fuzzy", "ukf"), ("ukf", "ekf")):
            ratio = ratio_of_medians(by[better], by[worse], rng=rng)
            votes[f"{better} below {worse}, {table}"] = _at_most(ratio, BETTER)
            found.append(f"{table}: {better} over {worse} {_shown(ratio)}.")
    return _claim(paper, "3", votes, found)


def mismatch_vanishes(
    paper: Paper, late: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 4: by scenario "plain" and "dom" ``(m, runs)``, mismatch without and with adapter, and "R",
    the noise used over the true one, over the last steps.
    """
    votes, found = {}, []

    def share(a: Array, b: Array) -> Array:
        return np.asarray(np.abs(a.mean(axis=-1)) / np.abs(b.mean(axis=-1)))

    for scenario, by in late.items():
        parts: list[bool | None] = []
        words = []
        for dom, plain, ratio in zip(by["dom"], by["plain"], by["R"], strict=True):
            left = bootstrap_interval(share, dom, plain, rng=rng)
            reached = bootstrap_interval(lambda a: np.median(a, axis=-1), ratio, rng=rng)
            parts += [_at_most(left, SETTLED), within(reached, *GOOD)]
            words.append(
                f"{100 * left.value:.1f} % of DOM left, R {_shown(reached)} of the true one"
            )
        votes[scenario] = all_of(parts)
        found.append(f"{scenario}: {'; '.join(words)}.")
    return _claim(paper, "4", votes, found)


def motion_helps(
    paper: Paper, x1: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 5: RMSE of X1 ``(runs,)`` by filter and sensor motion."""
    votes, found = {}, []
    for name, by in x1.items():
        for worse, better in (("static", "constant"), ("constant", "manoeuvring")):
            ratio = ratio_of_medians(by[worse], by[better], rng=rng)
            votes[f"{name}: {worse} over {better}"] = _at_least(ratio, IMPROVED)
            found.append(f"{name}, {worse} over {better}: {_shown(ratio)}.")
    return _claim(paper, "5", votes, found)


def jumps_soon(
    paper: Paper, error: Mapping[str, Mapping[str, Array]], rng: np.random.Generator
) -> Claim:
    """Claim 6: position error ``(T, runs)`` by scenario and filter ("fuzzy", "ekf")."""
    votes, found = {}, []
    for scenario, by in error.items():
        ratio = ratio_of_medians(by["fuzzy"][SOON - 1], by["ekf"][SOON - 1], rng=rng)
        votes[scenario] = _at_most(ratio, JUMPED)
        found.append(f"{scenario}: after {SOON} steps {_shown(ratio)} of the EKF's error.")
    return _claim(paper, "6", votes, found)


def tracked_in_large_noise(paper: Paper, relative: Mapping[str, Array]) -> Claim:
    """Claim 7: error over distance at the end ``(runs,)`` by scenario."""
    votes, found = {}, []
    for scenario, values in relative.items():
        finite = np.isfinite(values)
        share = _share(np.where(finite, values < NEAR, 0.0).astype(float))
        middle = float(np.median(values[finite])) if finite.any() else np.nan
        votes[scenario] = _at_least(share, MOST)
        found.append(
            f"{scenario}: {share.value:.0%} [{share.low:.0%}, {share.high:.0%}] of the runs, median "
            f"{middle:.1%} of the distance."
        )
    return _claim(paper, "7", votes, found)


def _share(flags: Array) -> Interval:
    """A share with Wilson's interval, which does not shrink to a point when all agree."""
    n, p, z = len(flags), float(np.mean(flags)), 1.959963984540054
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half: Any = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return Interval(p, float(middle - half), float(middle + half))
