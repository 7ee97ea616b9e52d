"""The figures of paper 4, several printed ones to a picture; each function draws numbers made elsewhere.

matplotlib is imported when a picture is drawn, in the style of `tracker.report.drawing`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tracker.report.drawing import INK, PALETTE, QUIET, plain_numbers
from tracker.reproduction import Picture, ResultRow
from tracker.types import Array
from tracker_papers.flying_object import TRUE_R
from tracker_papers.paper4 import tables
from tracker_papers.paper4.methods import ANSWERS, TERMS
from tracker_papers.paper4.scores import Followed, Outcomes
from tracker_papers.paper4.tuning import OPTIMISERS, Problem, true_variances
from tracker_papers.underwater_angles import MOTIONS, sensor_path
from tracker_papers.underwater_multipath import PRESETS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tracker_papers.paper4.beyond import Beyond
    from tracker_papers.paper4.study import Everything, Linear

PLAIN, FUZZY, TRUE, UNSCENTED = PALETTE[0], PALETTE[1], PALETTE[2], PALETTE[3]
COLOURS = {
    "kf": PLAIN, "ekf": PLAIN, "ukf": UNSCENTED, "ica": FUZZY, "fuzzy": FUZZY, "true": TRUE,
    "hand": PALETTE[5], "ga": PALETTE[5], "pso": PALETTE[4],
}  # fmt: skip
STYLES = {"ukf": "--", "true": ":"}
SHORT = {
    "kf": "KF", "ekf": "EKF", "ukf": "UKF", "ica": "fuzzy KF (ICA)", "fuzzy": "fuzzy EKF",
    "true": "told the truth",
}  # fmt: skip
TITLES = {
    "static": "static sensors", "constant": "sensors at constant velocity",
    "manoeuvring": "manoeuvring sensors",
}  # fmt: skip
STATES = ("X1, x [m]", "X2, y [m]", "X3, z [m]", "X4, vx [m/s]", "X5, vy [m/s]", "X6, vz [m/s]")
LINEAR_STATES = ("X1, position", "X2, velocity", "X3, acceleration")


def pictures(found: Everything, rows: Sequence[ResultRow]) -> tuple[Picture, ...]:
    """All pictures, in the order of the thesis."""
    out: list[Picture] = [
        Picture(
            "figure_3_07", "How R is adapted",
            "The innovation of the filter has a covariance in theory, S, and one in a window of the last 25 steps, C. "
            "Their difference DOM goes through a fuzzy system, whose answer is added to R for the next step.",
            "A loop of four boxes: filter, window, difference, fuzzy system.",
            loop, "3-7",
        )
    ]  # fmt: skip
    for experiment, numbers in (
        ("R", ("3-8", "3-9 to 3-13", "3-14, 3-15", "3-16, 3-17", "3-18, 3-19")),
        ("Q", ("3-20", "3-21 to 3-25", "3-26, 3-27", "3-28, 3-29", "3-30, 3-31")),
    ):
        one = found.linear[experiment, next(iter(TRUE_R[experiment]))]
        out += _linear_pictures(experiment, one, found.followed[experiment], numbers)
    out += [
        Picture(
            "cost_and_error", "A small mismatch is not a small error",
            "Each point is a fuzzy system on one run: mismatch against error. Grey: drawn at random between the rules by "
            "hand and anywhere in the bounds; orange: tuned on the mismatch; green: tuned on the error of the same run; "
            "star: the filter told the true R, without any fuzzy system.",
            "Scatter of error against mismatch with a cloud that flattens to the left.",
            partial(cost_and_error, found),
        ),
        Picture(
            "ranking", "Which optimiser is best",
            "Lowest cost of each restart, experiments R and Q, all with the same number of evaluations; vertical lines: "
            "the best costs that Tables 3-2 and 3-4 print. Claim 1b judges their order.",
            "Distribution curves of the cost of three optimisers, nearly on top of each other.",
            partial(ranking, found),
        ),
    ]  # fmt: skip
    out += _echo_pictures(found)
    for motion, printed in zip(MOTIONS, _ANGLE_NUMBERS, strict=True):
        out += _angle_pictures(found, motion, printed)
    return (
        *out,
        Picture(
            "best_where", "What is best where",
            "Median position RMSE over that of the EKF told the true noise, with its 95 % interval, in the four "
            "underwater problems. Left of the line means better than told the truth: possible where the "
            "filter is not optimal anyway, as after a start that it believes too much. What is not drawn is beyond the "
            "right edge.",
            "Four panels of points with error bars, one line per filter.",
            partial(best_where, tables.best_of(found)),
        ),
        Picture(
            "best_where_fair", "What is best where, fairly begun",
            "The same with a prior that holds the true start.",
            "Four panels of points with error bars, one line per filter.",
            partial(best_where, found.fair),
        ),
        Picture(
            "published", "Published and ours",
            "Ours over published, for every cell of each table; the nearest number where digits cannot be read. "
            "Filled: reproduced; hollow: not.",
            "Points about one on a logarithmic scale, one line per table.",
            partial(published, rows),
        ),
    )  # fmt: skip


_ANGLE_NUMBERS = (
    ("5-1", "5-3 to 5-8", "5-9, 5-10", "5-11", "5-12", "5-13"),
    ("", "5-14 to 5-19", "5-20, 5-21", "", "5-22", "5-23"),
    ("", "5-24 to 5-29", "5-30, 5-31", "", "5-32", "5-33"),
)


def _linear_pictures(
    experiment: str, one: Linear, run: Followed, numbers: Sequence[str]
) -> list[Picture]:
    restarts = len(one.tuned.cost["ga"])
    what = "R" if experiment == "R" else "Q"
    return [
        Picture(
            f"figure_3_{_first(numbers[0])}", f"Cost against evaluations, experiment {experiment}",
            f"Thick: median of {restarts} restarts, with the band of the middle 80 %; every optimiser is given the "
            "same runs and the same number of evaluations.",
            "Three falling curves, close together.",
            partial(learning, one), numbers[0],
        ),
        Picture(
            f"figure_3_{_first(numbers[1])}", f"Error against time, experiment {experiment}",
            f"Root mean square over {one.fresh['kf'].place.size} runs at each time: the three states, and the two "
            "measured quantities, which are the first two states, as J2 is J3 by definition.",
            "Five panels of error against time; the adapted filter is below the one told wrongly.",
            partial(errors_over_time, one.fresh), numbers[1],
        ),
        Picture(
            f"figure_3_{_first(numbers[2])}", f"S, C, {what} and DOM of the Kalman filter, experiment {experiment}",
            "One run, elements (1,1) and (2,2). Told wrongly and without adapter, theory and sample stay apart."
            + _only_r(experiment),
            "Two columns of three panels against time: S and C, R, DOM.",
            partial(mismatch, run, "kf", what), numbers[2],
        ),
        Picture(
            f"figure_3_{_first(numbers[3])}", f"The same with the fuzzy system tuned by ICA, experiment {experiment}",
            "The same run. Theory follows the sample within a window or two, and DOM goes to zero."
            + _only_r(experiment),
            "Two columns of three panels against time: S and C, R, DOM near zero.",
            partial(mismatch, run, "ica", what), numbers[3],
        ),
        Picture(
            f"figure_3_{_first(numbers[4])}", f"Membership functions tuned by ICA, experiment {experiment}",
            "Left: of the degree of mismatch, in variances told; right: centres of the answers, as the centre average "
            f"takes them. One row for each entry of {what}; the restart of median cost.",
            "Bell curves on the left, five vertical bars on the right.",
            partial(membership, one.tuned.problem, one.tuned.median("ica")), numbers[4],
        ),
    ]  # fmt: skip


def _only_r(experiment: str) -> str:
    if experiment == "R":
        return " Broken line: the true R."
    return " R is right in this experiment, and stays: Q is shown instead, broken the true one."


def _first(number: str) -> str:
    return number.split("-")[1].split(" ", maxsplit=1)[0].rstrip(",").zfill(2)


def _echo_pictures(found: Everything) -> list[Picture]:
    outcomes, run = next(iter(found.echoes.values())), found.followed["echoes"]
    tuned = found.echo_tuned
    return [
        Picture(
            "figure_4_01", "Geometry of chapter 4",
            "Preset M1, through the first hydrophone: direct path, and the paths by surface and bottom with the "
            "images they seem to come from; heights are to scale, z = 0 as in the thesis.",
            "Section through the water with three rays from target to hydrophone.",
            geometry, "4-1, 4-2",
        ),
        Picture(
            "figure_4_04", "Estimates and errors, chapter 4",
            f"Left: one run, truth and estimates; right: root mean square over {outcomes['ekf'].place.size} runs. The "
            "UKF lies on the EKF.",
            "Six rows of two panels, one row per state.",
            partial(states, run, outcomes), "4-4 to 4-9",
        ),
        Picture(
            "figure_4_10", "Slant ranges to both hydrophones",
            "The same run: true, and from the estimates.",
            "Two panels of range against time.",
            partial(ranges, run, _echo_places()), "4-10, 4-11",
        ),
        Picture(
            "figure_4_12", "Delays before and after noise",
            "Top: by the surface, bottom: by the bottom, for both hydrophones. The noise of the bottom path is as "
            "large as the delay itself: 20 dB, as the thesis states, hold for the surface path alone.",
            "Four panels of noisy and clean delays against time.",
            partial(before_and_after, run, 1e3, "ms", ("surface path, hydrophone 1", "bottom path, hydrophone 1", "surface path, hydrophone 2", "bottom path, hydrophone 2")),
            "4-12 to 4-15",
        ),
        Picture(
            "figure_4_16", "S, C, R and DOM(1,1) of EKF, UKF and fuzzy EKF",
            "The same run, delay of the surface path at hydrophone 1. Broken line: the true R.",
            "Three columns of three panels against time.",
            partial(mismatch_of, run, ("ekf", "ukf", "fuzzy"), 0), "4-16 to 4-18",
        ),
        Picture(
            "figure_4_19", "Membership functions tuned by ICA, chapter 4",
            "Left: of the degree of mismatch, in variances told; right: centres of the answers. Top row: surface paths, "
            "bottom row: bottom paths.",
            "Bell curves on the left, five vertical bars on the right.",
            partial(membership, tuned.problem, tuned.median("ica")), "4-19, 4-20",
        ),
        Picture(
            "figure_4_21", "Tracks in space, chapter 4",
            "The same run: the target and what the filters make of it, with the hydrophones.",
            "Three-dimensional tracks from one start.",
            partial(tracks, run, _echo_places()), "4-21",
        ),
    ]  # fmt: skip


def _angle_pictures(found: Everything, motion: str, numbers: Sequence[str]) -> list[Picture]:
    outcomes = next(o for (m, _), o in found.angles.items() if m == motion)
    run, tuned = found.followed[motion], found.angle_tuned
    key = numbers[1].split("-")[1].split(" ")[0].zfill(2)
    out = [
        Picture(
            f"figure_5_{key}", f"Estimates and errors, {TITLES[motion]}",
            f"Left: one run, truth and estimates; right: root mean square over {outcomes['ekf'].place.size} runs. The "
            "UKF lies on the EKF.",
            "Six rows of two panels, one row per state.",
            partial(states, run, outcomes), numbers[1],
        ),
        Picture(
            f"figure_5_{_first(numbers[2])}", f"Slant ranges, {TITLES[motion]}",
            "The same run: true, and from the estimates.",
            "Two panels of range against time.",
            partial(ranges, run, _angle_places(motion)), numbers[2],
        ),
    ]  # fmt: skip
    if motion == "static":
        out.insert(
            0,
            Picture(
                "figure_5_01", "Geometry of chapter 5",
                "Seen from above: the target and the two sensors, which stand still, go straight, or weave; lines "
                "join them every 100 s. Static sensors end up with parallel bearings.",
                "Three maps with the target's path and the sensors' paths.",
                angle_geometry, numbers[0],
            ),
        )  # fmt: skip
        names = ("azimuth 1", "elevation 1", "azimuth 2", "elevation 2")
        out += [
            Picture(
                "figure_5_11", "Angles before and after noise",
                "The same run, in radians.",
                "Four panels of noisy and clean angles against time.",
                partial(before_and_after, run, 1.0, "rad", names), numbers[3],
            )
        ]  # fmt: skip
    out += [
        Picture(
            f"figure_5_{_first(numbers[4])}", f"Membership functions and what they do, {TITLES[motion]}",
            "The fuzzy system tuned by ICA with static sensors is used throughout, as in the thesis; what differs is "
            "how R of the first azimuth moves. Left: memberships, azimuth above elevation; right: R against time, broken "
            "the true one.",
            "Bell curves on the left, noise against time on the right.",
            partial(membership_at_work, tuned.problem, tuned.median("ica"), run), numbers[4],
        ),
        Picture(
            f"figure_5_{_first(numbers[5])}", f"Tracks in space, {TITLES[motion]}",
            "The same run: the target and what the filters make of it, with the sensors.",
            "Three-dimensional tracks.",
            partial(tracks, run, _angle_places(motion)), numbers[5],
        ),
    ]  # fmt: skip
    return out


# ------------------------------------------------------------------------------------ pieces
def _figure(width: float = 8.0, height: float = 4.6) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _names(outcomes: Mapping[str, Any], wanted: Sequence[str]) -> list[str]:
    return [name for name in wanted if name in outcomes]


# --------------------------------------------------------------------------------- chapter 3
def loop() -> Figure:
    """Figure 3-7."""
    picture = _figure(8.0, 2.6)
    axes = picture.subplots()
    axes.set(xlim=(-0.3, 10.3), ylim=(-1.5, 1.3))
    axes.axis("off")
    boxes = (
        (0.9, 0.4, "Kalman filter\nwith R(k)"),
        (3.7, 0.4, "window of 25\nC = mean of r r'"),
        (6.5, 0.4, "DOM = S \N{MINUS SIGN} C"),
        (9.2, 0.4, "fuzzy system\n5 rules"),
    )
    style = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": PLAIN}
    for x, y, words in boxes:
        axes.text(x, y, words, ha="center", va="center", bbox=style)
    arrow = {"arrowstyle": "->", "color": INK}
    for (x, y, _), (to, _, _), words in zip(boxes[:-1], boxes[1:], ("r", "C", "DOM"), strict=True):
        axes.annotate("", (to - 0.95, y), (x + 0.95, y), arrowprops=arrow)
        axes.text((x + to) / 2, y + 0.18, words, ha="center", color=QUIET)
    axes.plot([9.2, 9.2, 0.9], [-0.2, -1.1, -1.1], color=INK, linewidth=1.0)
    axes.annotate("", (0.9, -0.15), (0.9, -1.1), arrowprops=arrow)
    axes.text(5.0, -1.0, "R(k + 1) = R(k) + adjustment, on the diagonal", ha="center", va="bottom")
    axes.plot([0.9, 0.9, 6.5], [0.95, 1.15, 1.15], color=QUIET, linewidth=0.8)
    axes.annotate("", (6.5, 0.75), (6.5, 1.15), arrowprops={"arrowstyle": "->", "color": QUIET})
    axes.text(3.7, 1.17, "S = H P H' + R", ha="center", va="bottom", color=QUIET)
    return picture


def learning(one: Linear) -> Figure:
    """Figures 3-8 and 3-20."""
    picture = _figure(8.0, 4.2)
    axes = picture.subplots()
    for name in OPTIMISERS:
        best = one.tuned.history[name]
        evaluated = one.tuned.evaluations / len(best) * np.arange(1, len(best) + 1)
        low, middle, high = np.percentile(best, (10.0, 50.0, 90.0), axis=1)
        axes.fill_between(evaluated, low, high, color=COLOURS[name], alpha=0.15, linewidth=0)
        axes.plot(evaluated, middle, color=COLOURS[name], linewidth=2.0, label=name.upper())
    axes.set(xlabel="evaluations of the cost", ylabel="lowest cost so far (eq. 3-19)")
    axes.legend()
    return picture


def errors_over_time(outcomes: Outcomes) -> Figure:
    """Figures 3-9 to 3-13 and 3-21 to 3-25."""
    picture = _figure(9.0, 6.0)
    panels = picture.subplots(2, 3, sharex=True).ravel()
    t = outcomes.scene.t
    names = _names(outcomes.of, ("kf", "ica", "true"))
    for state, title in enumerate(LINEAR_STATES):
        for name in names:
            panels[state].plot(
                t, np.sqrt(outcomes[name].mean_square[:, state]), STYLES.get(name, "-"),
                color=COLOURS[name], linewidth=1.0, label=SHORT[name],
            )  # fmt: skip
        panels[state].set(title=title, ylim=(0.0, None))
    for which in range(2):
        axes = panels[3 + which]
        for name in names:
            axes.plot(
                t, np.sqrt(outcomes[name].mean_square_measured[:, which]), STYLES.get(name, "-"),
                color=COLOURS[name], linewidth=1.0,
            )  # fmt: skip
        axes.set(title=f"Z{which + 1}", ylim=(0.0, None), xlabel="time [s]")
    panels[0].set(ylabel="RMS over runs")
    panels[3].set(ylabel="RMS over runs")
    panels[2].tick_params(labelbottom=True)
    panels[2].set(xlabel="time [s]")
    panels[5].axis("off")
    panels[5].legend(*panels[0].get_legend_handles_labels(), loc="center")
    return picture


def mismatch(run: Followed, name: str, what: str) -> Figure:
    """Figures 3-14 to 3-17 and 3-26 to 3-29."""
    return _mismatches(run, [(name, 0), (name, 1)], ["(1,1)", "(2,2)"], what)


def mismatch_of(run: Followed, names: Sequence[str], element: int) -> Figure:
    """Figures 4-16 to 4-18."""
    return _mismatches(
        run, [(name, element) for name in names], [SHORT[name] for name in names], "R"
    )


def _mismatches(
    run: Followed, columns: Sequence[tuple[str, int]], titles: Sequence[str], what: str
) -> Figure:
    picture = _figure(9.0, 6.4)
    panels = picture.subplots(3, len(columns), sharex=True, squeeze=False)
    t = run.scene.t
    true = true_variances(run.scene, what)
    for place, ((name, i), title) in enumerate(zip(columns, titles, strict=True)):
        top, middle, low = panels[:, place]
        top.plot(t, run.theory[name][:, i], color=PLAIN, label="S, theory")
        top.plot(t, run.sample[name][:, i], color=FUZZY, linewidth=1.0, label="C, window")
        used = (run.R if what == "R" else run.Q)[name][:, i]
        middle.plot(t, used, color=TRUE, label=f"{what} used")
        middle.axhline(true[i], color=INK, linestyle="--", linewidth=1.0, label=f"{what}, true")
        low.plot(t, run.dom(name)[:, i], color=PALETTE[3])
        low.axhline(0.0, color=QUIET, linewidth=0.8)
        top.set(title=title, ylim=(0.0, None))
        middle.set(ylim=(0.0, None))
        low.set(xlabel="time [s]")
        for axes in (top, middle, low):
            axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4))
    for axes, words in zip(panels[:, 0], ("S and C", what, "DOM"), strict=True):
        axes.set(ylabel=words)
    for axes in panels[:2, 0]:
        axes.legend(loc="best", fontsize=9)
    return picture


def membership(asked: Problem, numbers: Array) -> Figure:
    """Figures 3-18, 3-19, 3-30, 3-31, 4-19, 4-20."""
    blocks = len(asked.largest)
    picture = _figure(9.0, 1.9 * blocks + 0.7)
    panels = picture.subplots(blocks, 2, squeeze=False)
    for block in range(blocks):
        _memberships(panels[block, 0], asked, numbers, block)
        answers = numbers[15 * block + 10 : 15 * block + 15]
        for answer, value, colour in zip(ANSWERS, answers, _FIVE, strict=True):
            panels[block, 1].plot(
                [value, value], [0.0, 1.0], color=colour, linewidth=2.5, label=answer
            )
        panels[block, 1].axvline(0.0, color=QUIET, linewidth=0.8)
        panels[block, 1].set(ylim=(0.0, 1.05), yticks=(0.0, 1.0))
        panels[block, 1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)
    panels[-1, 0].set(xlabel="DOM [variances told]")
    panels[-1, 1].set(xlabel="adjustment of a step [variances told]")
    return picture


_FIVE = (PALETTE[0], PALETTE[4], QUIET, PALETTE[5], PALETTE[1])


def _memberships(axes: Axes, asked: Problem, numbers: Array, block: int) -> None:
    size = float(asked.largest[block])
    x = np.linspace(-2.0 * size, 2.0 * size, 401)
    for k, (term, colour) in enumerate(zip(TERMS, _FIVE, strict=True)):
        centre, width = numbers[15 * block + k], numbers[15 * block + 5 + k]
        axes.plot(x, np.exp(-(((x - centre) / width) ** 2)), color=colour, label=term)
    axes.set(ylim=(0.0, 1.05), yticks=(0.0, 1.0), ylabel=f"entry {block + 1}")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)


def cost_and_error(found: Everything) -> Figure:
    """RMSE against mismatch of many fuzzy systems."""
    picture = _figure(8.0, 4.8)
    axes = picture.subplots()
    one, main = found.scatter, found.linear["R", "text"]
    axes.plot(
        one["cost"].ravel(), one["error"].ravel(), ".", color=QUIET, markersize=3, alpha=0.4,
        label="drawn at random", rasterized=True,
    )  # fmt: skip
    axes.plot(
        one["tuned cost"], one["tuned error"], "o", color=FUZZY, markersize=5,
        label="tuned on the mismatch",
    )  # fmt: skip
    best = found.by_error["R"]
    tuned_cost = best.problem.restarts
    numbers = best.numbers["ica"][:, None]
    dom = attrs.evolve(best.problem, objective="dom").cost(numbers)[0]
    axes.plot(
        dom[:tuned_cost], best.cost["ica"] / 3.0, "s", color=TRUE, markersize=5,
        label="tuned on the error",
    )  # fmt: skip
    true = main.fresh["true"]
    axes.plot(
        np.median(true.cost()), np.median(true.rmse.mean(axis=0)), "*", color=INK, markersize=15,
        label="filter told the true R (median)",
    )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="mismatch, cost of eq. 3-19")
    axes.set(ylabel="RMSE, mean of the three states", xlim=(900, 4e4), ylim=(0.24, 1.2))
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    axes.legend(loc="upper left")
    return picture


def ranking(found: Everything) -> Figure:
    """Distribution of the cost over restarts."""
    picture = _figure(9.0, 4.0)
    printed = {"R": {"ga": 999.0, "pso": 984.0, "ica": 983.5}, "Q": {}}
    for axes, experiment in zip(picture.subplots(1, 2, sharey=True), TRUE_R, strict=True):
        tuned = found.linear[experiment, next(iter(TRUE_R[experiment]))].tuned
        for name in OPTIMISERS:
            cost = np.sort(tuned.cost[name])
            share = np.arange(1, len(cost) + 1) / len(cost)
            axes.step(cost, share, where="post", color=COLOURS[name], label=name.upper())
            if name in printed[experiment]:
                axes.axvline(printed[experiment][name], color=COLOURS[name], linestyle=":")
        axes.set(title=f"experiment {experiment}", xlabel="cost (eq. 3-19)")
        axes.legend(loc="lower right")
    axes.figure.axes[0].set(ylabel="share of restarts below")
    return picture


# ------------------------------------------------------------------------------- under water
def _echo_places() -> Callable[[Array], list[Array]]:
    def at(t: Array) -> list[Array]:
        return [np.repeat(np.array(p)[:, None], len(t), axis=1) for p in PRESETS["M1"].places]

    return at


def _angle_places(motion: str) -> Callable[[Array], list[Array]]:
    def at(t: Array) -> list[Array]:
        pose = sensor_path(motion).pose(t)
        return [pose[:3], pose[3:]]

    return at


def geometry() -> Figure:
    """Figures 4-1 and 4-2."""
    channel = PRESETS["M1"]
    sensor, target = np.array(channel.places[0]), np.array([0.0, -5.0, -98.0])
    rho = float(np.hypot(*(target - sensor)[:2]))
    z, zs = float(target[2]), float(sensor[2])
    top, low = zs + channel.depth, zs - channel.height
    picture = _figure(8.0, 4.6)
    axes = picture.subplots()
    axes.axhspan(top, top + 40, color="#e8f1f8")
    axes.axhspan(low - 40, low, color="#efe7dc")
    axes.axhline(top, color=PALETTE[4], linewidth=2)
    axes.axhline(low, color=PALETTE[5], linewidth=2)
    for level, colour, words in ((top, PALETTE[4], "surface"), (low, PALETTE[5], "bottom")):
        image = 2.0 * level - z
        at = rho * (level - zs) / (image - zs)
        axes.plot([rho, at, 0.0], [z, level, zs], color=colour, linewidth=1.6)
        side = "top" if level == top else "bottom"
        axes.text(rho + 12, level + (-6 if level == top else 6), words, va=side, color=colour)
    axes.plot([rho, 0.0], [z, zs], color=INK, linewidth=1.6)
    axes.text(rho / 2, (z + zs) / 2 + 8, "direct, R", ha="center")
    axes.plot(0.0, zs, "^", color=INK, markersize=10)
    axes.annotate("hydrophone", (0.0, zs), xytext=(-8, -18), textcoords="offset points", ha="right")
    axes.plot(rho, z, "o", color=FUZZY, markersize=9)
    axes.annotate("target", (rho, z), xytext=(10, 0), textcoords="offset points", va="center")
    for level, words in ((top, "HO1 = 285"), (low, "HO2 = 270")):
        axes.annotate("", (-40, level), (-40, zs), arrowprops={"arrowstyle": "<->", "color": QUIET})
        axes.text(-48, (level + zs) / 2, words, ha="right", va="center", color=QUIET)
    axes.set(xlim=(-190, rho + 110), ylim=(low - 40, top + 40))
    axes.set(xlabel="horizontal range [m]", ylabel="z [m]")
    return picture


def angle_geometry() -> Figure:
    """Figure 5-1."""
    from tracker_papers.underwater_angles import START
    from tracker_papers.underwater_multipath import KMH

    picture = _figure(9.0, 7.0)
    t = np.arange(0.0, 501.0)
    start = np.array(START)
    path = start[:2, None] + KMH * start[3:5, None] * t
    for axes, motion in zip(picture.subplots(3, 1, sharex=True), MOTIONS, strict=True):
        axes.plot(*path, color=INK, label="target, undisturbed")
        pose = sensor_path(motion).pose(t)
        for sensor, colour in ((pose[:2], PLAIN), (pose[3:5], FUZZY)):
            axes.plot(*sensor, color=colour)
            axes.plot(*sensor[:, 0], "^", color=colour, markersize=8)
            for k in range(0, 501, 100):
                axes.plot(
                    [sensor[0, k], path[0, k]], [sensor[1, k], path[1, k]], color=colour,
                    linewidth=0.6, alpha=0.7,
                )  # fmt: skip
        axes.set(title=TITLES[motion], ylabel="y [m]", ylim=(-330, 180))
    axes.set(xlabel="x [m]")
    return picture


def states(run: Followed, outcomes: Outcomes) -> Figure:
    """Figures 4-4 to 4-9, 5-3 to 5-8, 5-14 to 5-19, 5-24 to 5-29."""
    picture = _figure(9.0, 11.0)
    panels = picture.subplots(6, 2, sharex=True)
    t, names = run.scene.t, ("ekf", "ukf", "fuzzy")
    for state, title in enumerate(STATES):
        left, right = panels[state]
        left.plot(t, run.truth[:, state], color=INK, linewidth=2.0, label="truth")
        for name in names:
            style = {"color": COLOURS[name], "linewidth": 1.1, "linestyle": STYLES.get(name, "-")}
            left.plot(t, run.mean[name][:, state], label=SHORT[name], **style)
            right.plot(t, np.sqrt(outcomes[name].mean_square[:, state]), **style)
        left.set(ylabel=title)
        right.set(ylim=(0.0, None))
    panels[0, 0].set(title="one run")
    panels[0, 1].set(title="RMS error over runs")
    for axes in panels[-1]:
        axes.set(xlabel="time [s]")
    picture.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def ranges(run: Followed, places: Callable[[Array], list[Array]]) -> Figure:
    """Figures 4-10, 4-11, 5-9, 5-10, 5-20, 5-21, 5-30, 5-31."""
    picture = _figure(9.0, 3.8)
    t = run.scene.t
    for number, (axes, place) in enumerate(
        zip(picture.subplots(1, 2, sharey=True), places(t), strict=True), 1
    ):
        axes.plot(
            t,
            np.linalg.norm(run.truth[:, :3].T - place, axis=0),
            color=INK,
            linewidth=2,
            label="truth",
        )
        for name in ("ekf", "ukf", "fuzzy"):
            away = np.linalg.norm(run.mean[name][:, :3].T - place, axis=0)
            axes.plot(
                t,
                away,
                STYLES.get(name, "-"),
                color=COLOURS[name],
                linewidth=1.1,
                label=SHORT[name],
            )
        axes.set(title=f"sensor {number}", xlabel="time [s]")
        if number == 1:
            axes.set(ylabel="slant range [m]")
            axes.legend()
    return picture


def before_and_after(run: Followed, factor: float, unit: str, names: Sequence[str]) -> Figure:
    """Figures 4-12 to 4-15 and 5-11."""
    picture = _figure(9.0, 5.4)
    panels = picture.subplots(2, 2, sharex=True)
    for i, name in enumerate(names):
        axes = panels[i % 2, i // 2]
        axes.plot(
            run.scene.t, factor * run.z[:, i], color=PALETTE[4], linewidth=0.7, label="measured"
        )
        axes.plot(run.scene.t, factor * run.clean[:, i], color=INK, label="without noise")
        axes.set(title=name, ylabel=f"[{unit}]")
    for axes in panels[-1]:
        axes.set(xlabel="time [s]")
    panels[0, 0].legend(loc="upper right", fontsize=9)
    return picture


def membership_at_work(asked: Problem, numbers: Array, run: Followed) -> Figure:
    """Figures 5-12, 5-22 and 5-32."""
    picture = _figure(9.0, 4.8)
    panels = picture.subplots(2, 2)
    true = true_variances(run.scene, "R")
    for block, words in enumerate(("azimuth", "elevation")):
        _memberships(panels[block, 0], asked, numbers, block)
        panels[block, 0].set(ylabel=words)
        axes = panels[block, 1]
        axes.plot(run.scene.t, run.R["fuzzy"][:, block], color=FUZZY, label="R used")
        axes.axhline(true[block], color=INK, linestyle="--", linewidth=1.0, label="R, true")
        axes.set(ylim=(0.0, None), ylabel="R [rad²]")
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4))
    panels[0, 1].legend(loc="lower right", fontsize=9)
    panels[1, 0].set(xlabel="DOM [variances told]")
    panels[1, 1].set(xlabel="time [s]")
    return picture


def tracks(run: Followed, places: Callable[[Array], list[Array]]) -> Figure:
    """Figures 4-21, 5-13, 5-23 and 5-33."""
    from matplotlib.ticker import MaxNLocator

    picture = _figure(8.0, 5.6)
    axes: Any = picture.add_subplot(projection="3d")
    axes.plot(*run.truth[:, :3].T, color=INK, linewidth=2.2, label="truth")
    for name in ("ekf", "ukf", "fuzzy"):
        axes.plot(
            *run.mean[name][:, :3].T, STYLES.get(name, "-"), color=COLOURS[name], linewidth=1.1,
            label=SHORT[name],
        )  # fmt: skip
    for number, place in enumerate(places(run.scene.t)):
        axes.plot(*place, color=QUIET, linewidth=1.0)
        axes.plot(
            *place[:, :1], "^", color=QUIET, markersize=8, label="sensors" if number == 0 else None
        )
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.set_xlabel("x [m]", labelpad=8)
    axes.set_ylabel("y [m]", labelpad=8)
    axes.set_zlabel("z [m]", labelpad=8)
    axes.view_init(elev=24, azim=-62)
    axes.set_box_aspect(None, zoom=0.85)
    picture.legend(loc="outside upper center", ncols=5)
    return picture


# ------------------------------------------------------------------------------- all together
def best_where(problems: Mapping[str, Outcomes]) -> Figure:
    """Each filter over the EKF told the true noise."""
    from tracker.metrics.resampling import ratio_of_medians

    rng = np.random.default_rng(0)
    names = [
        name
        for name in next(iter(problems.values())).of
        if not name.startswith("printed") and name != "true"
    ]
    picture = _figure(10.0, 1.0 + 0.3 * len(names))
    panels = picture.subplots(1, len(problems), sharey=True)
    for axes, (label, one) in zip(panels, problems.items(), strict=True):
        for place, name in enumerate(names):
            if name not in one.of:
                continue
            ratio = ratio_of_medians(one[name].place, one["true"].place, rng=rng)
            if not ratio.high < 6.0:
                axes.annotate("\N{RIGHTWARDS ARROW}", (5.0, place), va="center", color=QUIET)
                continue
            colour = FUZZY if "fuzzy" in tables.label_of(name).lower() else PLAIN
            axes.errorbar(
                ratio.value, place, xerr=((ratio.value - ratio.low,), (ratio.high - ratio.value,)),
                fmt="o", color=colour, capsize=3, markersize=5,
            )  # fmt: skip
        axes.axvline(1.0, color=INK, linewidth=1.0, linestyle=":")
        axes.set(xscale="log", xlim=(0.7, 6.0), title=label, xlabel="over told the truth")
        axes.set_title(label, fontsize=11)
        plain_numbers(axes.xaxis)
    panels[0].set_yticks(range(len(names)), [tables.label_of(name) for name in names])
    panels[0].invert_yaxis()
    return picture


def published(rows: Sequence[ResultRow]) -> Figure:
    """Ours over published."""
    picture = _figure(9.0, 4.8)
    axes = picture.subplots()
    order = list(dict.fromkeys(row.id.split("/")[0] for row in rows))
    for line, table in enumerate(order):
        mine = [row for row in rows if row.id.startswith(f"{table}/")]
        for place, row in enumerate(mine):
            offset = 0.6 * (place / max(len(mine) - 1, 1) - 0.5)
            good = row.verdict == "reproduced"
            axes.plot(
                row.ours / row.published, line + offset, "o", color=PLAIN, markersize=4.5,
                markerfacecolor=PLAIN if good else "white",
            )  # fmt: skip
    axes.axvline(1.0, color=INK, linewidth=1.0, linestyle=":")
    axes.set(xscale="log", xlabel="ours over published")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_yticks(range(len(order)), [name.replace("table", "Table ") for name in order])
    axes.invert_yaxis()
    return picture


# ----------------------------------------------------------------------------------- beyond
def beyond_pictures(more: Beyond, found: Everything) -> list[Picture]:
    """Of the thesis's future work."""
    return [
        Picture(
            "more_sensors", "Two to eight sensors",
            "Left: the places, in the order in which they are added, and the target's path. Right: median position RMSE "
            "with the middle 80 % of the runs of the fuzzy EKF; dotted, the value of two falling as one over the root "
            "of the number.",
            "Map of eight sensors, and error against their number.",
            partial(more_sensors, more),
        ),
        Picture(
            "stronger_optimisers", "Stronger optimisers",
            "Lowest cost so far against evaluations, experiment R, median of the restarts.",
            "Six falling curves.",
            partial(stronger, more, found),
        ),
    ]  # fmt: skip


def more_sensors(more: Beyond) -> Figure:
    """Places, and error against number."""
    from tracker_papers.paper4.beyond import AROUND
    from tracker_papers.underwater_angles import START
    from tracker_papers.underwater_multipath import KMH

    picture = _figure(9.0, 4.2)
    left, right = picture.subplots(1, 2)
    start, t = np.array(START), np.array([0.0, 500.0])
    left.plot(*(start[:2, None] + KMH * start[3:5, None] * t), color=INK, label="target")
    for number, (x, y, _) in enumerate(AROUND, 1):
        left.plot(x, y, "^", color=PLAIN, markersize=8)
        side = -1 if number == 1 else 1
        left.annotate(
            f"{number}", (x, y), xytext=(0, 8 * side), textcoords="offset points", ha="center",
            va="top" if side < 0 else "bottom",
        )  # fmt: skip
    left.set(xlabel="x [m]", ylabel="y [m]")
    left.margins(0.1)
    counts = np.array(list(more.sensors))
    for name, label in (
        ("ekf", "EKF, told wrongly"),
        ("hand", "fuzzy EKF, by hand"),
        ("true", "told the truth"),
    ):
        place = [o[name].place for o in more.sensors.values()]
        low, middle, high = np.array([np.percentile(p, (10.0, 50.0, 90.0)) for p in place]).T
        if name == "hand":
            right.fill_between(counts, low, high, color=COLOURS[name], alpha=0.2, linewidth=0)
            right.plot(counts, middle[0] * np.sqrt(counts[0] / counts), ":", color=INK)
        right.plot(counts, middle, "o-", color=COLOURS[name], markersize=4, label=label)
    right.set(yscale="log", xlabel="number of sensors", ylabel="position RMSE [m]", xticks=counts)
    plain_numbers(right.yaxis)
    right.legend()
    return picture


def stronger(more: Beyond, found: Everything) -> Figure:
    """Cost against evaluations of all optimisers."""
    picture = _figure(8.0, 4.2)
    axes = picture.subplots()
    main = found.linear["R", next(iter(TRUE_R["R"]))].tuned
    for tuned, style in ((main, "-"), (more.stronger, "--")):
        for place, (name, best) in enumerate(tuned.history.items()):
            evaluated = tuned.evaluations / len(best) * np.arange(1, len(best) + 1)
            axes.plot(
                evaluated, np.median(best, axis=1), style, color=PALETTE[place], label=name.upper()
            )
    axes.set(xlabel="evaluations of the cost", ylabel="lowest cost so far (eq. 3-19)", yscale="log")
    plain_numbers(axes.yaxis)
    axes.legend(ncols=2)
    return picture
