"""The picture and the page of a Monte Carlo campaign; scores are computed elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.report import page as html
from tracker.report.drawing import INK, PALETTE, drawing, plain_numbers, svg

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tracker.metrics.consistency import Interval
    from tracker.montecarlo import Campaign, Scores

_STYLES = {"filter": "-", "smoother": "--"}

BEYOND, LOST = 5.0, 1e3
"""A ratio beyond the first is told in words; beyond the second it is no number to read: the estimator was lost."""


def figure(campaign: Campaign) -> Figure:
    """Error and consistency against time, and error run by run, for every estimator.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    with drawing():
        return _draw(campaign)


def ratios_figure(
    campaign: Campaign,
    to: str,
    score: str,
    stage: str,
    axes: Any,
    limits: tuple[float, float] | None,
    colours: Mapping[str, str],
) -> Figure:
    """Each estimator's median score over that of one of them, with its interval.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    found = campaign.ratios(to, score, stage)
    with drawing():
        if axes is None:
            from matplotlib.figure import Figure

            axes = Figure(figsize=(7.0, 1.1 + 0.32 * len(found))).subplots()
        _draw_ratios(axes, {k: v for k, v in found.items() if k != to}, limits, colours)
        axes.set_xlabel(f"median {SCORE_WORDS.get(score, score)} over that of “{to}”")
    return axes.figure  # type: ignore[no-any-return]


SCORE_WORDS = {"rmse": "RMSE", "final_error": "final error", "nees": "NEES", "nis": "NIS"}


def _ratio_ticks(low: float, high: float) -> list[float]:
    """Round ratios on a logarithmic axis: 1, and as many more as leave room for their labels."""
    between = [v for v in _ROUND if low <= v <= high]
    room = (high / low) ** 0.12
    kept = [1.0]
    for value in sorted(between, key=lambda v: abs(np.log(v))):
        if all(max(value / other, other / value) >= room for other in kept):
            kept.append(value)
    return sorted(kept)


_PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
"""Behind numbers, which may lie on the line at 1."""

_ROUND = (0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 1.05, 1.1, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0)


def _draw_ratios(
    axes: Axes,
    found: Mapping[str, Interval],
    limits: tuple[float, float] | None,
    colours: Mapping[str, str],
) -> None:
    drawn = [v for v in found.values() if v.value <= BEYOND]
    low = min([1.0, *(v.low for v in drawn)])
    high = max([1.0, *(v.high for v in drawn)])
    margin = (high / low) ** 0.06 if high > low else 1.1
    left, right = limits or (low / margin, high * margin**2.5)
    for place, (name, one) in enumerate(found.items()):
        colour = colours.get(name, PALETTE[0])
        if one.value <= (right if limits else BEYOND):
            away = ((one.value - one.low,), (one.high - one.value,))
            axes.errorbar(
                one.value, place, xerr=away, fmt="o", color=colour, capsize=3, markersize=5
            )
            axes.annotate(
                f"{one.value:.2f}", (one.high, place), (6, 0), textcoords="offset points",
                va="center", color=INK, fontsize=10, bbox=_PAPER,
            )  # fmt: skip
        else:
            lost = "lost" if not one.value < LOST else f"{one.value:.0f} \N{RIGHTWARDS ARROW}"
            axes.annotate(
                lost, (right, place), (-4, 0), textcoords="offset points", va="center", ha="right",
                color=colour, fontsize=10,
            )  # fmt: skip
    axes.axvline(1.0, color=INK, linewidth=1.0, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(left, right)
    axes.set_yticks(range(len(found)), list(found))
    axes.set_ylim(len(found) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    ticks = _ratio_ticks(left, right)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()


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
        plain_numbers(axis)
    return picture


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
