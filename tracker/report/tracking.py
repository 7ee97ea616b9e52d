"""What became of a detection log tracked with several sets of sensors: pictures of it, and the page.

Nothing is computed here that a table of results needs; that is in `tracker.metrics`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tracker.io.detections import SENSOR_KINDS, DetectionLog, TruthTrack
from tracker.metrics.consistency import chi_square_band
from tracker.metrics.tracking import TrackScore
from tracker.pipeline import PipelineHistory
from tracker.report import page
from tracker.report.drawing import INK, PALETTE, QUIET, ellipse, svg
from tracker.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 6.8
_ELLIPSES = 8
_LINES_OF_BEARING = 15
_BLOCK = 20
_SETS = (PALETTE[2], PALETTE[3], PALETTE[5], PALETTE[4])  # others than those of the targets


@attrs.frozen(eq=False)
class Outcome:
    """The tracks that one set of sensors led to, and how good each of them is."""

    name: str
    history: PipelineHistory
    scores: tuple[TrackScore, ...]
    position: tuple[int, int] = (0, 1)
    """Places of east and north in the state."""

    def where(self, track: int) -> Array:
        """The path of a track, ``(2, K)``."""
        path: Array = self.history.mean[:, list(self.position), track].T
        return path

    def spread(self, step: int, track: int) -> Array:
        """Covariance of the position, ``(2, 2)``."""
        places = list(self.position)
        cov: Array = self.history.cov[step][np.ix_(places, places)][:, :, track]
        return cov


# ------------------------------------------------------------------------------------ the page
HEAD = (
    "sensors",
    "target",
    "RMSE [m]",
    "NIS (95 % band)",
    "NEES",
    "scans used",
    "time per update",
    "verdict",
)
_LEGEND = (
    "RMSE: root mean square distance between track and truth over all scans. NIS: mean normalised "
    "innovation squared of the scans used, with the band in which it lies if the filter knows its "
    "own uncertainty. NEES: mean normalised error squared of the position against truth; near 2 if "
    "consistent. Time per update: CPU time of a scan for all targets, median."
)


def rows(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """The table of results under `HEAD`, a row for each set and target."""
    return [
        (
            outcome.name,
            score.id,
            f"{score.rmse:.1f}",
            f"{score.nis:.2f} ({score.nis_band.low:.2f} to {score.nis_band.high:.2f})",
            f"{score.nees:.{0 if score.nees >= 100 else 1}f}",
            f"{score.used:.0%}",
            f"{1e6 * score.seconds:.0f} \N{MICRO SIGN}s",
            score.verdict,
        )
        for outcome in outcomes
        for score in outcome.scores
    ]


def findings(outcomes: Sequence[Outcome]) -> list[str]:
    """What the table says, in sentences: who is best, and whose uncertainty is not to be trusted.

    Example:
    >>> findings([])
    []
    """
    said = []
    for track, target in enumerate(outcomes[0].history.ids if outcomes else ()):
        best = min(outcomes, key=lambda one: _ranked(one.scores[track].rmse))
        said.append(
            f"Target {target} is followed best by {best.name}: RMSE {best.scores[track].rmse:.1f} m."
        )
    scored = [(outcome.name, score) for outcome in outcomes for score in outcome.scores]
    said += [f"Target {score.id} from {name}: {score.words}." for name, score in scored]
    if any(score.verdict == "overconfident" for _, score in scored):
        said.append(
            "Where a track is overconfident its error is larger than its ellipses show: do not rely "
            "on them."
        )
    return said


def _ranked(rmse: float) -> float:
    return rmse if np.isfinite(rmse) else np.inf


def tracking_page(
    title: str,
    outcomes: Sequence[Outcome],
    log: DetectionLog,
    *,
    components: Sequence[Sequence[str]],
    notes: Sequence[str] = (),
) -> str:
    """The report: results, findings, pictures, components with their sources, notes.

    ``components`` are rows of role, component, source and origin.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    targets = " and ".join(log.truth)
    maps = [
        page.figure(
            svg(partial(draw_map, outcome, log)),
            f"{outcome.name}: tracks, truth and own ship, with the 95 % ellipse of the position "
            f"{_ELLIPSES} times over the run. An honest ellipse holds the truth of its time 95 times "
            "of 100."
            + (" Thin lines are bearings given to a track." if _bearing_sensors(outcome) else ""),
            f"Map of the tracks of targets {targets} from {outcome.name}",
        )
        for outcome in outcomes
    ]
    sections = [
        (
            "",
            [
                page.text(
                    f"{len(log.scans)} scans of {', '.join(log.sensors)} over "
                    f"{log.scans[-1].t - log.scans[0].t:.0f} s, from a moving platform; targets "
                    f"{targets}, whose true paths are known."
                ),
                page.table(HEAD, rows(outcomes), _LEGEND),
                page.points(findings(outcomes)),
            ],
        ),
        ("Where they went", maps),
        (
            "Error against time",
            [
                page.figure(
                    svg(partial(draw_errors, outcomes, log.truth)),
                    "Distance between track and truth after every scan, on a logarithmic scale.",
                    "Position error of each target over time, a line for each set of sensors",
                )
            ],
        ),
        (
            "Surprise against time",
            [
                page.figure(
                    svg(partial(draw_nis, outcomes)),
                    f"NIS per degree of freedom, over blocks of {_BLOCK} degrees, with the band that "
                    "holds 95 % of the blocks of a filter that knows its own uncertainty. Above the "
                    "band it is overconfident, below it expects more noise than there is. Blocks "
                    "hold only what the gate admitted, so that a lost track may look calm.",
                    "Normalised innovation squared over time with its chi-square band",
                )
            ],
        ),
        *_bearing_section(outcomes, log),
        ("What was used", [page.table(("role", "component", "source", "origin"), components)]),
        ("Notes", [page.points((*notes, *log.notes))]),
    ]
    return page.page(title, sections)


def _bearing_section(
    outcomes: Sequence[Outcome], log: DetectionLog
) -> list[tuple[str, list[page.Markup]]]:
    """The bearing-time plot of every set that has bearings."""
    pictures = [
        page.figure(
            svg(partial(draw_bearings, outcome, log)),
            f"{outcome.name}: every bearing that the cameras reported, in grey; those given to a "
            "track, in its colour; where the targets truly were, as lines. Colour away from its line "
            "was wrongly given, or badly measured.",
            f"Bearings over time and how {outcome.name} used them",
        )
        for outcome in outcomes
        if _bearing_sensors(outcome)
    ]
    return [("Bearings against time", pictures)] if pictures else []


# ------------------------------------------------------------------------------------ pictures
def draw_map(outcome: Outcome, log: DetectionLog) -> Figure:
    """Tracks over the truth, with 95 % ellipses, ownship's path and lines of bearing."""
    from matplotlib.figure import Figure

    history = outcome.history
    picture = Figure(figsize=(_WIDTH, _WIDTH))
    axes = picture.subplots()
    own = log.ownship
    axes.plot(*own.position, color=INK, linewidth=3.0, solid_capstyle="round", label="own ship")
    _draw_lines_of_bearing(axes, outcome, log)
    for track, target in enumerate(history.ids):
        colour = PALETTE[track % len(PALETTE)]
        where = outcome.where(track)
        truth = log.truth[target]
        axes.plot(*truth.position, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), zorder=4)
        axes.plot(*where, color=colour, label=f"track of target {target}", zorder=3)
        for t in np.linspace(history.t[0], history.t[-1], _ELLIPSES + 1)[1:]:
            k = int(np.searchsorted(history.t, t))
            k = min(k, len(history) - 1)
            outline = ellipse(where[:, k], outcome.spread(k, track))
            axes.plot(*outline, color=colour, linewidth=0.8)
            axes.fill(*outline, color=colour, alpha=0.12, linewidth=0)
        begin = truth.position[:, 0]
        axes.plot(*begin, "o", color=INK, markersize=5, zorder=5)
        axes.annotate(
            f"target {target}",
            (float(begin[0]), float(begin[1])),
            xytext=(0, 17 if truth.position[1, -1] < begin[1] else -17),  # not on its own path
            textcoords="offset points",
            ha="center",
            va="center",
            fontweight="bold",
            zorder=6,
        )
    axes.plot([], [], color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="truth, from its dot")
    axes.fill([], [], color=QUIET, alpha=0.4, label="95 % ellipse")
    places = [one.position for one in (*log.truth.values(), own)]
    _frame(axes, np.concatenate([*places, *map(outcome.where, range(len(history.ids)))], axis=1))
    axes.set(xlabel="east [m]", ylabel="north [m]")
    _legend(picture, axes, columns=3)
    return picture


def _draw_lines_of_bearing(axes: Axes, outcome: Outcome, log: DetectionLog) -> None:
    history = outcome.history
    bearing = np.array([SENSOR_KINDS.get(name) == "bearing" for name in history.sensor])
    scans = {(scan.t, scan.sensor): scan for scan in log.scans}
    label: str | None = "line of bearing"
    for track in range(len(history.ids)):
        used = np.flatnonzero(bearing & (history.detection[:, track] >= 0))
        for t in np.linspace(history.t[0], history.t[-1], _LINES_OF_BEARING):
            if not used.size:
                break
            k = int(used[np.abs(history.t[used] - t).argmin()])
            scan = scans[float(history.t[k]), history.sensor[k]]
            angle = float(scan.z[0, history.detection[k, track]])
            eye = log.ownship.at(scan.t)
            reach = 1.1 * float(np.hypot(*(outcome.where(track)[:, k] - eye)))
            tip = eye + reach * np.array([np.sin(angle), np.cos(angle)])
            axes.plot(
                *np.stack([eye, tip], axis=1),
                color=PALETTE[track % len(PALETTE)],
                alpha=0.35,
                linewidth=0.7,
                zorder=1,
                label=label,
            )
            label = None


def _frame(axes: Axes, places: Array) -> None:
    low, high = np.nanmin(places, axis=1), np.nanmax(places, axis=1)
    middle, half = (low + high) / 2.0, 0.56 * float(np.max(high - low)) + 1.0
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")


def draw_errors(outcomes: Sequence[Outcome], truth: Mapping[str, TruthTrack]) -> Figure:
    """Distance between track and truth over time: a panel for each target, a line for each set."""
    from matplotlib.figure import Figure

    targets = outcomes[0].history.ids
    picture = Figure(figsize=(_WIDTH, 0.6 + 2.4 * len(targets)))
    panels = picture.subplots(len(targets), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for track, (axes, target) in enumerate(zip(panels, targets, strict=True)):
        for place, outcome in enumerate(outcomes):
            history = outcome.history
            apart = outcome.where(track) - truth[target].at(history.t)
            axes.plot(
                history.t,
                np.maximum(np.hypot(*apart), 0.1),
                color=_SETS[place % len(_SETS)],
                label=outcome.name,
                linewidth=1.4,
            )
        axes.set_title(f"target {target}")
        axes.set(yscale="log", ylabel="position error [m]")
        _plain_numbers(axes)
    panels[-1].set_xlabel("time [s]")
    _legend(picture, panels[0], columns=len(outcomes))
    return picture


def draw_nis(outcomes: Sequence[Outcome]) -> Figure:
    """Mean NIS per degree of freedom over blocks of equal size, with the band for consistency."""
    from matplotlib.figure import Figure

    picture = Figure(figsize=(_WIDTH, 0.6 + 2.1 * len(outcomes)))
    panels = picture.subplots(len(outcomes), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    band = chi_square_band(_BLOCK, 0.95, per=_BLOCK)
    for axes, outcome in zip(panels, outcomes, strict=True):
        axes.axhspan(band.low, band.high, color=PALETTE[2], alpha=0.18, linewidth=0)
        axes.axhline(1.0, color=PALETTE[2], linewidth=1.0)
        history = outcome.history
        for track, target in enumerate(history.ids):
            axes.plot(
                *_blocks(history.t, history.nis[:, track], history.count[:, track]),
                color=PALETTE[track % len(PALETTE)],
                marker=("o", "s", "^", "D")[track % 4],
                markersize=3.5,
                linewidth=1.0,
                label=f"target {target}",
            )
        axes.set_title(outcome.name)
        axes.set(yscale="log", ylabel="NIS / dof")
        _plain_numbers(axes)
    panels[0].fill([], [], color=PALETTE[2], alpha=0.3, label="95 % of blocks, if consistent")
    panels[-1].set_xlabel("time [s]")
    _legend(picture, panels[0], columns=3)
    return picture


def _blocks(t: Array, nis: Array, count: Array) -> tuple[Array, Array]:
    """Mean time, and sum of NIS by sum of degrees, over consecutive blocks of ``_BLOCK`` degrees."""
    used = np.isfinite(nis) & (count > 0)
    t, nis, count = t[used], nis[used], count[used]
    block = ((np.cumsum(count) - 1) // _BLOCK).astype(np.intp)
    whole = int(count.sum()) // _BLOCK
    times, sums, degrees, members = (
        np.bincount(block, weights, minlength=whole + 1)[:whole]
        for weights in (t, nis, count, np.ones_like(t))
    )
    return times / members, sums / degrees


def draw_bearings(outcome: Outcome, log: DetectionLog) -> Figure:
    """Every bearing over time: those given to a track in its colour, with the true bearings."""
    from matplotlib.figure import Figure

    names = _bearing_sensors(outcome)
    history = outcome.history
    picture = Figure(figsize=(_WIDTH, 0.6 + 3.2 * len(names)))
    panels = picture.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "rasterized": True}
    for axes, name in zip(panels, names, strict=True):
        scans = [scan for scan in log.scans if scan.sensor == name]
        seen = [(scan.t, z) for scan in scans for z in scan.z[0]]
        axes.plot(*_columns(seen), **dots, color=QUIET, markersize=2.0, alpha=0.6, label="not used")
        for track, target in enumerate(history.ids):
            colour = PALETTE[track % len(PALETTE)]
            used = [
                (scan.t, scan.z[0, slot])
                for scan, slot in _given(history, scans, track)
                if slot >= 0
            ]
            axes.plot(
                *_columns(used),
                **dots,
                color=colour,
                markersize=4.0,
                label=f"given to target {target}",
            )
        for target in history.ids:
            t = log.truth[target].t
            east, north = log.truth[target].position - log.ownship.at(t)
            azimuth = np.degrees(np.arctan2(east, north))
            azimuth[1:][np.abs(np.diff(azimuth)) > 180.0] = np.nan  # no line across the cut
            axes.plot(t, azimuth, color=INK, linewidth=1.0, label="true bearing")
            begin = int(np.isfinite(azimuth).argmax())
            axes.annotate(
                target,
                (float(t[begin]), float(azimuth[begin])),
                xytext=(-4, 0),
                textcoords="offset points",
                ha="right",
                va="center",
            )
        axes.set_title(name)
        axes.set(ylabel="azimuth from north [\N{DEGREE SIGN}]")
    panels[-1].set_xlabel("time [s]")
    _legend(picture, panels[0], columns=4)
    return picture


def _bearing_sensors(outcome: Outcome) -> list[str]:
    names = dict.fromkeys(outcome.history.sensor)
    return sorted(name for name in names if SENSOR_KINDS.get(name) == "bearing")


def _given(history: PipelineHistory, scans: Sequence[Any], track: int) -> list[tuple[Any, int]]:
    """Scans of one sensor with the slot that a track was given in each."""
    slots = {
        (float(t), name): int(slot)
        for t, name, slot in zip(
            history.t, history.sensor, history.detection[:, track], strict=True
        )
    }
    return [(scan, slots.get((scan.t, scan.sensor), -1)) for scan in scans]


def _columns(pairs: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    t, z = np.reshape(np.array(pairs, dtype=np.float64), (-1, 2)).T
    return t, np.degrees(np.arctan2(np.sin(z), np.cos(z)))


def _legend(picture: Figure, axes: Axes, *, columns: int) -> None:
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    picture.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper left",
        ncols=columns,
        markerscale=1.5,
    )


def _plain_numbers(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
