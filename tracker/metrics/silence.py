"""Components of which measurements have ceased, or were long missing, in words; what is measured is not judged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np

from tracker.types import Array, History

SHORTEST = 10
"""Steps without a measurement that are worth no words, however rare they were before."""

BY_CHANCE = 1e-3
"""Probability with which measurements that go missing at random are called silent, in a whole run."""


@attrs.frozen(eq=False)
class Silences:
    """For each column of ``measured``: its longest gap, and how long it is silent at the end.

    A gap lies between two measurements. Both are notable, if at all, beside what would go missing by
    chance at the rate of the rest: neither detections at random nor a slow sensor between fast ones
    are silences.

    Shapes:
        each ``(columns,)``: count of measurements; last, the step of the last one; gap, steps in the
        longest gap, which ends before step ``until``; gaps, how many are as notable; ends, whether
        the silence at the end is notable.
    """

    count: Array
    last: Array
    gap: Array
    until: Array
    gaps: Array
    ends: Array

    @classmethod
    def of(cls, measured: Any) -> Silences:
        """Of flags ``(T, columns)``."""
        steps, columns = measured.shape
        place = np.arange(steps)[:, None]
        seen = np.maximum.accumulate(np.where(measured, place, -1))
        before = np.concatenate([np.full((1, columns), -1), seen[:-1]])
        gap = np.where(measured & (before >= 0), place - before - 1, 0)
        count, last = measured.sum(axis=0), seen[-1]
        until, longest = gap.argmax(axis=0), gap.max(axis=0)
        first = np.where(measured, place, steps).min(axis=0)
        # Of the steps from the first to the last but for the longest gap, and less by two standard
        # deviations of the count, lest a few measurements that came together make a rate.
        sure = np.maximum(count - 2.0 * np.sqrt(count), 0.0)
        rate = sure / (np.maximum(last - first + 1 - longest, 0) + 2.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            missing = np.log1p(-np.minimum(rate, 1.0 - 1e-12))
            # Lanes and components that share their gaps are one chance, not many.
            chances = len({row.tobytes() for row in np.packbits(measured, axis=0).T})
            allowed = np.log(BY_CHANCE / max(chances, 1))
            least = np.maximum(SHORTEST, (allowed - np.log(np.maximum(count, 1))) / missing)
        silent = steps - 1 - last
        ends = (silent >= SHORTEST) & (silent > longest) & (silent * missing < allowed)
        gaps = (gap >= least).sum(axis=0)
        return cls(count, last, longest, until, gaps, ends)


def silences(history: History) -> list[str]:
    """Which components were not measured for notably long, and which never: a sentence for each.

    Lanes that diverged are left out: they have no residuals.
    """
    v: Any = np.asarray(history.innovation.residual)
    ok: Any = np.asarray(history.innovation.ok)
    steps = len(v)
    if steps <= SHORTEST or not v.size:
        return []
    ok = ok.reshape(steps, -1).all(axis=0)
    t = np.asarray(history.t, dtype=np.float64).reshape(steps, -1)
    t = np.broadcast_to(t, (steps, ok.size))[:, ok]
    if not ok.any():
        return []
    lanes = f" of {ok.size} lanes" if history.filtered.batch else ""
    columns = [
        (name, ~np.isnan(v[:, j].reshape(steps, -1)[:, ok]) & rows[:, None])
        for name, j, rows in _columns(history)
    ]
    found = Silences.of(np.concatenate([flags for _, flags in columns], axis=1))
    # The same words for several components are one sentence.
    said: dict[str, list[str]] = {}
    for k, (name, flags) in enumerate(columns):
        width = flags.shape[1]
        mine = slice(k * width, (k + 1) * width)
        one = Silences(*(getattr(found, f.name)[mine] for f in attrs.fields(Silences)))
        for words in _words(one, t, steps, lanes):
            said.setdefault(words, []).append(name)
    every = [name for name, _ in columns]
    return [f"{_listed(names, every)}: {words}." for words, names in said.items()]


def _columns(history: History) -> Iterator[tuple[str, int, Any]]:
    """Name, place in the residual, and rows of each component of each sensor."""
    v = history.innovation.residual
    whole = np.ones(len(v), dtype=bool)
    if history.run is None:
        for j in range(v.shape[1]):
            yield f"component {j}", j, whole
        return
    sensors, which = history.run.estimator.sensors, history.run.record.sensor
    for i, sensor in enumerate(sensors):
        rows = whole if which is None else np.asarray(which) == i
        if which is None and i:
            return  # all rows are the first one's
        of = f" of sensor {i}" if len(sensors) > 1 else ""
        for j, name in enumerate(sensor.space.names):
            yield f"component {name!r}{of}", j, rows


def _words(found: Silences, t: Array, steps: int, lanes: str) -> Iterator[str]:
    """What is to be said of a component, over its lanes."""
    every = len(found.count)

    def in_(flags: Any) -> str:
        some = int(flags.sum())
        return f" in {some}{lanes}" if some < every else ""

    never = found.count == 0
    if never.any():
        yield f"never measured{in_(never)}"
    if found.ends.any():
        lane = int(np.where(found.ends, found.last, steps).argmin())
        last = int(found.last[lane])
        yield (
            f"last measured at t={t[last, lane]:.6g}, {steps - 1 - last} of {steps} steps before the end"
            f"{in_(found.ends)}; estimates since then rest on the motion model and on what else is measured"
        )
    if found.gaps.any():
        lane = int(np.where(found.gaps > 0, found.gap, -1).argmax())
        until, gap = int(found.until[lane]), int(found.gap[lane])
        more = int(found.gaps[lane]) - 1
        yield (
            f"not measured for {gap} steps in a row (t={t[until - gap, lane]:.6g} to "
            f"{t[until - 1, lane]:.6g}){_again(more)}{in_(found.gaps > 0)}"
        )


def _again(more: int) -> str:
    if more < 1:
        return ""
    return ", and so once more" if more == 1 else f", and so {more} times more"


def _listed(names: list[str], every: list[str]) -> str:
    if len(names) == len(every) > 1:
        return "all components"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
