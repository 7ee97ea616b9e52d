"""Paper 0 from start to end: campaigns, verdicts, claims, studies and pictures put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from types import MappingProxyType

import attrs
import numpy as np

import tracker as tk
from tracker.metrics.errors import error, squared_position_error
from tracker.metrics.resampling import bootstrap_interval, spread_of_mean
from tracker.reproduction import (
    Paper,
    Published,
    Reading,
    Reproduction,
    ResultRow,
    Table,
    paper_from_toml,
    row,
)
from tracker.types import Array
from tracker_papers.gulf_to_oman import STATIONS, gulf_to_oman
from tracker_papers.paper0 import claims, figures
from tracker_papers.paper0.methods import (
    BELONGS,
    METHODS,
    TITLES,
    VARIANTS,
    WRONG_HESSIAN,
    estimators,
    operations,
    with_printed_hessian,
)
from tracker_papers.paper0.studies import ANGLES, collinear_study, network_study, single_fix

READINGS = MappingProxyType({
    "A": {"preset": "A"},
    "B": {"preset": "B"},
    "C": {"preset": "A", "speed": 0.3},
})  # fmt: skip
"""What the paper leaves open, read in three ways: presets A and B of the scenario, and A with the third
printed number of the initial state, 0.3, as the speed."""

MAIN, FOLLOWED, PARTS = "A", 1000, 9
"""The reading that rows are of; runs whose every step is kept; parts that progress is counted in."""

STAGES = ("filter", "smoother")


@attrs.frozen(eq=False)
class Followed:
    """Some runs with every step: what the figures and the claims about time are made of.

    Shapes:
        z ``(T, 2, runs)``; position ``name -> stage -> (T, 2, runs)``; errors ``name -> stage ->
        (T, runs)``.
    """

    scene: tk.Scenario
    z: Array
    position: Mapping[str, Mapping[str, Array]]
    errors: Mapping[str, Mapping[str, Array]]


@attrs.frozen
class PaperZero:
    """The reproduction of paper 0; see `tracker.reproduction.Study`."""

    runs: int = 1000
    quick_runs: int = 200

    @property
    def paper(self) -> Paper:
        """What was published."""
        file = files("tracker_papers.paper0") / "paper.toml"
        return paper_from_toml(file.read_text(encoding="utf-8"), "paper0/paper.toml")

    def run(
        self, *, runs: int, seed: int, quick: bool, progress: Callable[[int, int | None], None]
    ) -> Reproduction:
        """Table 1, figures 1 to 11, the six claims, and the two studies that the paper suggests."""
        done = iter(range(1, PARTS + 1))

        def tell() -> None:
            progress(next(done), PARTS)

        paper, rng = self.paper, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        campaigns = {}
        for name, options in READINGS.items():
            campaigns[name] = _campaign(gulf_to_oman(**options), runs, seed)  # type: ignore[arg-type]  # of several kinds
            tell()
        scene = gulf_to_oman(MAIN)
        wrong = tk.monte_carlo(with_printed_hessian(scene), scene, runs=runs, seed=seed)
        tell()
        few = min(runs, FOLLOWED // 10 if quick else FOLLOWED)
        followed = {}
        for name in ("A", "B"):
            followed[name] = follow(gulf_to_oman(name), few, seed)
            tell()
        collinear = collinear_study(runs, seed, tell)
        network = network_study(runs, seed, tell)
        cost = {name: operations(one) for name, one in estimators(scene).items()}
        rmse = {
            preset: {
                name: {
                    stage: campaigns[preset].scores[name][stage].per_run["rmse"] for stage in STAGES
                }
                for name in METHODS
            }
            for preset in ("A", "B")
        }
        errors = {preset: one.errors for preset, one in followed.items()}
        parts = {
            preset: claims.phases(one.scene.t, np.asarray(one.scene.path), STATIONS)
            for preset, one in followed.items()
        }
        found = (
            claims.equally_good(paper, rmse, rng),
            claims.three_times(paper, rmse, rng),
            claims.start_floor_and_manoeuvre(paper, errors, parts, rng),
            claims.peaks_removed(paper, errors, rng),
            claims.collinear_is_worse(paper, collinear, _crossings(followed["A"]), rng),
            claims.recommended(paper, rmse, {name: cost[name] for name in METHODS}, rng),
        )
        spreads = _spreads(campaigns, paper, rng)
        rows = tuple(_row(one, campaigns[MAIN], spreads[one.id], rng) for one in paper.published)
        together, best = _together(paper, spreads)
        tell()
        return Reproduction(
            paper=paper.number,
            title=paper.title,
            seed=seed,
            runs=runs,
            rows=rows,
            claims=found,
            errata=paper.errata,
            tables=(
                _table_1(campaigns, wrong, rng),
                together,
                _cost_table(cost, campaigns),
                _collinear_table(collinear),
                _network_table(network),
            ),
            pictures=figures.pictures(
                rows, spreads, followed["A"], parts["A"], campaigns[MAIN], wrong,
                collinear, network, cost,
            ),
            notes=NOTES,
            together=best,
        )  # fmt: skip


NOTES = (
    (
        "The paper leaves open the path (shown as a picture only), the time step, the duration, the speed and "
        "what the estimators are told of the start. Reading A: a step of 0.1, unit speed, the prior mean drawn "
        "around the true start with the paper's covariance; it has the magnitudes of Table 1. Reading B: a step "
        "of 0.01, every run started at rest at the true position. Reading C: A with the third printed number "
        "of the initial state, 0.3, as the speed. Lengths are the paper's scaled units."
    ),
    (
        "The RMSE over runs has a heavy tail under A and C: a few runs in a thousand start so badly that they are "
        "far off for a while, or for good, and carry the mean. So medians stand beside means, and a number "
        "published as a mean of 100 runs is compared with where a mean of 100 runs that did not diverge lies with "
        "95 % probability: a wide range, and therefore a mild test."
    ),
)


def _campaign(scene: tk.Scenario, runs: int, seed: int) -> tk.Campaign:
    return tk.monte_carlo(estimators(scene), scene, runs=runs, seed=seed)


def follow(scene: tk.Scenario, runs: int, seed: int) -> Followed:
    """Run the three methods and keep every step."""
    runs_ = scene.simulate(seed, runs)
    position: dict[str, dict[str, Array]] = {}
    errors: dict[str, dict[str, Array]] = {}
    space = scene.motion.space
    for name, one in estimators(scene, METHODS).items():
        history = tk.smooth(one, runs_.record, runs_.prior, start=runs_.start)
        position[name], errors[name] = {}, {}
        for stage, estimate in (("filter", history.filtered), ("smoother", history.smoothed)):
            mean = np.asarray(estimate.mean)  # type: ignore[union-attr]  # smoothed above
            off = error(runs_.truth, mean, space)
            position[name][stage] = mean[:, list(space.position)]
            errors[name][stage] = np.sqrt(squared_position_error(off, space))
    return Followed(scene, np.asarray(runs_.record.z), position, errors)


# ---------------------------------------------------------------------------------- table 1
def _spreads(
    campaigns: Mapping[str, tk.Campaign], paper: Paper, rng: np.random.Generator
) -> dict[str, list[Reading]]:
    """Where a mean over the paper's number of runs lies, under every reading of every number.

    Runs that diverged are left out: one of them would have made the published mean many times
    what it is, so none was in it.
    """
    out: dict[str, list[Reading]] = {}
    for number in paper.published:
        _, method, stage = number.id.split("/")
        out[number.id] = []
        for variant in VARIANTS:
            if BELONGS.get(variant, variant) != method:
                continue
            for name, campaign in campaigns.items():
                scores = campaign.scores[variant][stage]
                values = scores.per_run["rmse"][~scores.diverged]
                spread = spread_of_mean(values, number.runs or 1, rng=rng)
                label = name if variant == method else f"{name}, {variant}"
                out[number.id].append(Reading(label, spread.low, spread.high))
    return out


def _row(
    number: Published, campaign: tk.Campaign, readings: list[Reading], rng: np.random.Generator
) -> ResultRow:
    _, method, stage = number.id.split("/")
    scores = campaign.scores[method][stage]
    values, diverged = scores.per_run["rmse"], scores.diverged
    kept = np.mean(values[~diverged]) if (~diverged).any() else np.nan
    median, ninety = scores.percentile("rmse", 50, 90)
    note = (
        f"Ours is reading A: median {median:.4f}, 90th percentile {ninety:.4f}, {int(diverged.sum())} of "
        f"{campaign.runs} runs diverged, mean of the others {kept:.4f}."
    )
    ours = bootstrap_interval(_mean, values, rng=rng)
    return row(number, ours, campaign.runs, readings, note=note)


def _together(paper: Paper, spreads: Mapping[str, list[Reading]]) -> tuple[Table, str]:
    """Which reading, one and the same for all six numbers, gives which of them; and the best in words."""
    lines, counts = [], {}
    for name in READINGS:
        for ekf2 in ("ekf2", "ekf2 as printed"):
            for ukf in ("ukf", "ukf, points kept"):
                chosen = {name, f"{name}, {ekf2}", f"{name}, {ukf}"}
                held = []
                for number in paper.published:
                    method = number.id.split("/")[1]
                    own = [one for one in spreads[number.id] if one.name in chosen]
                    # the variant of this method, if one is chosen, else the method itself
                    held.append((own[-1] if method != "ekf1" else own[0]).gives(number))
                words = (
                    name,
                    "as printed" if ekf2 != "ekf2" else "corrected",
                    "kept" if ukf != "ukf" else "redrawn",
                )
                counts[words] = sum(held)
                lines.append((*words, *("yes" if one else "no" for one in held), str(sum(held))))
    first = max(counts, key=lambda words: counts[words])
    total = len(paper.published)
    said = (
        "One reading gives all of them"
        if counts[first] == total
        else "No reading gives all of them"
    )
    best = (
        f"A number counts as reproduced if any one reading gives it. {said}: {counts[first]} of {total} are "
        f"the most, by reading {first[0]} with S of eq. 10 {first[1]} and the points of the UKF {first[2]}."
    )
    head = (
        "reading",
        "S of EKF2",
        "points of UKF",
        *(one.id.partition("/")[2] for one in paper.published),
    )
    table = Table(
        "readings",
        "Which reading gives which number",
        (*head, "in all"),
        tuple(lines),
        "Whether the published mean of 100 runs lies where, under one and the same reading, a mean of 100 runs "
        "lies with 95 % probability.",
    )
    return table, best


def _mean(values: Array) -> Array:
    return np.asarray(values.mean(axis=-1))


def _table_1(
    campaigns: Mapping[str, tk.Campaign], wrong: tk.Campaign, rng: np.random.Generator
) -> Table:
    lines = []
    for name, campaign in campaigns.items():
        scored = dict(campaign.scores)
        if name == MAIN:
            scored[WRONG_HESSIAN] = wrong.scores[WRONG_HESSIAN]
        for variant, stages in scored.items():
            for stage, scores in stages.items():
                median, ninety = scores.percentile("rmse", 50, 90)
                mean = bootstrap_interval(_mean, scores.per_run["rmse"], rng=rng)
                lines.append(
                    (
                        name,
                        variant,
                        stage,
                        f"{mean.value:.4f}",
                        f"{mean.low:.4f} to {mean.high:.4f}",
                        f"{median:.4f}",
                        f"{ninety:.4f}",
                        str(int(scores.diverged.sum())),
                        f"{scores.mean_nees / scores.n:.3g}",
                    )
                )
    head = (
        "reading",
        "method",
        "stage",
        "mean",
        "95 % interval",
        "median",
        "90 %",
        "diverged",
        "NEES / n",
    )
    return Table(
        "table_1",
        "Table 1 under every reading, with printed and corrected equations",
        head,
        tuple(lines),
        "Position RMSE over a run: mean with its bootstrap interval, median and 90th percentile over the "
        "runs. Diverged: final error above 10 times the median, or not finite. NEES / n is 1 for a "
        "consistent estimator.",
    )  # fmt: skip


# ---------------------------------------------------------------------------- other tables
def _cost_table(cost: Mapping[str, int | None], campaigns: Mapping[str, tk.Campaign]) -> Table:
    base = cost["ekf1"] or np.nan
    return Table(
        "cost",
        "Cost against accuracy",
        ("method", "operations of a step", "to EKF1", "median, A, smoothed", "median, B, smoothed"),
        tuple(
            (
                name,
                "-" if count is None else str(count),
                "-" if count is None else f"{count / base:.2f}",
                *(
                    f"{campaigns[preset].scores[name]['smoother'].percentile('rmse', 50)[0]:.4f}"
                    for preset in ("A", "B")
                ),
            )
            for name, count in cost.items()
        ),
        "Arithmetic operations of prediction, update and one smoothing step, counted in the graph that is "
        "compiled; elementary functions count as what they are made of.",
    )


def _collinear_table(collinear: Mapping[str, Mapping[float, Array]]) -> Table:
    return Table(
        "collinear",
        "Collinear stations (claim 5)",
        ("angle between bearings [°]", "one fix, RMS", "EKF1, median RMSE", "EKF1 + RTS, median RMSE"),
        tuple(
            (
                f"{angle:g}",
                f"{fix:.3f}" if fix < 100.0 else "unbounded",
                *(f"{np.nanmedian(collinear[stage][angle]):.4f}" for stage in STAGES),
            )
            for angle, fix in zip(ANGLES, single_fix(np.array(ANGLES)).tolist(), strict=True)
        ),
        "The ship sails straight on the line of the first station; the second is turned about the middle of "
        "the course at a constant distance. One fix: what two bearings alone give, without prior or motion.",
    )  # fmt: skip


def _network_table(network: Mapping[int, Mapping[str, Mapping[str, Array]]]) -> Table:
    head = [f"{TITLES[name]}, {stage}" for name in METHODS for stage in STAGES]
    return Table(
        "network",
        "A network of stations",
        ("stations", *head),
        tuple(
            (
                str(count),
                *(f"{np.nanmedian(by[name][stage]):.4f}" for name in METHODS for stage in STAGES),
            )
            for count, by in network.items()
        ),
        "Median RMSE on the paper's path, preset A; stations are added in the order of the figure.",
    )


def _crossings(one: Followed) -> str:
    """What happens where the paper's own path crosses the line of its two stations."""
    path, t = np.asarray(one.scene.path), one.scene.t
    (ax, ay), (bx, by) = STATIONS
    side = np.sign((bx - ax) * (path[:, 1] - ay) - (by - ay) * (path[:, 0] - ax))
    at = np.nonzero(np.diff(side))[0]
    typical = np.median(one.errors["ekf1"]["filter"], axis=1)
    found = " and ".join(
        f"{np.max(typical[k : k + 3]) / np.median(typical):.2f} (from t = {t[k]:.1f})" for k in at
    )
    return (
        "On the paper's own path the ship crosses the line of the stations twice, between them; in the "
        f"three steps there the median error of EKF1 is up to {found} times that of the whole run."
    )
