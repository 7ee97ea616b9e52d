"""Tuning: numbers of an estimator's parts sought by an optimiser, whose cost is what filter runs score.

Every candidate of every restart on every run is a lane of one call (`tracker.trials`); how candidates
move is the optimiser's. What was tuned is told on runs that it was not tuned on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, ConfigError, DomainError, TrackerError, wording
from tracker.estimation import Estimator
from tracker.metrics.consistency import Interval
from tracker.montecarlo import comparable
from tracker.optimisation import Optimisation, optimise, restored
from tracker.protocols import Optimiser
from tracker.registry import optimisers
from tracker.simulation import Scenario, stream
from tracker.trials import ERRORS, TOTALS, Place, Trials, numbers, place, retuned
from tracker.types import Array, Gaussian, Record, brief

__all__ = ["Score", "Tuned", "Tuning", "load_tuning", "tune"]

TRAINING, HELD_OUT, DRAWN_AGAIN = 2**30, 2**30 + 1, 2**30 + 2
"""Conditions of random streams (`tracker.simulation.stream`) that no cell of a study has."""

BOUND = 0.01
"""A number this near to a bound, as a share of what lies between the bounds, ended at the bound."""

ALPHA = 1000.0
"""The thesis's factor before degrees of mismatch (paper 4, eq. 3-18, 3-19)."""

SHOWN = 9
"""Settings of a front that a summary lists."""

HONEST = 1.25
"""A mean NEES that is wrong by a smaller factor is not worth a warning."""


# ---------------------------------------------------------------------------------- objectives
def _itself(means: Array) -> Array:
    return means[0]  # type: ignore[no-any-return]


def _from_one(value: Any) -> Any:
    return np.abs(np.log(value))


@attrs.frozen
class Objective:
    """What is asked of runs: means over runs of something, a number made of them, and its cost."""

    title: str
    needs: tuple[str, ...]
    of_runs: Callable[[Mapping[str, Array], int, int], Any]
    """From totals ``(., *settings, runs)``, steps and n to quantities ``(q, *settings, runs)``."""
    shown: Callable[[Array], Array] = _itself
    cost: Callable[[Any], Any] = np.positive


OBJECTIVES: Mapping[str, Objective] = {
    "rmse": Objective(
        "RMSE",
        ("squared_error",),
        lambda totals, steps, _: np.sqrt(totals["squared_error"] / steps),
    ),
    "nees": Objective(
        "NEES / n", ("nees",), lambda totals, steps, n: totals["nees"] / (steps * n), cost=_from_one
    ),
    "innovation": Objective(
        "NIS / m",
        ("nis", "count"),
        lambda totals, *_: np.concatenate([totals["nis"], totals["count"]]),
        lambda means: means[0] / means[1],
        _from_one,
    ),
    "likelihood": Objective(
        "log-likelihood a row",
        ("loglik",),
        lambda totals, steps, _: totals["loglik"] / steps,
        cost=np.negative,
    ),
    "dom": Objective(
        "mismatch",
        ("mismatch",),
        lambda totals, steps, _: ALPHA * np.sqrt(totals["mismatch"] / steps).sum(axis=0)[None],
    ),
}


# -------------------------------------------------------------------------------------- scores
@attrs.frozen(eq=False)
class Score:
    """What one setting scored on some runs.

    Shapes:
        totals: name -> ``(1, runs)``, "mismatch" ``(m, runs)``: sums over the steps.
    """

    totals: Mapping[str, Array] = attrs.field(repr=lambda totals: f"<{', '.join(totals)}>")
    steps: int
    n: int

    @property
    def runs(self) -> int:
        """How many."""
        return int(next(iter(self.totals.values())).shape[-1])

    @property
    def lost(self) -> Any:
        """Which runs have no finite numbers, ``(runs,)``."""
        return ~np.isfinite(np.concatenate(list(self.totals.values()))).all(axis=0)

    def offers(self, objective: str) -> bool:
        """Whether that is known: errors need the truth."""
        return all(name in self.totals for name in OBJECTIVES[objective].needs)

    def interval(self, objective: str, probability: float = 0.95) -> Interval:
        """What an objective looks at, over the runs that were not lost, with its confidence interval.

        Means over runs and ratios of such; the interval is Student's, with the jackknife's standard
        error, and unknown (NaN) for one run.

        Reference:
            Efron and Tibshirani (1993), An Introduction to the Bootstrap, chapter 11.
        """
        from scipy.special import stdtrit

        kept = self._parts(objective, ~self.lost)
        value, error = _jackknife(OBJECTIVES[objective].shown, kept)
        runs = kept.shape[-1]
        half = stdtrit(runs - 1, 0.5 + probability / 2.0) * error if runs > 1 else np.nan
        return Interval(value, float(value - half), float(value + half), probability)

    def cost(self, objective: str) -> float:
        """What the optimiser was told; NaN if a run was lost."""
        return float(_costs(objective, self.totals, self.steps, self.n))

    def _parts(self, objective: str, kept: Any) -> Array:
        totals = {name: value[:, kept] for name, value in self.totals.items()}
        return np.asarray(OBJECTIVES[objective].of_runs(totals, self.steps, self.n))

    def gain(self, over: Score, objective: str) -> tuple[float, float]:
        """By how much the cost is lower than another setting's on the same runs, and its standard error."""
        kept = ~(self.lost | over.lost)
        mine, theirs = self._parts(objective, kept), over._parts(objective, kept)
        asked, q = OBJECTIVES[objective], len(mine)

        def difference(means: Array) -> Array:
            return np.asarray(
                asked.cost(asked.shown(means[q:])) - asked.cost(asked.shown(means[:q]))
            )

        return _jackknife(difference, np.concatenate([mine, theirs]))


def _costs(objective: str, totals: Mapping[str, Array], steps: int, n: int) -> Any:
    """Cost of settings, ``(*settings)``, from totals ``(., *settings, runs)``."""
    asked = OBJECTIVES[objective]
    with np.errstate(all="ignore"):
        means = np.asarray(asked.of_runs(totals, steps, n)).mean(axis=-1)
        return asked.cost(asked.shown(means))


def _jackknife(statistic: Callable[[Array], Array], values: Array) -> tuple[float, float]:
    """A statistic of the means of values ``(q, runs)``, and its standard error; NaN where unknown."""
    runs = values.shape[-1]
    if not runs:
        return np.nan, np.nan
    with np.errstate(all="ignore"):
        total = values.sum(axis=-1)
        whole = float(statistic(total / runs))
        if runs == 1:
            return whole, np.nan
        without = statistic((total[:, None] - values) / (runs - 1))
        spread = ((without - without.mean()) ** 2).sum() * (runs - 1) / runs
    return whole, float(np.sqrt(spread))


# -------------------------------------------------------------------------------------- result
@attrs.frozen
class Tuned:
    """A number that was tuned: bounds, what it was, what it became. One name, or several that are tied."""

    name: str
    low: float
    high: float
    log: bool
    given: float
    value: float

    @property
    def at_bound(self) -> str:
        """At which it ended, "lower" or "upper", or ""."""
        low, high, value = (
            np.log([self.low, self.high, self.value])
            if self.log
            else (self.low, self.high, self.value)
        )
        share = (value - low) / (high - low)
        return "lower" if share < BOUND else "upper" if share > 1.0 - BOUND else ""


def _keys(values: Mapping[str, object]) -> str:
    return f"<{', '.join(values)}>"


@attrs.frozen(eq=False, kw_only=True)
class Tuning:
    """The result of `tune`; given to it again as ``resume``, its search goes on.

    ``estimator`` is the tuned one (None if this was read from a file: see `applied_to`). ``training``
    and ``held_out`` hold a `Score` each for the numbers "given" and "tuned"; held_out is empty if nothing
    was held out.

    Of several objectives, ``front`` holds such a result for each setting that no other found is better
    than in all of them, in the order of the first objective; the tuned numbers are a compromise, those
    of the front that are nearest to the lowest of all costs, each relative to its range there.

    Shapes:
        evaluated ``(G,)``: evaluations of a restart up to the end of each generation; best, mean
        ``(G, restarts)``: lowest cost up to then, mean over the finite costs of that generation;
        settings ``(d, restarts)``, costs ``(restarts,)``: the best of each restart. Of several
        objectives best and mean are ``(G, objectives, restarts)``, settings and costs ``(d, k)`` and
        ``(objectives, k)``: the front.
    """

    problem: str
    objective: str | tuple[str, ...]
    optimiser: str
    seed: int
    numbers: tuple[Tuned, ...]
    training: Mapping[str, Score] = attrs.field(repr=_keys)
    held_out: Mapping[str, Score] = attrs.field(repr=_keys)
    evaluated: Array = attrs.field(repr=brief)
    best: Array = attrs.field(repr=brief)
    mean: Array = attrs.field(repr=brief)
    settings: Array = attrs.field(repr=brief)
    costs: Array = attrs.field(repr=brief)
    rows: bool = False
    """Whether it is rows of a record that were held out, not runs."""
    redraw: bool = False
    estimator: Estimator | None = attrs.field(default=None, repr=False)
    search: Optimisation | None = attrs.field(default=None, repr=False)
    """None if this was read from a file that does not hold it: its optimiser is not registered."""
    front: tuple[Tuning, ...] = attrs.field(default=(), repr=False)

    @property
    def objectives(self) -> tuple[str, ...]:
        """Their names."""
        return (self.objective,) if isinstance(self.objective, str) else self.objective

    @property
    def values(self) -> dict[str, float]:
        """The tuned numbers by name; tied ones each by their own."""
        return {name: number.value for number in self.numbers for name in number.name.split(" = ")}

    @property
    def cost(self) -> float:
        """That of the tuned numbers on the training runs; of several objectives the first."""
        return self.training["tuned"].cost(self.objectives[0])

    def applied_to(self, estimator: Estimator) -> Estimator:
        """An estimator with the tuned numbers.

        Raises:
            DomainError: if it has no numbers of these names.
        """
        places = [[place(estimator, name)] for name in self.values]
        return retuned(estimator, places, list(self.values.values()))

    # ------------------------------------------------------------------------- in words
    def table(self) -> list[dict[str, Any]]:
        """One row per quantity: its intervals, training and held out, given and tuned."""
        out = []
        for name, asked in OBJECTIVES.items():
            if self.training["tuned"].offers(name):
                row: dict[str, Any] = {"objective": name, "title": asked.title}
                for where, scores in (("training", self.training), ("held out", self.held_out)):
                    row |= {f"{where}, {k}": score.interval(name) for k, score in scores.items()}
                out.append(row)
        return out

    def summary(self) -> str:
        """Numbers, scores side by side, and what a person should conclude."""
        restarts = self.best.shape[-1]
        many = f"{restarts} restarts" if restarts > 1 else "1 restart"
        used = int(self.evaluated[-1]) if len(self.evaluated) else 0
        aims = " and ".join(map(repr, self.objectives))
        head = (
            f"{self.problem}: tuned for {aims} by {self.optimiser}, {many} of {used} "
            f"evaluations, seed {self.seed}"
        )
        named = [["number", "given", "tuned", "between"]]
        for number in self.numbers:
            scale = " (log)" if number.log else ""
            cells = f"{number.given:.4g}", f"{number.value:.4g}"
            named.append([number.name, *cells, f"{number.low:g} and {number.high:g}{scale}"])
        kind = "rows" if self.rows else "runs"
        first = self.training["tuned"]
        sizes = [f"{first.steps if self.rows else first.runs} {kind} of training"]
        if self.held_out:
            other = self.held_out["tuned"]
            sizes.append(f"{other.steps if self.rows else other.runs} {kind} held out")
        columns = [f"{size}: {which}" for size in sizes for which in ("given", "tuned")]
        scored = [["[95 % interval]", *columns]]
        for row in self.table():
            mark = "* " if row["objective"] in self.objectives else "  "
            cells_ = [_cell(value) for value in row.values() if isinstance(value, Interval)]
            scored.append([mark + row["title"], *cells_])
        both = [*self.training.values(), *self.held_out.values()]
        if any(score.lost.any() for score in both):
            scored.append(["  lost runs", *(str(int(score.lost.sum())) for score in both)])
        said = [f"Warning: {words}" for words in self.warnings()]
        return "\n".join([head, *_aligned(named), *_aligned(scored), *self._front_lines(), *said])

    def _front_lines(self) -> list[str]:
        """Some of the front, evenly spread, as told on the runs held out."""
        if not self.front:
            return []
        titles = [OBJECTIVES[name].title for name in self.objectives]
        lines = [["front", *titles, *(number.name for number in self.numbers)]]
        for k in sorted(set(np.linspace(0, len(self.front) - 1, SHOWN).astype(int).tolist())):
            one = self.front[k]
            score = (one.held_out or one.training)["tuned"]
            told = [score.interval(name).value for name in self.objectives]
            cells = [f"{v:.4g}" for v in (*told, *(number.value for number in one.numbers))]
            lines.append([f"[{k}]", *cells])
        return _aligned(lines)

    def warnings(self) -> list[str]:
        """What a person should be told before using the numbers; empty if nothing."""
        out = [
            f"{n.name} ended at its {n.at_bound} bound: the best value may lie beyond it."
            for n in self.numbers
            if n.at_bound
        ]
        out += self._overfit()
        told = self.held_out or self.training
        lost = int(told["tuned"].lost.sum())
        if lost:
            out.append(f"{lost} of {told['tuned'].runs} runs were lost with the tuned numbers.")
        for name, what in (("nees", "NEES"), ("innovation", "NIS")):
            found = told["tuned"].interval(name) if told["tuned"].offers(name) else None
            if found is not None and (found.low > HONEST or found.high < 1.0 / HONEST):
                word = "overconfident" if found.value > 1.0 else "underconfident"
                out.append(
                    f"the tuned filter is {word}: its mean {what} is {found.value:.3g} times what a "
                    "consistent filter has."
                )
        if "rmse" not in self.objectives and told["tuned"].offers("rmse"):
            gain, error = told["tuned"].gain(told["given"], "rmse")
            if gain < -2.0 * error:
                before, after = (told[k].interval("rmse").value for k in ("given", "tuned"))
                aims = " and ".join(map(repr, self.objectives))
                out.append(
                    f"better by {aims} is not more accurate here: the RMSE went from "
                    f"{before:.4g} to {after:.4g}."
                )
        return out

    def _overfit(self) -> list[str]:
        """Whether what was won on the training runs was won elsewhere, in words."""
        if not self.held_out:
            return ["nothing was held out: these scores are those of the runs it was tuned on."]
        kind = "rows" if self.rows else "runs"
        out = []
        for name in self.objectives:
            won, error = self.training["tuned"].gain(self.training["given"], name)
            kept, other = self.held_out["tuned"].gain(self.held_out["given"], name)
            alone = " (a single run: chance is not ruled out)" if not np.isfinite(other) else ""
            error, other = (e if np.isfinite(e) else 0.0 for e in (error, other))
            if not np.isfinite(won - kept) or (won <= 0.0 and self.front):
                continue  # unknown, or what the other objectives cost
            cost = "the cost" if len(self.objectives) == 1 else f"the cost {name!r}"
            if kept < -2.0 * other:
                out.append(
                    f"overfitted: on the {kind} held out the tuned numbers are worse than the given ones; "
                    f"{cost} rose by {-kept:.3g}, where in training it fell by {won:.3g}{alone}."
                )
            elif won - kept > max(0.5 * won, 2.0 * math.hypot(error, other)):
                out.append(
                    f"overfitted: in training {cost} fell by {won:.3g}, on the {kind} held out by "
                    f"{kept:.3g}, less than half{alone}."
                )
        return out

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.summary())}</pre>"

    # -------------------------------------------------------------------------- in files
    def save(self, path: str | Path) -> Path:
        """Write all but the estimator to one ``.npz`` file; `load_tuning` reads it back.

        What can be resumed is among it, if the optimiser is registered.
        """
        from tracker.io.arrays import save_arrays

        arrays = {name: getattr(self, name) for name in _ARRAYS}
        arrays["numbers"] = np.array([[n.low, n.high, n.given, n.value] for n in self.numbers])
        sizes = {}
        for where, scores in (("training", self.training), ("held_out", self.held_out)):
            for which, score in scores.items():
                sizes[f"{where}/{which}"] = [score.steps, score.n]
                arrays |= {f"{where}/{which}/{k}": v for k, v in score.totals.items()}
            if scores and self.front:
                each = [getattr(one, where)["tuned"].totals for one in self.front]
                for name in each[0]:
                    arrays[f"front/{where}/{name}"] = np.stack([one[name] for one in each], axis=1)
        metadata = {
            "kind": "tuning",
            "numbers": [[n.name, n.log] for n in self.numbers],
            "sizes": sizes,
            **{name: getattr(self, name) for name in _WORDS},
        }
        if self.search is not None:
            try:
                searched, metadata["search"] = self.search.written()
            except CapabilityError:
                pass
            else:
                arrays |= {f"{_SEARCH}{name}": values for name, values in searched.items()}
        save_arrays(Path(path), arrays, metadata)
        return Path(path)


_ARRAYS = ("evaluated", "best", "mean", "settings", "costs")
_WORDS = ("problem", "objective", "optimiser", "seed", "rows", "redraw")
_SEARCH = "search/"


def load_tuning(path: str | Path) -> Tuning:
    """A result that `Tuning.save` wrote, without its estimator: see `Tuning.applied_to`.

    Raises:
        ConfigError: if the file is not one.
        UnknownComponent: if its optimiser is not installed.
    """
    from tracker.io.arrays import load_arrays

    arrays, metadata = load_arrays(Path(path))
    if metadata.get("kind") != "tuning":
        raise ConfigError(
            wording(str(path), got=f"a file of kind {metadata.get('kind')!r}", expected="a tuning",
                    do="give a file written by Tuning.save")
        )  # fmt: skip
    scores: dict[str, dict[str, Score]] = {"training": {}, "held_out": {}}
    fronts: dict[str, list[Score]] = {}
    for key, (steps, n) in metadata["sizes"].items():
        where, which = key.split("/")
        scores[where][which] = Score(_totals(arrays, key), steps, n)
        if f"front/{where}/loglik" in arrays:
            fronts[where] = _scores(_totals(arrays, f"front/{where}"), steps, n)
    kept: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    kept |= {name: metadata[name] for name in _WORDS}
    if not isinstance(kept["objective"], str):
        kept["objective"] = tuple(kept["objective"])
    if "search" in metadata:
        own = {k.removeprefix(_SEARCH): v for k, v in arrays.items() if k.startswith(_SEARCH)}
        kept["search"] = restored(own, metadata["search"])
    found = Tuning(
        numbers=tuple(
            Tuned(name, float(low), float(high), log, float(given), float(value))
            for (name, log), (low, high, given, value) in zip(
                metadata["numbers"], arrays["numbers"], strict=True
            )
        ),
        training=scores["training"],
        held_out=scores["held_out"],
        **kept,
    )
    return _with_front(found, fronts["training"], fronts.get("held_out", [])) if fronts else found


def _totals(arrays: Mapping[str, Array], key: str) -> dict[str, Array]:
    return {name: arrays[f"{key}/{name}"] for name in TOTALS if f"{key}/{name}" in arrays}


def _with_front(
    found: Tuning,
    training: Sequence[Score],
    held_out: Sequence[Score],
    built: Callable[[list[float]], Estimator | None] = lambda _: None,
) -> Tuning:
    """A result with its front: settings are its own, in this order."""
    front = []
    for k, values in enumerate(found.settings.T.tolist()):
        numbers_ = tuple(
            attrs.evolve(n, value=v) for n, v in zip(found.numbers, values, strict=True)
        )
        one = attrs.evolve(
            found,
            numbers=numbers_,
            estimator=built(values),
            training={**found.training, "tuned": training[k]},
            held_out={**found.held_out, "tuned": held_out[k]} if held_out else {},
        )
        front.append(one)
    return attrs.evolve(found, front=tuple(front))


def _cell(value: Interval) -> str:
    if not np.isfinite(value.low):
        return f"{value.value:.4g}"
    return f"{value.value:.4g} [{value.low:.4g}, {value.high:.4g}]"


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(line[i]) for line in table) for i in range(len(table[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    ]


# --------------------------------------------------------------------------------- the tuning
def tune(
    estimator: Estimator,
    problem: Scenario | Record,
    parameters: Mapping[str | tuple[str, ...], Any] | None = None,
    objective: str | tuple[str, ...] | None = None,
    optimiser: str | Optimiser[Any] | None = None,
    *,
    evaluations: int = 1000,
    restarts: int | Sequence[int] | None = None,
    runs: int | None = None,
    held_out: int | None = None,
    redraw: bool | None = None,
    prior: Gaussian | None = None,
    start: float | None = None,
    truth: Any = None,
    seed: int | None = None,
    workers: int = 1,
    patience: int | None = None,
    tolerance: float = 0.0,
    resume: Tuning | None = None,
) -> Tuning:
    """Search numbers of an estimator's parts for which its runs score best.

    ``parameters`` names them: ``{"motion.density": (1e-4, 10.0, "log"), "sensor.sigma": (0.5, 5.0)}``,
    bounds and, where wanted, the scale on which to search; "motion", "sensor" ("sensor0", "sensor1" of
    several), "filter" and "adapter" with the names that these parts have for their numbers
    (`tracker.trials.numbers` lists them). Several names as a tuple are tied: they get one value.

    The objectives are ("rmse" if none is given):

    * "rmse": mean over runs of the position RMSE over a run; needs the truth;
    * "nees": how far the mean NEES is from n, ``|log(NEES / n)|``; needs the truth;
    * "innovation": the same of NIS and its degrees of freedom;
    * "likelihood": the measurements' log-likelihood a row, as large as possible;
    * "dom": the thesis's degree of mismatch, ``1000 sum_i sqrt(mean_k (S - C)(i,i)^2)``, C being that of a
      window of 25 steps; one sensor.

    Several of them as a tuple are sought at once, by "nsga2" or another optimiser of several: what comes
    of it has a `front`.

    A `Scenario` is simulated once: ``runs`` runs (20), the same for every candidate, or, with ``redraw``, others
    in every generation (then lucky draws count until the end, where the best candidates of all
    restarts are compared on the same runs). The result is told on ``held_out`` other runs (100). All
    these runs are of streams that no campaign of that seed uses. Of a `Record`, each lane a run,
    the last ``held_out`` rows (a quarter) are kept from the search; it needs ``prior``, which holds at
    ``start``, and for errors ``truth``.

    An optimiser given by name ("particle_swarm" for one objective) is told how many generations there
    will be, and how many objectives. The estimator's own numbers
    are in the first population if they lie within the bounds. A candidate that loses a run, or
    that a part refuses, has the worst cost. ``patience`` and ``tolerance`` as in `tracker.optimise`.

    ``resume`` is a result to go on from: ``evaluations`` counts what it has used; give the estimator and
    the problem that it was given (prior, start and truth, too), all else is its own. What comes of it
    equals one search with the larger budget by its optimiser, whose schedule ends where it did.

    Shapes:
        truth ``(T, n, *batch)`` beside a record ``(T, m, *batch)``.

    Raises:
        DomainError: for names, bounds or sizes that make no sense, or if no candidate keeps all runs.
        CapabilityError: if the objective needs what is not there; for an optimiser of more or fewer
            objectives.

    Reference:
        paper 4, section 3 (the optimiser's cost is a whole filter run) and eq. 3-19.
    Laws:
        the same seed gives the same answer for any ``workers``, on arrays as compiled up to rounding; a
        search that was resumed equals one that was not.

    Example:
    >>> import tracker as tk
    >>> scene = tk.scenario("line", axes=1)
    >>> kf = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor.with_parameters(sigma=9.0))
    >>> found = tk.tune(kf, scene, {"sensor.sigma": (0.1, 100.0, "log")}, "likelihood",
    ...                 evaluations=300, seed=1)
    >>> bool(abs(found.values["sensor.sigma"] / scene.sensor.parameters["sigma"] - 1) < 0.1)
    True
    """
    drawn = 0
    if resume is not None:
        given = {
            "parameters": parameters, "objective": objective, "optimiser": optimiser, "seed": seed,
            "restarts": restarts, "runs": runs, "held_out": held_out, "redraw": redraw,
        }  # fmt: skip
        for name in [name for name, value in given.items() if value is not None]:
            raise DomainError(
                wording(f"argument {name!r}", got="a value beside resume", do="leave it out",
                        expected="what is resumed to bring its own")
            )  # fmt: skip
        parameters, objective, redraw = _bounds(resume), resume.objective, resume.redraw
        runs, held_out, seed = resume.training["tuned"].runs, _told(resume), resume.seed
        restarts = resume.best.shape[-1]
        optimiser, drawn = _begun(resume)
    objective = "rmse" if objective is None else objective
    restarts = 1 if restarts is None else restarts
    runs, seed = 20 if runs is None else runs, 0 if seed is None else seed
    aims = (objective,) if isinstance(objective, str) else tuple(objective)
    _check(aims, runs, held_out)
    named = [_named(estimator, names, bounds) for names, bounds in (parameters or {}).items()]
    if not named:
        raise DomainError(
            wording("argument 'parameters'", got="nothing to tune", do="name at least one",
                    expected=f"numbers among {', '.join(numbers(estimator))}")
        )  # fmt: skip
    places = [each for _, each in named]
    bounds = [number for number, _ in named]
    chosen = _optimiser(optimiser, evaluations, aims)
    needs = sorted({name for aim in aims for name in OBJECTIVES[aim].needs})
    of: _Simulated | _Recorded
    if isinstance(problem, Scenario):
        comparable("estimator", estimator, problem)
        of = _Simulated(estimator, places, problem, runs, held_out, seed, workers)
    else:
        if redraw:
            raise DomainError(
                wording("argument 'redraw'", got="True beside a record", expected="a scenario to draw from",
                        do="leave it out")
            )  # fmt: skip
        of = _Recorded(estimator, places, problem, prior, start, truth, held_out, seed, workers)
    if resume is not None:
        _check_resumed(resume, of.name, of.steps, bounds)
    count = restarts if isinstance(restarts, int) else len(restarts)
    together, n = chosen.population * count, estimator.motion.space.size
    if not estimator.motion.space.position and "squared_error" in needs:
        raise CapabilityError(
            wording("objective 'rmse'", got=f"states without a position ({estimator.motion.space})",
                    expected="components x, y or z", do="tune for 'nees' or 'likelihood'")
        )  # fmt: skip
    trials = of.trials(needs, together)

    def cost(x: Array) -> Any:
        nonlocal trials, drawn
        if redraw and drawn:
            trials = of.trials(needs, together, DRAWN_AGAIN + drawn)
        drawn += 1
        totals = trials(_settings(bounds, x.reshape(len(x), -1)))
        found = np.stack([_costs(aim, totals, of.steps, n) for aim in aims])
        return found.reshape(len(aims), *x.shape[1:])

    inside = all(number.low <= number.given <= number.high for number in bounds)
    known = np.array([[number.given] for number in bounds])
    options: dict[str, Any] = {
        "evaluations": evaluations,
        "patience": patience,
        "tolerance": tolerance,
    }
    if resume is not None:
        searched = optimise(cost, resume=resume.search, **options)
    else:
        searched = optimise(
            cost,
            [[_there(number, number.low), _there(number, number.high)] for number in bounds],
            chosen,
            restarts=restarts,
            seed=seed,
            start=_coordinates(bounds, known) if inside else None,
            **options,
        )
    several = len(aims) > 1
    if several:
        kept, _ = searched.survivors()
        best = np.unique(_settings(bounds, kept.reshape(len(kept), -1)), axis=1)
    else:
        best = _settings(bounds, searched.x[:, 0])
    if not np.isfinite(searched.cost).any():
        raise _hopeless(estimator, places, bounds, searched)
    candidates = np.concatenate([known, best], axis=1)
    training = of.score(candidates)
    costs = np.array([[score.cost(aim) for score in training] for aim in aims])
    if several:
        order = _front(costs[:, 1:]) + 1
        if not order.size:
            raise _hopeless(estimator, places, bounds, searched)
        at = int(order[_compromise(costs[:, order])])
    else:
        order = np.arange(1, len(training))
        at = _lowest(costs[0], inside)
    told = [0, *order] if several else [0, at]
    others = of.score_held_out(candidates[:, told])

    def built(values: list[float]) -> Estimator:
        return retuned(estimator, places, values)

    values = candidates[:, at].tolist()
    found = Tuning(
        problem=of.name,
        objective=aims if several else aims[0],
        optimiser=type(chosen).__name__,
        seed=seed,
        numbers=tuple(attrs.evolve(n_, value=v) for n_, v in zip(bounds, values, strict=True)),
        training={"given": training[0], "tuned": training[at]},
        held_out={"given": others[0], "tuned": others[told.index(at, 1)]} if others else {},
        evaluated=searched.evaluated,
        best=searched.best if several else searched.best[:, 0],
        mean=searched.mean if several else searched.mean[:, 0],
        settings=candidates[:, order],
        costs=costs[:, order] if several else costs[0, order],
        rows=isinstance(problem, Record),
        redraw=bool(redraw),
        estimator=built(values),
        search=searched,
    )
    return _with_front(found, [training[k] for k in order], others[1:], built) if several else found


# ------------------------------------------------------------------------------ what is resumed
def _begun(resume: Tuning) -> tuple[Any, int]:
    """The optimiser of a result, and how many generations it has begun and ended."""
    search = resume.search
    if search is None:
        raise CapabilityError(
            wording("what is to be resumed", got="a result without its search", do="resume what tune returned",
                    expected="one whose optimiser is registered, so that a file can name it")
        )  # fmt: skip
    return search.optimiser, len(search.evaluated) - bool(search.pending.shape[1])


def _bounds(resume: Tuning) -> dict[str | tuple[str, ...], Any]:
    """As they were given."""
    return {
        tuple(n.name.split(" = ")): (n.low, n.high, "log" if n.log else "linear")
        for n in resume.numbers
    }


def _told(resume: Tuning) -> int:
    """How much was held out."""
    if not resume.held_out:
        return 0
    score = resume.held_out["tuned"]
    return score.steps if resume.rows else score.runs


def _check_resumed(resume: Tuning, problem: str, steps: int, bounds: Sequence[Tuned]) -> None:
    """That estimator and problem are those it was made with, as far as can be seen."""
    was = resume.problem, resume.training["given"].steps
    if (problem, steps) != was:
        raise DomainError(
            wording("the problem", got=f"{problem!r}, {steps} steps", expected=f"{was[0]!r}, {was[1]} steps",
                    do="give the one that the result to be resumed was tuned on")
        )  # fmt: skip
    for new, old in zip(bounds, resume.numbers, strict=True):
        if new.given != old.given:
            raise DomainError(
                wording(f"number {old.name!r} of the estimator", got=new.given, expected=str(old.given),
                        do="give the estimator that the search began with, not the tuned one")
            )  # fmt: skip


# ------------------------------------------------------------------------------------ the best
def _lowest(costs: Array, inside: bool) -> int:
    """The place of the lowest cost; the first is that of the given numbers, which count if in bounds."""
    considered = np.fmin(costs, np.inf)
    considered[0] = considered[0] if inside else np.inf
    at = int(np.argmin(considered))
    if at == 0 and considered[0] in considered[1:]:  # the given numbers, and found again
        at = 1 + int(np.argmin(considered[1:]))
    return at


def _front(costs: Array) -> Any:
    """Places of costs ``(rows, k)`` that are finite and dominated by none, by the first row."""
    costs = np.where(np.isfinite(costs).all(axis=0), costs, np.inf)
    worse = np.any(
        (costs[:, :, None] <= costs[:, None]).all(axis=0)
        & (costs[:, :, None] < costs[:, None]).any(axis=0),
        axis=0,
    )
    places = np.flatnonzero(~worse & np.isfinite(costs[0]))
    return places[costs[0, places].argsort(kind="stable")]


def _compromise(costs: Array) -> int:
    """The place nearest to the lowest of all costs ``(rows, k)``, each relative to its range."""
    above = costs - costs.min(axis=1, keepdims=True)
    width = above.max(axis=1, keepdims=True)
    return int(((above / np.where(width > 0.0, width, 1.0)) ** 2).sum(axis=0).argmin())


def _check(aims: Sequence[str], runs: int, held_out: int | None) -> None:
    unknown = [aim for aim in aims if aim not in OBJECTIVES]
    if unknown or not aims or len(set(aims)) != len(aims):
        objective = unknown[0] if unknown else tuple(aims)
        raise DomainError(
            wording("argument 'objective'", got=repr(objective), do="take one of these",
                    expected=f"one of {', '.join(map(repr, OBJECTIVES))}, or several")
        )  # fmt: skip
    if runs < 1 or (held_out is not None and held_out < 0):
        raise DomainError(
            wording("arguments 'runs' and 'held_out'", got=f"{runs} and {held_out}",
                    expected="at least one run; 0 or more held out", do="pass runs=20, held_out=100")
        )  # fmt: skip


def _optimiser(
    optimiser: str | Optimiser[Any] | None, evaluations: int, aims: Sequence[str]
) -> Any:
    chosen: Any = optimiser
    if optimiser is None:
        chosen = "particle_swarm" if len(aims) == 1 else "nsga2"
    if isinstance(chosen, str):
        chosen = optimisers.make(chosen)
        if hasattr(chosen, "generations"):  # schedules shall end with the budget
            whole = max(1, evaluations // chosen.population)
            chosen = attrs.evolve(chosen, generations=whole)
        if hasattr(chosen, "objectives") and len(aims) > 1:
            chosen = attrs.evolve(chosen, objectives=len(aims))
    if chosen.rows != len(aims) or (len(aims) > 1 and not hasattr(chosen, "survivors")):
        good = "'particle_swarm' or 'cma_es'" if len(aims) == 1 else "'nsga2'"
        raise CapabilityError(
            wording(f"optimiser {type(chosen).__name__}", got=f"one of {_many(chosen.rows)}",
                    expected=f"one of {_many(len(aims))}", do=f"use {good}")
        )  # fmt: skip
    return chosen


def _many(rows: int) -> str:
    return "a single cost" if rows == 1 else f"{rows} costs"


def _named(
    estimator: Estimator, names: str | tuple[str, ...], bounds: Any
) -> tuple[Tuned, list[Place]]:
    """What is to be tuned, as yet as given, and where it is."""
    group = (names,) if isinstance(names, str) else tuple(names)
    places = [place(estimator, name) for name in group]
    known = numbers(estimator)
    given = {float(known[n if n in known else n.replace("sensor0.", "sensor.")]) for n in group}
    label = " = ".join(group)
    if len(given) != 1:
        raise DomainError(
            wording(f"tied numbers {label}", got=f"{sorted(given)}", expected="equal ones, to begin with",
                    do="give the estimator one value for all of them")
        )  # fmt: skip
    try:
        low, high, *rest = bounds
        low, high = float(low), float(high)
        good = math.isfinite(low) and math.isfinite(high) and low < high
        good = good and rest in ([], ["linear"], ["log"]) and (low > 0.0 or rest != ["log"])
    except (TypeError, ValueError):
        good = False
    if not good:
        raise DomainError(
            wording(f"bounds of {label}", got=repr(bounds), do="write for example (1e-3, 10.0, 'log')",
                    expected="(low, high) or (low, high, 'log'), finite, low < high, positive for 'log'")
        )  # fmt: skip
    value = given.pop()
    return Tuned(label, low, high, rest == ["log"], value, value), places


def _there(number: Tuned, value: float) -> float:
    return math.log(value) if number.log else value


def _coordinates(bounds: Sequence[Tuned], values: Array) -> Array:
    """Where the optimiser has these settings ``(d, k)``."""
    rows = [np.log(row) if n.log else row for n, row in zip(bounds, values, strict=True)]
    return np.array([_within(n, row) for n, row in zip(bounds, rows, strict=True)])


def _within(number: Tuned, row: Any) -> Any:
    return np.clip(row, _there(number, number.low), _there(number, number.high))


def _settings(bounds: Sequence[Tuned], x: Array) -> Array:
    """Settings ``(d, k)`` of the optimiser's candidates; never beyond their bounds."""
    rows = [np.exp(row) if n.log else row for n, row in zip(bounds, x, strict=True)]
    return np.array([np.clip(row, n.low, n.high) for n, row in zip(bounds, rows, strict=True)])


def _hopeless(
    estimator: Estimator,
    places: Sequence[Sequence[Place]],
    bounds: Sequence[Tuned],
    searched: Optimisation,
) -> TrackerError:
    """Why not one candidate had a finite cost."""
    reason = "every one lost a run, or was refused"
    try:
        retuned(estimator, places, [np.array([number.low]) for number in bounds])
    except TrackerError as error:
        reason = str(error)
    return DomainError(
        wording("the candidates", got=f"no finite cost in {int(searched.evaluations.sum())} evaluations",
                expected="settings that filter all runs", do=f"move the bounds ({reason})")
    )  # fmt: skip


# ----------------------------------------------------------------------------- what runs it is
@attrs.frozen(eq=False)
class _Simulated:
    """Runs of a scenario."""

    estimator: Estimator
    places: Sequence[Sequence[Place]]
    scenario: Scenario
    runs: int
    held_out: int | None
    seed: int
    workers: int

    @property
    def name(self) -> str:
        return self.scenario.name

    @property
    def steps(self) -> int:
        return len(self.scenario.t)

    def trials(
        self,
        wanted: Sequence[str],
        together: int,
        condition: int = TRAINING,
        runs: int | None = None,
    ) -> Trials:
        made = self.scenario.simulate(self.seed, runs or self.runs, condition=condition)
        return Trials(
            self.estimator,
            self.places,
            made.record,
            made.prior,
            made.start,
            made.truth,
            wanted,
            together=together,
            workers=self.workers,
            draws=lambda run: stream(self.seed, run, "filter", condition),
        )

    def score(self, settings: Array) -> list[Score]:
        return self._scored(self.trials(_all(self.estimator), settings.shape[1]), settings)

    def score_held_out(self, settings: Array) -> list[Score]:
        runs = 100 if self.held_out is None else self.held_out
        if not runs:
            return []
        wanted = _all(self.estimator)
        return self._scored(self.trials(wanted, settings.shape[1], HELD_OUT, runs), settings)

    def _scored(self, trials: Trials, settings: Array) -> list[Score]:
        return _scores(trials(settings), self.steps, self.estimator.motion.space.size)


@attrs.frozen(eq=False)
class _Recorded:
    """Lanes of a record, of which the last rows are held out."""

    estimator: Estimator
    places: Sequence[Sequence[Place]]
    record: Record
    prior: Gaussian | None
    start: float | None
    truth: Any
    asked: int | None
    seed: int
    workers: int
    name: str = "record"

    def __attrs_post_init__(self) -> None:
        lacks = "no prior" if self.prior is None else ""
        if not isinstance(self.record, Record):  # whoever calls may have no types
            lacks = repr(self.record)[:60]
        if lacks:
            raise CapabilityError(
                wording("what to tune on", got=lacks, expected="a Scenario, or a Record with prior=...",
                        do="pass tk.scenario(name), or prior=tk.Gaussian(mean, cov)")
            )  # fmt: skip
        if self.steps < 1:
            raise DomainError(
                wording("argument 'held_out'", got=f"{self.asked} of {len(self.record)} rows",
                        expected="fewer rows than there are", do="hold out a quarter, or 0")
            )  # fmt: skip

    @property
    def held_out(self) -> int:
        return len(self.record) // 4 if self.asked is None else self.asked

    @property
    def steps(self) -> int:
        return len(self.record) - self.held_out

    def trials(
        self,
        wanted: Sequence[str],
        together: int,
        _condition: int = TRAINING,
        rows: int | None = None,
    ) -> Trials:
        assert self.prior is not None  # noqa: S101 - checked when made
        rows = self.steps if rows is None else rows
        return Trials(
            self.estimator,
            self.places,
            _first_rows(self.record, rows),
            self.prior,
            self.start,
            None if self.truth is None else np.asarray(self.truth, dtype=np.float64)[:rows],
            wanted,
            together=together,
            workers=self.workers,
            draws=lambda run: stream(self.seed, run, "filter", TRAINING),
        )

    def score(self, settings: Array) -> list[Score]:
        made = self.trials(self._all(), settings.shape[1])
        return _scores(made(settings), self.steps, self.estimator.motion.space.size)

    def score_held_out(self, settings: Array) -> list[Score]:
        """Sums over all rows less those over the rows of the training: the filter goes on from there."""
        if not self.held_out:
            return []
        wanted, count = self._all(), settings.shape[1]
        whole = self.trials(wanted, count, rows=len(self.record))(settings)
        part = self.trials(wanted, count)(settings)
        rest = {name: whole[name] - part[name] for name in whole}
        return _scores(rest, self.held_out, self.estimator.motion.space.size)

    def _all(self) -> list[str]:
        known = _all(self.estimator)
        return [name for name in known if self.truth is not None or name not in ERRORS]


def _all(estimator: Estimator) -> list[str]:
    """What can be summed for this estimator."""
    return [name for name in TOTALS if name != "mismatch" or len(estimator.sensors) == 1]


def _scores(totals: Mapping[str, Array], steps: int, n: int) -> list[Score]:
    count = next(iter(totals.values())).shape[1]
    return [Score({k: v[:, i] for k, v in totals.items()}, steps, n) for i in range(count)]


def _first_rows(record: Record, rows: int) -> Record:
    made = object.__new__(Record)
    for field in attrs.fields(Record):
        value = getattr(record, field.name)
        object.__setattr__(made, field.name, None if value is None else value[:rows])
    return made
