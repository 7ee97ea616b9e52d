"""Monte Carlo campaigns: many runs of a scenario through one or several estimators, and their scores.

A campaign keeps reductions, not histories. Runs are worked in chunks, each one array computation;
sums are taken over fixed blocks of runs, so the numbers do not depend on chunks or workers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tracker import estimation
from tracker.compile import run as compiled
from tracker.errors import CapabilityError, ConfigError, DomainError, UnknownComponent, wording
from tracker.estimation import Estimator
from tracker.metrics.consistency import (
    Band,
    Interval,
    chi_square_band,
    chi_square_point,
    mean_interval,
    nees,
)
from tracker.metrics.errors import error, squared_position_error
from tracker.metrics.observability import blind_spots, scenario_observability
from tracker.metrics.resampling import ratio_of_medians
from tracker.recursion import is_random, unseen
from tracker.simulation import Scenario, Simulation, stream
from tracker.types import Array, History, brief

BLOCK = 32
"""Runs per partial sum; chunks are whole multiples of it."""

DIVERGED = 10.0
"""A run has diverged if its final error exceeds this many times the median final error, or, where that is
larger, this many times what one who never measured is typically wrong by."""

SLIGHT = 1.25
"""A mean NEES that is wrong by a smaller factor is called slightly so: many runs show the smallest one."""

ABSURD = 3.0
"""A mean NEES above this many times n is told of even if few steps make it."""

PER_STEP = ("squared_error", "nees", "nis", "count", "finite")
PER_RUN = (
    "rmse",
    "final_error",
    "final_nees",
    "final_sigma",
    "reach",
    "nees",
    "nis",
    "count",
    "loglik",
)

TAIL = 0.99
"""A consistent run's final NEES lies below the point of chi-square that is passed with 1 % probability."""


# --------------------------------------------------------------------------------- the scores
def _keys(values: Mapping[str, object]) -> str:
    return f"<{', '.join(values)}>"


@attrs.frozen(eq=False)
class Scores:
    """What one estimator scored, filtered or smoothed.

    Shapes:
        per_run: name -> ``(runs,)``; per_step: name -> ``(T,)``, means over the runs that were
        finite (``finite`` is their number). NIS belongs to the filter; a smoother has NaN there.
        ``reach`` is how far a run's truth comes from the mean of its prior, or that prior's sigma.
    """

    n: int
    per_run: Mapping[str, Array] = attrs.field(repr=_keys)
    per_step: Mapping[str, Array] = attrs.field(repr=_keys)

    @property
    def diverged(self) -> Any:
        """Which runs diverged: final error not finite, or above 10 times the median one or the median reach.

        The median error alone is no yardstick where most runs are lost.
        """
        final = self.per_run["final_error"]
        median = np.median(final[np.isfinite(final)]) if np.isfinite(final).any() else 0.0
        reach = self.per_run.get("reach", np.empty(0))  # a file of an older version has none
        return ~(final <= DIVERGED * min([median, *([np.median(reach)] if reach.size else [])]))

    @property
    def lost(self) -> bool:
        """Whether more than half of the runs diverged: then no median is one of runs that did not."""
        return bool(2 * self.diverged.sum() > self.diverged.size)

    @property
    def unaware(self) -> Any:
        """Which runs diverged without knowing it: mean NEES over the run above 3 n, or not finite."""
        return self.diverged & ~(self.per_run["nees"] <= 3.0 * self.n)

    @property
    def rmse(self) -> Interval:
        """Mean over runs of the position RMSE over a run (paper 0, Table 1), with its interval."""
        return mean_interval(self.per_run["rmse"])

    def percentile(self, name: str, *q: float) -> list[float]:
        """Percentiles of a per-run score over the finite runs."""
        values = self.per_run[name]
        values = values[np.isfinite(values)]
        return np.percentile(values, q).tolist() if values.size else [np.nan] * len(q)

    def nees_band(self, step: int, probability: float = 0.95) -> Band:
        """Band of the mean NEES over runs at one step."""
        count = float(self.per_step["finite"][step])
        return chi_square_band(self.n * count, probability, per=max(count, 1.0))

    def nis_band(self, probability: float = 0.95) -> Band:
        """Band of NIS divided by its degrees of freedom, over all runs and steps."""
        total = float(self.per_run["count"][np.isfinite(self.per_run["nis"])].sum())
        return chi_square_band(total, probability, per=max(total, 1.0))

    @property
    def mean_nees(self) -> float:
        """Mean NEES over the steps and the finite runs; n if consistent."""
        values = self.per_step["nees"]
        values = values[np.isfinite(values)]
        return float(values.mean()) if values.size else np.nan

    @property
    def nees_share(self) -> float:
        """Share of steps whose mean NEES lies in its own 95 % band; NaN if no run was finite."""
        bands = ((self.nees_band(k), v) for k, v in enumerate(self.per_step["nees"]))
        inside = [band.low <= v <= band.high for band, v in bands if np.isfinite(v)]
        return float(np.mean(inside)) if inside else np.nan

    @property
    def final_share(self) -> float:
        """Share of the finite runs whose final NEES is above its 99 % point; 0.01 if consistent."""
        final = self.per_run.get("final_nees", np.empty(0))
        final = final[np.isfinite(final)]
        return float(np.mean(final > chi_square_point(TAIL, self.n))) if final.size else np.nan

    @property
    def mean_nis(self) -> float:
        """NIS divided by its degrees of freedom, over all finite runs and steps; 1 if consistent."""
        good = np.isfinite(self.per_run["nis"])
        degrees = float(self.per_run["count"][good].sum())
        return float(self.per_run["nis"][good].sum()) / degrees if degrees else np.nan


@attrs.frozen(eq=False)
class Campaign:
    """The result of `monte_carlo`.

    ``scores[estimator]["filter" or "smoother"]`` holds the numbers; `summary` puts them into words.
    ``seconds[estimator]`` is the CPU time of estimating and scoring, simulation left out; it is no part
    of what a seed makes the same.
    """

    scenario: str
    seed: int
    runs: int
    t: Array = attrs.field(repr=brief)
    scores: Mapping[str, Mapping[str, Scores]] = attrs.field(repr=_keys)
    sources: Mapping[str, str] = attrs.field(factory=dict, repr=False)
    seconds: Mapping[str, float] = attrs.field(factory=dict, repr=False)
    blind: Any = attrs.field(default=(), repr=False)
    """The scenario, whose blind spots are looked for when asked; or, from a file, their words."""
    unseen: Mapping[str, str] = attrs.field(factory=dict, repr=False)
    """In words, what a smoother does not see of a filter's beliefs, by estimator."""

    # -------------------------------------------------------------------------- in words
    def rows(self) -> list[dict[str, Any]]:
        """One row per estimator and stage: the numbers behind `summary`."""
        out = []
        for name, stages in self.scores.items():
            for stage, scores in stages.items():
                ten, median, ninety = scores.percentile("rmse", 10, 50, 90)
                rmse, smooth = scores.rmse, stage == "smoother"
                out.append(
                    {
                        "estimator": name,
                        "stage": stage,
                        "rmse": rmse.value,
                        "rmse_low": rmse.low,
                        "rmse_high": rmse.high,
                        "median": median,
                        "p10": ten,
                        "p90": ninety,
                        "nees": scores.mean_nees,
                        "nees_share": scores.nees_share,
                        "final_share": scores.final_share,
                        "nis": np.nan if smooth else scores.mean_nis,
                        "diverged": int(scores.diverged.sum()),
                    }
                )
        return out

    def summary(self, *metrics: str) -> str:
        """A table and, below it, what a person should conclude.

        ``metrics`` picks from "rmse", "nees", "nis", "diverged"; all by default.

        Raises:
            UnknownComponent: for another name.
        """
        known = ("rmse", "nees", "nis", "diverged")
        for metric in metrics:
            if metric not in known:
                raise UnknownComponent(f"no metric {metric!r}; there are {', '.join(known)}.")
        wanted = metrics or known
        header = ["estimator", "stage"]
        titles = {
            "rmse": ["RMSE [95 % interval]", "median [10 %, 90 %]"],
            "nees": ["NEES / n", "steps in 95 % band"],
            "nis": ["NIS / m [95 % band]"],
            "diverged": ["diverged"],
        }
        for metric in wanted:
            header += titles[metric]
        table = [header]
        for row in self.rows():
            scores = self.scores[row["estimator"]][row["stage"]]
            band = scores.nis_band()
            cells = {
                "rmse": [
                    f"{row['rmse']:.4g} [{row['rmse_low']:.4g}, {row['rmse_high']:.4g}]",
                    f"{row['median']:.4g} [{row['p10']:.4g}, {row['p90']:.4g}]",
                ],
                "nees": [f"{row['nees'] / scores.n:.3g}", f"{row['nees_share']:.0%}"],
                "nis": [
                    "-"
                    if row["stage"] == "smoother"
                    else f"{row['nis']:.4g} [{band.low:.4g}, {band.high:.4g}]"
                ],
                "diverged": [f"{row['diverged']} of {self.runs}"],
            }
            table.append([row["estimator"], row["stage"], *(c for m in wanted for c in cells[m])])
        widths = [max(len(line[i]) for line in table) for i in range(len(header))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in table
        ]
        title = f"{self.scenario}: {self.runs} runs, {len(self.t)} steps, seed {self.seed}"
        return "\n".join([title, *lines, *(f"Warning: {w}" for w in self.warnings(*wanted))])

    @property
    def unobservable(self) -> tuple[str, ...]:
        """What the record tells no estimator, in words; see `tracker.metrics.observability`."""
        if isinstance(self.blind, tuple):
            return self.blind
        return tuple(blind_spots(scenario_observability(self.blind, seed=self.seed)))

    def warnings(self, *metrics: str) -> list[str]:
        """What a person should be told before trusting these numbers; empty if nothing."""
        out = []
        for row in self.rows():
            scores = self.scores[row["estimator"]][row["stage"]]
            label = f"{row['estimator']} ({row['stage']})"
            ratio = row["nees"] / scores.n
            if scores.lost:
                out.append(
                    f"{label} is lost: {row['diverged']} of {self.runs} runs diverged (final error above "
                    f"{DIVERGED:g} times what one who never measured is typically wrong by, or times the "
                    "median, or not finite). None of its scores says anything else."
                )
                continue
            if "nees" in (metrics or ("nees",)) and row["nees_share"] < 0.5:
                word = "overconfident" if ratio > 1 else "underconfident"
                slightly = "slightly " if 1.0 / SLIGHT < ratio < SLIGHT else ""
                out.append(
                    f"{label} is {slightly}{word}: mean NEES is {ratio:.3g} times what a consistent estimator "
                    f"has, and inside its band at only {row['nees_share']:.0%} of the steps."
                )
            elif "nees" in (metrics or ("nees",)) and not ratio < ABSURD:
                out.append(
                    f"{label} is certain of what is not so at some steps of some runs: mean NEES is "
                    f"{ratio:.3g} times what a consistent estimator has, though inside its band at "
                    f"{row['nees_share']:.0%} of the steps."
                )
            tail = row["final_share"]
            if "nees" in (metrics or ("nees",)) and _too_often(tail, self.runs):
                out.append(
                    f"{label} is overconfident in {tail:.1%} of the runs: there the final NEES is above "
                    f"its {TAIL:.0%} point, which a consistent estimator passes in {1 - TAIL:.0%}."
                )
            if "diverged" in (metrics or ("diverged",)) and row["diverged"]:
                out.append(
                    f"{label} diverged in {row['diverged']} of {self.runs} runs (final error above "
                    f"{DIVERGED:g} times the median, or not finite), {int(scores.unaware.sum())} of "
                    "them without knowing it (NEES of the run above 3 n): read medians, not means."
                )
        out += [f"{name} (smoother): {words}" for name, words in self.unseen.items()]
        return out + [f"{self.scenario}: {words}" for words in self.unobservable]

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.summary())}</pre>"

    def ratios(self, to: str, score: str = "rmse", stage: str = "filter") -> dict[str, Interval]:
        """Each estimator's median of a score over that of the estimator named ``to``, with 95 % intervals.

        Runs are resampled whole, so that what all estimators share in a run cancels: an interval that
        leaves out 1 means a difference that is no chance. A run that either of both lost is left out.

        Raises:
            UnknownComponent: for an estimator, a score or a stage that there is not.

        Example:
        >>> import tracker as tk
        >>> scene = tk.scenario("line", axes=1)
        >>> told = {sigma: scene.sensor.with_parameters(sigma=sigma) for sigma in (3.0, 9.0)}
        >>> filters = {
        ...     f"sigma {sigma:g}": tk.estimator("kf", motion=scene.motion, sensor=sensor)
        ...     for sigma, sensor in told.items()
        ... }
        >>> found = tk.monte_carlo(filters, scene, runs=200).ratios("sigma 3")
        >>> found["sigma 9"].low > found["sigma 3"].value == 1.0
        True
        """
        having = {name: stages[stage] for name, stages in self.scores.items() if stage in stages}
        for what, given, known in (
            ("estimator", to, having),
            ("score", score, next(iter(having.values())).per_run if having else {}),
        ):
            if given not in known:
                there = ", ".join(map(str, known)) or "none"
                raise UnknownComponent(
                    f"no {what} {given!r} at stage {stage!r}; there are {there}."
                )
        below, rng = having[to].per_run[score], np.random.default_rng(self.seed)
        return {
            name: ratio_of_medians(scores.per_run[score], below, rng=rng)
            for name, scores in having.items()
        }

    # ----------------------------------------------------------------- pictures and files
    def plot_ratios(
        self,
        to: str,
        score: str = "rmse",
        stage: str = "filter",
        *,
        axes: Any = None,
        limits: tuple[float, float] | None = None,
        colours: Mapping[str, str] | None = None,
    ) -> Any:
        """A matplotlib Figure of `ratios`: a point with its interval for each estimator but ``to``.

        Drawn into ``axes`` if given, an estimator in its own of ``colours`` where there is one. The axis
        spans ``limits``, by default all up to five; who is beyond is at the right edge in words.

        Raises:
            PluginError: if matplotlib is not installed.
            UnknownComponent: as `ratios`.
        """
        from tracker.report.campaign import ratios_figure

        return ratios_figure(self, to, score, stage, axes, limits, colours or {})

    def plot(self) -> Any:
        """A matplotlib Figure: RMSE and NEES against time, for every estimator.

        Raises:
            PluginError: if matplotlib is not installed.
        """
        from tracker.report.campaign import figure

        return figure(self)

    def report(self, path: str | Path) -> Path:
        """Write a self-contained HTML report.

        Raises:
            PluginError: if matplotlib is not installed.
        """
        from tracker.report.campaign import write

        return write(self, Path(path))

    def save(self, path: str | Path) -> Path:
        """Write everything to one ``.npz`` file; `load_campaign` reads it back."""
        from tracker.io.arrays import save_arrays

        arrays = {"t": self.t}
        stages = []
        for i, (name, by_stage) in enumerate(self.scores.items()):
            for stage, scores in by_stage.items():
                stages.append([name, stage, scores.n])
                for group, values in (("run", scores.per_run), ("step", scores.per_step)):
                    arrays |= {f"{i}/{stage}/{group}/{k}": v for k, v in values.items()}
        metadata = {
            "kind": "campaign",
            "scenario": self.scenario,
            "seed": self.seed,
            "runs": self.runs,
            "stages": stages,
            "sources": dict(self.sources),
            "unobservable": list(self.unobservable),
            "unseen": dict(self.unseen),
        }
        save_arrays(Path(path), arrays, metadata)
        return Path(path)


def _too_often(share: float, runs: int) -> bool:
    """Whether a share of runs beyond `TAIL` is more than three times what it should be, and no chance.

    False alarm: five standard deviations, less than 1 in 1,000 campaigns of a consistent estimator.
    """
    expected = 1.0 - TAIL
    spread = np.sqrt(expected * TAIL / runs)
    return bool(share > 3.0 * expected and share > expected + 5.0 * spread)


def load_campaign(path: str | Path) -> Campaign:
    """A campaign that `Campaign.save` wrote.

    Raises:
        ConfigError: if the file is not one.
    """
    from tracker.io.arrays import load_arrays

    arrays, metadata = load_arrays(Path(path))
    if metadata.get("kind") != "campaign":
        raise ConfigError(
            wording(
                str(path),
                got=f"a file of kind {metadata.get('kind')!r}",
                expected="a campaign",
                do="give a file written by Campaign.save",
            )
        )
    names = list(dict.fromkeys(name for name, _, _ in metadata["stages"]))
    scores: dict[str, dict[str, Scores]] = {name: {} for name in names}
    for name, stage, n in metadata["stages"]:
        prefix = f"{names.index(name)}/{stage}"
        scores[name][stage] = Scores(
            n,
            # a file of an older version knows less
            {k: arrays[at] for k in PER_RUN if (at := f"{prefix}/run/{k}") in arrays},
            {k: arrays[f"{prefix}/step/{k}"] for k in PER_STEP},
        )
    return Campaign(
        metadata["scenario"],
        metadata["seed"],
        metadata["runs"],
        arrays["t"],
        scores,
        metadata["sources"],
        blind=tuple(metadata.get("unobservable", ())),
        unseen=metadata.get("unseen", {}),
    )


# -------------------------------------------------------------------------------- the running
def monte_carlo(
    estimators: Estimator | Mapping[str, Estimator],
    scenario: Scenario,
    runs: int = 1000,
    seed: int = 0,
    *,
    condition: int = 0,
    workers: int = 1,
    chunk: int | None = None,
    progress: bool = False,
) -> Campaign:
    """Run estimators over simulated runs of a scenario; all see the same random numbers.

    ``chunk`` runs are one array computation (rounded up to whole blocks; by default as many as
    keep temporaries in cache). ``workers`` threads share the chunks. Neither changes a bit of the
    result. ``condition`` numbers the cell of a study.

    Raises:
        DomainError: for a number of runs or workers below one, or a scenario without steps.
    """
    for name, value in (("runs", runs), ("workers", workers), ("chunk", chunk or 1)):
        if value < 1:
            raise DomainError(
                wording(f"argument {name!r}", got=value, expected="at least 1", do="pass more")
            )
    if not isinstance(scenario, Scenario):
        raise CapabilityError(
            wording(
                "argument 'scenario'",
                got=repr(scenario)[:80],
                expected="a Scenario",
                do="pass tk.scenario(name)",
            )
        )
    if not len(scenario.t):
        raise DomainError(
            wording(
                f"scenario {scenario.name!r}",
                got="no measurement times",
                expected="at least one step to score",
                do="give it times t",
            )
        )
    if not isinstance(estimators, (Estimator, Mapping)):
        raise CapabilityError(
            wording(
                "argument 'estimators'",
                got=repr(estimators)[:80],
                expected="an Estimator, or a mapping of names to them",
                do="pass {'name': estimator, ...}",
            )
        )
    named = {"estimator": estimators} if isinstance(estimators, Estimator) else dict(estimators)
    if not named:
        raise CapabilityError("argument 'estimators': got none. Do this: pass at least one.")
    for label, built in named.items():
        comparable(label, built, scenario)
    size = chunk or max(BLOCK, estimation.LANE_BYTES // (8 * scenario.motion.space.size**2))
    size = size // BLOCK * BLOCK if chunk is None else -(-size // BLOCK) * BLOCK
    pieces = [range(a, min(a + size, runs)) for a in range(0, runs, size)]

    def work(piece: range) -> tuple[dict[tuple[str, str], _Reduced], dict[str, float]]:
        return _chunk(named, scenario, piece, seed, condition)

    done = _mapped(work, pieces, workers, progress)
    scores: dict[str, dict[str, Scores]] = {}
    for name, built in named.items():
        stages = ("filter",) if built.smoother is None else ("filter", "smoother")
        scores[name] = {
            stage: _joined([part[name, stage] for part, _ in done], scenario.motion.space.size)
            for stage in stages
        }
    return Campaign(
        scenario.name,
        seed,
        runs,
        scenario.t,
        scores,
        {k: v.cite() for k, v in named.items()},
        {k: sum(seconds[k] for _, seconds in done) for k in named},
        scenario,
        {
            k: words
            for k, v in named.items()
            if v.smoother is not None and (words := unseen(v.filter, v.motion, v.smoother))
        },
    )


def comparable(label: str, estimator: Estimator, scenario: Scenario) -> None:
    """Refuse an estimator whose states or measurements mean something else than the scenario's."""
    truth, assumed = scenario.motion.space, estimator.motion.space
    if assumed.names != truth.names:
        raise CapabilityError(
            wording(
                f"the motion model of {label!r}",
                got=f"states ({', '.join(assumed.names)})",
                expected=f"those of the scenario ({', '.join(truth.names)}), to be compared with",
                do="use a motion model of the same states",
            )
        )
    measured, read = scenario.sensor.space, estimator.sensors[0].space
    same = [(a.unit, a.circular) for a in measured] == [(a.unit, a.circular) for a in read]
    if len(estimator.sensors) != 1 or not same:
        raise CapabilityError(
            wording(
                f"the sensor of {label!r}",
                got=f"{read.size} components ({read})",
                expected=f"the scenario's measurements ({measured})",
                do="use a sensor that measures the same; several sensors as a stack",
            )
        )


def _mapped(
    work: Callable[[range], Any], pieces: list[range], workers: int, progress: bool
) -> list[Any]:
    shown: Callable[[Iterable[Any]], Iterable[Any]] = iter
    if progress:
        from tracker.progress import progress as bar

        def shown(items: Iterable[Any]) -> Iterable[Any]:
            return bar(items, "runs", total=len(pieces))

    if workers == 1:
        return [work(piece) for piece in shown(pieces)]
    with ThreadPoolExecutor(workers) as pool:
        return list(shown(pool.map(work, pieces)))


@attrs.frozen(eq=False)
class _Reduced:
    """One chunk's scores: per run, and per step as partial sums over blocks ``(T, blocks)``."""

    per_run: dict[str, Array]
    partial: dict[str, Array]


def _chunk(
    estimators: Mapping[str, Estimator], scenario: Scenario, runs: range, seed: int, condition: int
) -> tuple[dict[tuple[str, str], _Reduced], dict[str, float]]:
    """Scores by estimator and stage, and CPU seconds by estimator."""
    simulation = scenario.simulate(seed, runs, condition=condition)
    out: dict[tuple[str, str], _Reduced] = {}
    seconds: dict[str, float] = {}
    reach = _reach(simulation, scenario)
    for name, built in estimators.items():
        begun = time.thread_time()
        estimation.fitting(built, simulation.record, simulation.prior, simulation.start)
        for stage, reduced in _scored(built, scenario, simulation, seed, condition).items():
            reduced.per_run["reach"] = reach
            out[name, stage] = reduced
        seconds[name] = time.thread_time() - begun
    return out, seconds


def _reach(simulation: Simulation, scenario: Scenario) -> Array:
    """How far the truth of each run comes from the mean of its prior, or that prior's sigma: ``(runs,)``.

    An estimator that never measured, nor moved its estimate, would be wrong by about so much.
    """
    prior, space = simulation.prior.moments(), scenario.motion.space
    away = error(simulation.truth, prior.mean.reshape(1, space.size, -1), space)
    farthest = np.sqrt(squared_position_error(away, space)).max(axis=0)
    sigma = np.sqrt(sum(prior.cov[i, i] for i in space.position))
    return np.asarray(np.maximum(farthest, sigma) + np.zeros(len(simulation.runs)))


def _scored(
    estimator: Estimator, scenario: Scenario, simulation: Simulation, seed: int, condition: int
) -> dict[str, _Reduced]:
    record, prior, start = simulation.record, simulation.prior, simulation.start
    smooth = estimator.smoother is not None
    if not compiled.reason(estimator) and not (smooth and compiled.why_not_backwards(estimator)):
        sums = compiled.scored(estimator, record, prior, start, simulation.truth)
        return {stage: _from_sums(found, len(scenario.t)) for stage, found in sums.items()}
    rng = None
    if is_random(estimator.filter):
        rng = [stream(seed, run, "filter", condition) for run in simulation.runs]
    history = estimation.filter(estimator, record, prior, start=start, rng=rng)
    out = {"filter": _reduced(history, simulation.truth, scenario, smooth=False)}
    if smooth:
        history = estimation.smoothed(estimator, history)
        out["smoother"] = _reduced(history, simulation.truth, scenario, smooth=True)
    return out


def _from_sums(sums: compiled.Sums, steps: int) -> _Reduced:
    """What a compiled campaign added up, under the names of the scores."""
    squared, score, *filtered = sums.totals
    nothing = np.full((3, *squared.shape), np.nan)
    nis, count, loglik = filtered or nothing
    per_run = {
        "rmse": np.sqrt(squared / steps),
        "final_error": np.sqrt(sums.final[0]),
        "final_nees": sums.final[1],
        "final_sigma": np.sqrt(sums.final[2]),
        "nees": score / steps,
        "nis": nis,
        "count": count,
        "loglik": loglik,
    }
    names = (
        ("squared_error", "nees", "nis", "count", "finite")
        if filtered
        else ("squared_error", "nees", "finite")
    )
    partial = dict(zip(names, sums.partial, strict=True))
    missing = np.full_like(sums.partial[0], np.nan)
    return _Reduced(per_run, {k: partial.get(k, missing) for k in PER_STEP})


def _reduced(history: History, truth: Array, scenario: Scenario, *, smooth: bool) -> _Reduced:
    estimate = history.estimate if smooth else history.filtered
    space = scenario.motion.space
    errors = error(truth, estimate.mean, space)
    squared = squared_position_error(errors, space)
    score = nees(errors, estimate.cov)
    innovation = history.innovation
    nothing = np.full(squared.shape, np.nan)
    nis, count, loglik = (
        (nothing,) * 3 if smooth else (innovation.nis, innovation.count, innovation.loglik)
    )
    finite = np.isfinite(squared) & np.isfinite(score)
    with np.errstate(all="ignore"):
        per_run = {
            "rmse": np.sqrt(_time_mean(squared)),
            "final_error": np.sqrt(squared[-1]),
            "final_nees": score[-1],
            "final_sigma": np.sqrt(sum(estimate.cov[-1, i, i] for i in space.position)),
            "nees": _time_mean(score),
            "nis": _time_sum(nis),
            "count": _time_sum(count),
            "loglik": _time_sum(loglik),
        }
    values = {
        "squared_error": squared,
        "nees": score,
        "nis": nis,
        "count": count,
        "finite": finite.astype(np.float64),
    }
    if not smooth:  # an update that is not ok says nothing of NIS, whatever estimate it left
        lost = np.isnan(nis)
        values |= {"nis": np.where(lost, 0.0, nis), "count": np.where(lost, 0.0, count)}
    partial = {k: _blocks(np.where(finite, v, 0.0)) for k, v in values.items()}
    return _Reduced(per_run, partial)


def _time_sum(values: Array) -> Array:
    """Sum over time, step by step, so that a lane's bits do not depend on how many there are."""
    total = np.zeros(values.shape[1:])
    for row in values:
        total += row
    return total


def _time_mean(values: Array) -> Array:
    return _time_sum(values) / max(len(values), 1)


def _blocks(values: Array) -> Array:
    """Sums over blocks of runs, ``(T, blocks)``: the order of addition is that of the run numbers."""
    steps, runs = values.shape
    count = -(-runs // BLOCK)
    padded = np.zeros((steps, count * BLOCK))
    padded[:, :runs] = values
    return np.asarray(padded.reshape(steps, count, BLOCK).sum(axis=2))


def _joined(parts: list[_Reduced], n: int) -> Scores:
    per_run = {k: np.concatenate([p.per_run[k] for p in parts]) for k in PER_RUN}
    sums = {k: np.concatenate([p.partial[k] for p in parts], axis=1).sum(axis=1) for k in PER_STEP}
    with np.errstate(all="ignore"):
        per_step = {
            k: v if k == "finite" else v / np.where(sums["finite"] > 0, sums["finite"], np.nan)
            for k, v in sums.items()
        }
    return Scores(n, per_run, per_step)
