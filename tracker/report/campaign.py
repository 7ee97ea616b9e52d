"""The picture and the page of a Monte Carlo campaign; scores are computed elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tracker.report import page as html
from tracker.report.drawing import PALETTE, drawing, svg

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from tracker.montecarlo import Campaign, Scores

_STYLES = {"filter": "-", "smoother": "--"}


def figure(campaign: Campaign) -> Figure:
    """Error and consistency against time, and error run by run, for every estimator.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    with drawing():
        return _draw(campaign)


def write(campaign: Campaign, path: Path) -> Path:
    """A self-contained page at ``path``: the summary's table and words, the picture, the sources.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    picture = svg(lambda: _draw(campaign))
    rows = [
        (
            row["estimator"],
            row["stage"],
            f"{row['rmse']:.4g}",
            f"{row['rmse_low']:.4g} to {row['rmse_high']:.4g}",
            f"{row['median']:.4g}",
            f"{row['p10']:.4g} to {row['p90']:.4g}",
            f"{row['nees'] / campaign.scores[row['estimator']][row['stage']].n:.3g}",
            f"{row['nees_share']:.0%}",
            "\u2013" if np.isnan(row["nis"]) else f"{row['nis']:.4g}",
            f"{row['diverged']}",
        )
        for row in campaign.rows()
    ]
    head = (
        "estimator",
        "stage",
        "RMSE",
        "95 % interval",
        "median",
        "10 to 90 %",
        "NEES / n",
        "steps in band",
        "NIS / m",
        "diverged",
    )
    words = campaign.warnings() or ["Nothing speaks against the consistency of these estimates."]
    sections = [
        (
            "",
            [
                html.text(
                    f"{campaign.runs} runs of {len(campaign.t)} steps, seed {campaign.seed}. RMSE is that "
                    "of the position over a run, its mean over the runs, and the interval that holds "
                    "the true mean with 95 % probability."
                )
            ],
        ),
        ("What a person should conclude", [html.points(words)]),
        ("Scores", [html.table(head, rows)]),
        (
            "Against time",
            [
                html.figure(
                    picture,
                    "Top: position RMSE over the runs. Middle: mean NEES per state component, with "
                    "the band that holds 95 % of the steps of a consistent estimator. Bottom: the "
                    "share of runs with a smaller RMSE.",
                    "Curves of error, NEES and the distribution of RMSE over runs.",
                )
            ],
        ),
        (
            "Sources",
            [
                html.text(f"{k}: {line}")
                for k, v in campaign.sources.items()
                for line in v.split("\n")
            ],
        ),
    ]
    path = path / "report.html" if path.is_dir() else path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html.page(f"Monte Carlo: {campaign.scenario}", sections), encoding="utf-8")
    return path


def _draw(campaign: Campaign) -> Figure:
    from matplotlib.figure import Figure

    picture = Figure(figsize=(8.0, 9.0), layout="constrained")
    top, middle, bottom = picture.subplots(3, 1, height_ratios=(1.2, 1.2, 1.0))
    several = len(campaign.scores) > 1 or "estimator" not in campaign.scores
    band_drawn = False
    for place, (name, stages) in enumerate(campaign.scores.items()):
        for stage, scores in stages.items():
            label = f"{name}, {stage}" if several else stage
            look = {"color": PALETTE[place % len(PALETTE)], "linestyle": _STYLES[stage]}
            if not several:
                look["color"] = PALETTE[list(_STYLES).index(stage)]
            step = scores.per_step
            top.plot(campaign.t, np.sqrt(step["squared_error"]), label=label, **look)
            middle.plot(campaign.t, step["nees"] / scores.n, label=label, **look)
            values = np.sort(scores.per_run["rmse"][np.isfinite(scores.per_run["rmse"])])
            bottom.plot(values, np.arange(1, len(values) + 1) / max(len(values), 1), **look)
            if not band_drawn:
                _band(middle, campaign, scores)
                band_drawn = True
    top.set(yscale="log", ylabel="position RMSE [m]", xlabel="time [s]", title=campaign.scenario)
    middle.axhline(1.0, color=PALETTE[2], linewidth=1.0)
    middle.set(yscale="log", ylabel="NEES / n", xlabel="time [s]")
    bottom.set(
        xscale="log", ylabel="share of runs", xlabel="position RMSE of a run [m]", ylim=(0.0, 1.0)
    )
    handles, labels = middle.get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=3)
    for axis in (top.yaxis, middle.yaxis, bottom.xaxis):
        _plain_numbers(axis)
    return picture


def _plain_numbers(axis: Axis) -> None:
    """1, 2 and 5 times powers of ten, written out: narrow ranges keep more than one label."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _band(axes: object, campaign: Campaign, scores: Scores) -> None:
    bands = [scores.nees_band(k) for k in range(len(campaign.t))]
    axes.fill_between(  # type: ignore[attr-defined]
        campaign.t,
        [band.low / scores.n for band in bands],
        [band.high / scores.n for band in bands],
        color=PALETTE[2],
        alpha=0.25,
        linewidth=0,
        label="95 % band",
    )
