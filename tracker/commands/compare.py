"""``tracker compare``: several filters on one scenario, their accuracy, consistency and cost side by side.

What is measured belongs to `tracker.montecarlo`; nothing is estimated here.
"""

from __future__ import annotations

import json
from typing import Any

import attrs
import click

from tracker import estimation, registry
from tracker.commands.output import finite, folder_of, versions, write
from tracker.commands.tables import print_table
from tracker.compile.run import reason
from tracker.errors import TrackerError
from tracker.montecarlo import SLIGHT, Campaign, monte_carlo
from tracker.simulation import Scenario, scenario

HEAD = (
    "filter",
    "RMSE [95 % interval]",
    "median",
    "NEES / n",
    "NIS / m",
    "diverged",
    "us / step and run",
    "runs on",
    "says of itself",
)


@attrs.frozen(eq=False)
class Compared:
    """What one estimator scored, and what it cost."""

    label: str
    campaign: Campaign
    compiled: bool

    def rows(self) -> list[dict[str, Any]]:
        """One row per stage: numbers only."""
        steps = len(self.campaign.t) * self.campaign.runs
        seconds = self.campaign.seconds[self.label]
        cost = {"cost_us": 1e6 * seconds / steps, "compiled": self.compiled}
        n = next(iter(self.campaign.scores[self.label].values())).n
        return [row | cost | {"n": n} for row in self.campaign.rows()]


@click.command()
@click.argument("filters", nargs=-1)
@click.option("--scenario", "problem", default="two_stations", show_default=True, metavar="NAME")
@click.option("--smoother", metavar="NAME", help="Smooth afterwards, and show that too.")
@click.option("--runs", default=1000, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0))
@click.option("--out", metavar="DIR", help="Also write DIR/results.json.")
def compare(
    filters: tuple[str, ...],
    problem: str,
    smoother: str | None,
    runs: int,
    seed: int,
    out: str | None,
) -> None:
    """Compare FILTERS on a scenario; without names, every filter that can run it.

    All see the same runs. Cost is CPU time of filtering and scoring, simulation left out, after a first
    run that is not counted (it compiles). Filters that draw many points or iterate are worth their cost
    only where the table shows it.
    """
    scene = scenario(problem)
    chosen = filters or registry.filters.names()
    done, left_out = [], []
    for name in chosen:
        try:
            done.append(_compared(name, scene, smoother, runs, seed))
        except TrackerError as error:
            if filters:
                raise
            left_out.append(f"{name}: {str(error).splitlines()[0]}")
    click.echo(f"{scene.name}: {runs} runs, {len(scene.t)} steps, seed {seed}")
    print_table(HEAD, [_cells(row, runs) for one in done for row in one.rows()])
    for line in left_out:
        click.echo(f"Left out: {line}")
    if out is not None:
        rows = [
            {k: finite(v) if isinstance(v, float) else v for k, v in row.items()}
            for one in done
            for row in one.rows()
        ]
        document = {
            "schema": 1,
            "scenario": scene.name,
            "runs": runs,
            "seed": seed,
            "versions": versions(),
            "rows": rows,
        }
        write(folder_of(out) / "results.json", json.dumps(document, indent=2) + "\n")


def _compared(name: str, scene: Scenario, smoother: str | None, runs: int, seed: int) -> Compared:
    estimator = estimation.estimator(
        name, motion=scene.motion, sensor=scene.sensor, smoother=smoother
    )
    monte_carlo({name: estimator}, scene, 1, seed)  # compiles
    campaign = monte_carlo({name: estimator}, scene, runs, seed)
    return Compared(
        name, campaign, not reason(estimator) or not estimation.why_not_whole(estimator)
    )


def _cells(row: dict[str, Any], runs: int) -> tuple[str, ...]:
    smooth = row["stage"] == "smoother"
    return (
        f"{row['estimator']} smoothed" if smooth else row["estimator"],
        f"{row['rmse']:.4g} [{row['rmse_low']:.4g}, {row['rmse_high']:.4g}]",
        f"{row['median']:.4g}",
        f"{row['nees'] / row['n']:.3g}",
        "-" if smooth else f"{row['nis']:.3g}",
        str(row["diverged"]),
        f"{row['cost_us']:.3g}",
        "compiled" if row["compiled"] else "arrays",
        _word(row, runs),
    )


def _word(row: dict[str, Any], runs: int) -> str:
    """As `tracker.montecarlo.Campaign.warnings`, in one word; of one that is lost, that."""
    if 2 * row["diverged"] > runs:
        return "lost"
    if not row["nees_share"] < 0.5:
        return "consistent"
    ratio = row["nees"] / row["n"]
    slightly = "slightly " if 1.0 / SLIGHT < ratio < SLIGHT else ""
    return f"{slightly}overconfident" if ratio > 1.0 else f"{slightly}underconfident"
