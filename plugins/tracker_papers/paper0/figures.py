"""The eleven figures of paper 0, and five that it suggests; each function draws numbers made elsewhere.

matplotlib is imported when a picture is drawn, in the style of `tracker.report.drawing`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

import tracker as tk
from tracker.report.drawing import INK, PALETTE, QUIET
from tracker.reproduction import Picture, Reading, ResultRow
from tracker.types import Array
from tracker_papers.gulf_to_oman import STATIONS, WAYPOINTS, along
from tracker_papers.paper0.claims import Phases
from tracker_papers.paper0.methods import METHODS, TITLES, VARIANTS, WRONG_HESSIAN
from tracker_papers.paper0.studies import MORE_STATIONS, single_fix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tracker_papers.paper0.study import Followed

COLOURS = dict(zip(METHODS, PALETTE, strict=False))
FILTER, SMOOTHER = PALETTE[0], PALETTE[1]
POSITION = "position error [scaled units]"
RMSE = "RMSE of a run [scaled units]"
RUINED = 5.0
"""A run is ruined by a misprint if its RMSE is so many times the median without it."""


def pictures(
    rows: Sequence[ResultRow],
    spreads: Mapping[str, Sequence[Reading]],
    followed: Followed,
    parts: Phases,
    campaign: tk.Campaign,
    wrong: tk.Campaign,
    collinear: Mapping[str, Mapping[float, Array]],
    network: Mapping[int, Mapping[str, Mapping[str, Array]]],
    cost: Mapping[str, int | None],
) -> tuple[Picture, ...]:
    """All pictures, in the order of the report."""
    one = typical(followed)
    shown = min(100, campaign.runs)
    out = [
        Picture(
            "figure_01", "How smoothing goes over a record",
            "The filter goes forwards and keeps at each step what it predicted and what it estimated; the "
            "smoother starts at the last estimate and goes back, one correction for each step (eq. 24).",
            "A row of filter steps joined by arrows to the right, a row of smoother steps by arrows to the left.",
            schematic, "1",
        ),
        Picture(
            "figure_02", "Geometry",
            "The true path, the two stations, and at one instant the two azimuths, counted from the x axis, and "
            "the velocity: the state is (x, y, vx, vy).",
            "Map with a path, two stations, two lines of bearing with angles, and a velocity arrow.",
            geometry, "2",
        ),
        Picture(
            "figure_03", "The two azimuths",
            f"Measured (points) and true (line), run {one}, noise of 2\N{DEGREE SIGN}. Station 2 sees the ship "
            "in the west, where the azimuth jumps by 360\N{DEGREE SIGN}: residuals must wrap.",
            "Two panels of azimuth against time, points about a line.",
            partial(bearings, followed, one), "3",
        ),
    ]  # fmt: skip
    for number, name in enumerate(METHODS, 4):
        out.append(
            Picture(
                f"figure_{number:02d}", f"Path, {TITLES[name]} and its smoother",
                f"Run {one}, the one whose EKF1 error is the median of {followed.z.shape[-1]} runs. Shaded "
                "parts of the true path are the manoeuvre.",
                "Map with the true path, the filtered and the smoothed path, and two stations.",
                partial(path, followed, parts, one, name), str(number),
            )
        )  # fmt: skip
    for number, name in enumerate(METHODS, 7):
        out.append(
            Picture(
                f"figure_{number:02d}", f"Error against time, {TITLES[name]} and its smoother",
                f"Thick: median over {followed.z.shape[-1]} runs, with the band of the middle 80 % of them; "
                f"thin: run {one}. Shaded: the manoeuvre, and where the "
                "bearings cross at less than 20\N{DEGREE SIGN}, each with 0.3 s of aftermath. (The printed captions of figures 7 to 9 repeat "
                "those of 4 to 6; the text says that they are errors, eq. 36.)",
                "Position error against time for filter and smoother, with bands.",
                partial(error, followed, parts, one, name), str(number),
            )
        )  # fmt: skip
    for number, stage in ((10, "filter"), (11, "smoother")):
        out.append(
            Picture(
                f"figure_{number}", f"RMSE run by run, three {stage}s",
                f"The first {shown} runs, as many as the paper's at most, on a logarithmic scale; broken lines "
                f"are the medians of all {campaign.runs}. The three see the same measurements.",
                "RMSE of each run for three methods, and the medians as broken lines.",
                partial(run_by_run, campaign, stage, shown), str(number),
            )
        )  # fmt: skip
    return (
        *out,
        Picture(
            "table_1", "Table 1: published and ours",
            "Vertical lines: the published means of 100 runs. Bars: where a mean of 100 runs lies with 95 % probability "
            "under each reading, with the equations corrected and, for EKF2, as printed.",
            "Six groups of horizontal bars, one per reading, with the published value as a vertical line.",
            partial(table_1, rows, spreads),
        ),
        Picture(
            "printed_equations", "EKF2 with printed and corrected equations",
            f"Share of runs with a smaller RMSE, reading A. {_ruined(campaign, wrong)}",
            "Distribution curves of the RMSE for four versions of the extended Kalman filter.",
            partial(printed, campaign, wrong),
        ),
        Picture(
            "collinear", "Collinear stations",
            "Median RMSE of EKF1 and its smoother against the angle at which the bearings cross, the distances "
            "being the same. At 0\N{DEGREE SIGN} and 180\N{DEGREE SIGN} ship and stations are collinear; a "
            "single fix would be unbounded there, prior and motion bound the filter.",
            "Error of EKF1 and its smoother against the crossing angle, 0 to 180 degrees.",
            partial(crossing, collinear),
        ),
        Picture(
            "network", "A network of stations",
            "Left: the stations in the order in which they are added. Right: median RMSE on the paper's path; "
            "dotted, the two-station value falling as one over the root of the number.",
            "Map of six stations, and error against the number of stations.",
            partial(stations, followed, network),
        ),
        Picture(
            "cost", "Cost against accuracy",
            "Operations of a step, forwards and backwards, and the RMSE of the smoother under reading A: median and "
            "middle 80 % of the runs. Down and to the left is better.",
            "Points for each method: operations against error.",
            partial(worth, campaign, cost),
        ),
    )  # fmt: skip


def typical(followed: Followed) -> int:
    """The run whose EKF1 RMSE is the median: what the single-run figures show."""
    rmse = np.sqrt(np.nanmean(followed.errors["ekf1"]["filter"] ** 2, axis=0))
    return int(np.argsort(rmse)[len(rmse) // 2])


def _figure(width: float = 8.0, height: float = 4.6) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _plain(axis: Any, *, narrow: bool = False) -> None:
    """1, 2 and 5 times powers of ten, written out; a narrow range has more of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 3.0, 5.0, 7.0) if narrow else (1.0, 2.0, 5.0))
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _smooth_path(speed: float = 1.0) -> tuple[Array, Array]:
    """Times and states of the true path in fine steps, whatever the step of the measurements."""
    return along(WAYPOINTS, speed=speed, dt=0.005)


def _mark_stations(axes: Axes, places: Sequence[Sequence[float]]) -> None:
    for number, (x, y) in enumerate(places, 1):
        axes.plot(x, y, "^", color=INK, markersize=9, label="station" if number == 1 else None)
        axes.annotate(f"{number}", (x, y), xytext=(0, -18), textcoords="offset points", ha="center")


# ------------------------------------------------------------------------------ the eleven
def schematic() -> Figure:
    """Figure 1."""
    picture = _figure(8.0, 3.4)
    axes = picture.subplots()
    axes.set(xlim=(-1.35, 8.6), ylim=(-0.75, 3.3))
    axes.axis("off")
    names = ["0", "1", "2", "\N{MIDLINE HORIZONTAL ELLIPSIS}", "T \N{MINUS SIGN} 1", "T"]
    for row, colour, words in ((2.4, FILTER, "filter"), (0.6, SMOOTHER, "smoother")):
        axes.text(-1.3, row, words, va="center", color=colour, weight="bold")
        for place, name in enumerate(names):
            x = 0.4 + 1.5 * place
            if place != 3:
                box = {"boxstyle": "round,pad=0.45", "facecolor": "white", "edgecolor": colour}
                mark = "" if row > 1 else "ˢ"
                axes.text(x, row, f"x{mark}({name})", ha="center", va="center", bbox=box)
            else:
                axes.text(x, row, name, ha="center", va="center", fontsize=16)
            if place < len(names) - 1:
                ends = ((x + 1.0, row), (x + 0.5, row))
                axes.annotate(
                    "", *(ends if row > 1 else ends[::-1]),
                    arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.6},
                )  # fmt: skip
            if place != 3:
                axes.annotate(
                    "", (x, 1.05), (x, 1.95),
                    arrowprops={"arrowstyle": "-|>", "color": QUIET, "linewidth": 1.2},
                )  # fmt: skip
                if row > 1:
                    axes.annotate(
                        "", (x, 2.8), (x, 3.2),
                        arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 1.2},
                    )  # fmt: skip
    axes.text(-1.3, 3.05, "measurements", va="center")
    axes.text(-1.3, 1.5, "moments kept", va="center", color=QUIET)
    axes.text(
        4.15, -0.45, "steps: forwards with the filter, backwards with the smoother", ha="center"
    )
    return picture


def geometry() -> Figure:
    """Figure 2."""
    from matplotlib.patches import Arc

    picture = _figure(8.0, 5.2)
    axes = picture.subplots()
    t, track = _smooth_path()
    axes.plot(track[:, 0], track[:, 1], color=QUIET, label="true path")
    axes.plot(*np.array(WAYPOINTS).T, ".", color=QUIET, label="points it is drawn through")
    x, y, vx, vy = track[np.argmin(np.abs(t - 2.1))]
    for number, (sx, sy) in enumerate(STATIONS, 1):
        angle = np.degrees(np.arctan2(y - sy, x - sx))
        axes.plot([sx, x], [sy, y], "--", color=PALETTE[number - 1], linewidth=1.2)
        axes.plot([sx, sx + 0.75], [sy, sy], color=QUIET, linewidth=0.9)
        axes.add_patch(Arc((sx, sy), 0.8, 0.8, theta1=0.0, theta2=angle, color=PALETTE[number - 1]))
        half = np.deg2rad(angle / 2.0)
        axes.text(
            sx + 0.54 * np.cos(half), sy + 0.54 * np.sin(half), f"θ{'₁₂'[number - 1]}",
            color=PALETTE[number - 1], ha="center", va="center", fontsize=13,
        )  # fmt: skip
    axes.annotate(
        "", (x + 0.5 * vx, y + 0.5 * vy), (x, y),
        arrowprops={"arrowstyle": "-|>", "color": PALETTE[2], "linewidth": 2.0},
    )  # fmt: skip
    axes.text(x + 0.5 * vx - 0.1, y + 0.5 * vy + 0.05, "(vx, vy)", color=PALETTE[2], ha="right")
    axes.plot(x, y, "o", color=INK, markersize=7)
    axes.annotate("ship (x, y)", (x, y), xytext=(6, -36), textcoords="offset points")
    _mark_stations(axes, STATIONS)
    axes.set(xlabel="x [scaled units]", ylabel="y [scaled units]", aspect="equal", xlim=(0.2, 5.1))
    axes.set(ylim=(-0.8, 2.1))
    axes.legend(loc="lower left")
    return picture


def bearings(followed: Followed, run: int) -> Figure:
    """Figure 3."""
    picture = _figure(8.0, 5.4)
    t, track = _smooth_path()
    for number, axes in enumerate(picture.subplots(2, 1, sharex=True), 1):
        sx, sy = STATIONS[number - 1]
        true = np.arctan2(track[:, 1] - sy, track[:, 0] - sx)
        jump = np.concatenate((np.abs(np.diff(true)) > np.pi, [False]))
        axes.plot(
            t, np.where(jump, np.nan, np.degrees(true)), color=INK, linewidth=1.2, label="true"
        )
        measured = np.degrees(followed.z[:, number - 1, run])
        axes.plot(
            followed.scene.t,
            measured,
            ".",
            color=PALETTE[number - 1],
            markersize=6,
            label="measured",
        )
        axes.set(title=f"station {number}", ylabel="azimuth [\N{DEGREE SIGN}]")
        if jump.any() or np.ptp(measured) > 300.0:
            axes.set(ylim=(-190.0, 190.0), yticks=(-180, -90, 0, 90, 180))
        axes.legend(loc="best")
    axes.set_xlabel("time")
    return picture


def path(followed: Followed, parts: Phases, run: int, name: str) -> Figure:
    """Figures 4 to 6."""
    picture = _figure(8.0, 5.2)
    axes = picture.subplots()
    t, track = _smooth_path()
    low, high = followed.scene.t[parts.manoeuvre][[0, -1]]
    turning = track[(t >= low) & (t <= high), :2]
    axes.plot(*turning.T, color=PALETTE[5], linewidth=9.0, alpha=0.4, label="manoeuvre")
    axes.plot(track[:, 0], track[:, 1], color=INK, linewidth=1.4, label="true path")
    for stage, colour, mark in (("filter", FILTER, "o-"), ("smoother", SMOOTHER, "s-")):
        words = TITLES[name] if stage == "filter" else f"{TITLES[name]} + RTS"
        axes.plot(
            *followed.position[name][stage][:, :, run].T, mark,
            color=colour, markersize=3.5, linewidth=1.0, label=words,
        )  # fmt: skip
    _mark_stations(axes, STATIONS)
    low, high = track[:, :2].min(axis=0) - 0.45, track[:, :2].max(axis=0) + 0.45
    axes.set(xlabel="x [scaled units]", ylabel="y [scaled units]", aspect="equal")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.legend(loc="lower left")
    return picture


def error(followed: Followed, parts: Phases, run: int, name: str) -> Figure:
    """Figures 7 to 9."""
    picture = _figure()
    axes = picture.subplots()
    t = followed.scene.t
    for when, colour, words in (
        (parts.manoeuvre, PALETTE[5], "manoeuvre"),
        (parts.lost, QUIET, "bearings hardly cross"),
    ):
        axes.fill_between(
            t, 0.0, 1.0, where=when.tolist(), transform=axes.get_xaxis_transform(),
            color=colour, alpha=0.18, linewidth=0, label=words,
        )  # fmt: skip
    for stage, colour in (("filter", FILTER), ("smoother", SMOOTHER)):
        errors = followed.errors[name][stage]
        words = TITLES[name] if stage == "filter" else f"{TITLES[name]} + RTS"
        low, middle, high = np.nanpercentile(errors, (10.0, 50.0, 90.0), axis=1)
        axes.fill_between(t, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(t, middle, color=colour, linewidth=2.4, label=f"{words}, median")
        axes.plot(t, errors[:, run], color=colour, linewidth=0.9, label=f"{words}, one run")
    axes.set(yscale="log", xlabel="time", ylabel=POSITION, xlim=(0.0, float(t[-1])))
    _plain(axes.yaxis)
    picture.legend(loc="outside upper center", ncols=3)
    return picture


def run_by_run(campaign: tk.Campaign, stage: str, shown: int) -> Figure:
    """Figures 10 and 11."""
    picture = _figure()
    axes = picture.subplots()
    marks = dict(zip(METHODS, "osD", strict=True))
    for name in METHODS:
        values = campaign.scores[name][stage].per_run["rmse"]
        words = TITLES[name] if stage == "filter" else f"{TITLES[name]} + RTS"
        axes.plot(
            np.arange(shown), values[:shown], f"{marks[name]}-",
            color=COLOURS[name], linewidth=0.5, markersize=3.5, label=words,
        )  # fmt: skip
        axes.axhline(
            float(np.nanmedian(values)), color=COLOURS[name], linestyle="--", linewidth=1.2
        )
    axes.set(yscale="log", xlabel="run", ylabel=RMSE, xlim=(-1, shown))
    _plain(axes.yaxis)
    picture.legend(loc="outside upper center", ncols=3)
    return picture


# ---------------------------------------------------------------------------- what it suggests
def table_1(rows: Sequence[ResultRow], spreads: Mapping[str, Sequence[Reading]]) -> Figure:
    """Published means and the ranges of every reading."""
    picture = _figure(8.0, 8.6)
    left, right = picture.subplots(1, 2)
    for axes, stage in ((left, "filter"), (right, "smoother")):
        labels: list[str] = []
        for one in (row for row in rows if row.id.endswith(stage)):
            method, begin = one.id.split("/")[1], len(labels)
            for reading in spreads[one.id]:
                _, _, variant = reading.name.partition(", ")
                y = len(labels)
                axes.plot(
                    (reading.low, reading.high), (y, y), color=COLOURS[method], linewidth=6,
                    alpha=0.45 if variant else 1.0, solid_capstyle="butt",
                )  # fmt: skip
                words = variant.removeprefix(f"{method} ").removeprefix(f"{method}, ")
                labels.append(f"{reading.name[0]}" + (f", {words}" if words else ""))
            axes.plot(
                (one.published,) * 2, (begin - 0.4, len(labels) - 0.6), color=INK, linewidth=1.8
            )
            axes.text(
                one.published, begin - 0.5, f"{TITLES[method]}: {one.published:.4f}",
                ha="center", va="bottom", fontsize=10,
            )  # fmt: skip
            labels += [""]
        axes.set(
            xscale="log",
            yticks=range(len(labels)),
            yticklabels=labels,
            xlabel="mean RMSE of 100 runs [scaled units]",
        )
        axes.set(
            title="filter" if stage == "filter" else "filter + RTS", ylim=(len(labels) - 0.6, -1.5)
        )
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        _plain(axes.xaxis)
        axes.tick_params(axis="x", labelsize=8)
    return picture


def printed(campaign: tk.Campaign, wrong: tk.Campaign) -> Figure:
    """Distributions of the RMSE for versions of the extended Kalman filter."""
    picture = _figure(8.0, 4.4)
    lines = (
        ("ekf2", "EKF2, corrected", campaign, PALETTE[1]),
        ("ekf2 as printed", "EKF2, S of eq. 10 as printed", campaign, PALETTE[5]),
        (WRONG_HESSIAN, "EKF2, Hessian of eq. 33 as printed", wrong, PALETTE[3]),
        ("ekf1", "EKF1", campaign, PALETTE[0]),
    )
    panels = picture.subplots(1, 2, sharey=True)
    for axes, stage in zip(panels, ("filter", "smoother"), strict=True):
        for name, words, source, colour in lines:
            values = np.sort(source.scores[name][stage].per_run["rmse"])
            values = values[np.isfinite(values)]
            share = np.arange(1, len(values) + 1) / max(len(values), 1)
            axes.step(values, share, where="post", color=colour, label=words)
        axes.set(xscale="log", xlabel=RMSE, ylim=(0.0, 1.0))
        axes.set(title="filter" if stage == "filter" else "filter + RTS")
        _plain(axes.xaxis)
        axes.tick_params(axis="x", labelsize=8, labelrotation=45)
    panels[0].set_ylabel("share of runs")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return picture


def _ruined(campaign: tk.Campaign, wrong: tk.Campaign) -> str:
    """In words, what the printed equations do to the runs of EKF2."""
    runs = {
        "with the equations corrected": campaign.scores["ekf2"]["filter"],
        "with S of eq. 10 as printed": campaign.scores["ekf2 as printed"]["filter"],
        "with the Hessian of eq. 33 as printed": wrong.scores[WRONG_HESSIAN]["filter"],
    }
    limit = RUINED * np.nanmedian(next(iter(runs.values())).per_run["rmse"])
    shares = [
        f"{np.mean(~(scores.per_run['rmse'] <= limit)):.0%} {words}"
        for words, scores in runs.items()
    ]
    return (
        f"Filtered runs whose RMSE is above {RUINED:g} times the median of EKF2 with the equations "
        f"corrected, or not finite: {', '.join(shares)}."
    )


def crossing(collinear: Mapping[str, Mapping[float, Array]]) -> Figure:
    """Error against the angle between the bearings."""
    picture = _figure()
    axes = picture.subplots()
    fine = np.linspace(0.5, 179.5, 359)
    axes.plot(fine, single_fix(fine), ":", color=INK, label="one fix, RMS (theory)")
    for stage, colour, words in (("filter", FILTER, "EKF1"), ("smoother", SMOOTHER, "EKF1 + RTS")):
        angles = np.array(list(collinear[stage]))
        low, middle, high = np.array(
            [np.nanpercentile(v, (10.0, 50.0, 90.0)) for v in collinear[stage].values()]
        ).T
        axes.fill_between(angles, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(
            angles, middle, "o-", color=colour, markersize=4, label=f"{words}, median and 80 %"
        )
    axes.set(yscale="log", ylim=(0.02, 3.0), xlim=(0.0, 180.0), xticks=range(0, 181, 30))
    axes.set(xlabel="angle between the two bearings [\N{DEGREE SIGN}]", ylabel=RMSE)
    _plain(axes.yaxis)
    axes.legend(loc="upper center")
    return picture


def stations(
    followed: Followed, network: Mapping[int, Mapping[str, Mapping[str, Array]]]
) -> Figure:
    """A map of the stations, and the error against their number."""
    picture = _figure(9.0, 4.4)
    left, right = picture.subplots(1, 2)
    track = np.asarray(followed.scene.path)
    left.plot(track[:, 0], track[:, 1], color=QUIET, label="true path")
    _mark_stations(left, MORE_STATIONS)
    left.set(xlabel="x [scaled units]", ylabel="y [scaled units]", aspect="equal")
    left.set(xlim=(0.1, 5.7), ylim=(-1.1, 3.1))
    left.legend(loc="lower left")
    counts = np.array(list(network))
    for name in METHODS:
        for stage, line in (("filter", "o-"), ("smoother", "s--")):
            middle = [float(np.nanmedian(by[name][stage])) for by in network.values()]
            words = TITLES[name] if stage == "filter" else f"{TITLES[name]} + RTS"
            right.plot(counts, middle, line, color=COLOURS[name], markersize=4, label=words)
    for stage in ("filter", "smoother"):
        first = float(np.nanmedian(network[2]["ekf1"][stage]))
        right.plot(counts, first * np.sqrt(2.0 / counts), ":", color=INK, linewidth=1.2)
    right.set(yscale="log", xticks=counts, xlabel="number of stations", ylabel=f"median {RMSE}")
    _plain(right.yaxis, narrow=True)
    right.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=9)
    return picture


def worth(campaign: tk.Campaign, cost: Mapping[str, int | None]) -> Figure:
    """Operations against error."""
    picture = _figure(8.0, 4.4)
    axes = picture.subplots()
    for name in VARIANTS:
        count = cost[name]
        if count is None:
            continue
        values = campaign.scores[name]["smoother"].per_run["rmse"]
        low, middle, high = np.nanpercentile(values, (10.0, 50.0, 90.0))
        colour = COLOURS[name.partition(" ")[0].rstrip(",")]
        hollow = "white" if name not in METHODS else colour
        words = TITLES.get(name, name.replace("ekf2", "EKF2").replace("ukf", "UKF"))
        axes.errorbar(
            count, middle, yerr=((middle - low,), (high - middle,)), fmt="o", color=colour,
            markerfacecolor=hollow, markersize=8, capsize=4, label=words,
        )  # fmt: skip
    axes.set(yscale="log", xlabel="operations of a step, forwards and backwards", ylim=(0.03, 0.4))
    axes.set(ylabel=f"{RMSE}, smoothed", xlim=(550, None))
    _plain(axes.yaxis, narrow=True)
    axes.legend(loc="upper right")
    return picture
