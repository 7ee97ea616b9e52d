"""A run's state of health in words: is it consistent, are its innovations white, what can it not see.

The numbers come from `consistency` and `observability`; a campaign, which knows the truth, words its
own in `tracker.montecarlo`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.errors import TrackerError
from tracker.metrics.consistency import Band, Whiteness, chi_square_band, whiteness
from tracker.metrics.observability import (
    LITTLE,
    Observability,
    blind_spots,
    noise_free_path,
    observability,
)
from tracker.metrics.silence import silences
from tracker.recursion import unseen
from tracker.types import History

FALSE_ALARM = 1e-3
"""Probability with which a matched filter is warned of, for NIS and for whiteness, by chance alone."""

MATTERS = 0.05
"""Deviations of NIS from one, and correlations, that are worth no warning however certain they are."""

LOOKED_AT = 8
"""Lanes whose observability is looked at."""


def nis_of(history: History) -> tuple[float, Band]:
    """NIS divided by its degrees of freedom, over all finite steps and lanes, and its band."""
    told = history.innovation
    good = np.asarray(told.ok) & np.isfinite(told.nis)
    degrees = float(np.where(good, told.count, 0.0).sum())
    band = chi_square_band(degrees, 1.0 - FALSE_ALARM, per=max(degrees, 1.0))
    return (float(np.where(good, told.nis, 0.0).sum()) / degrees if degrees else np.nan), band


def observability_of(history: History) -> Observability | None:
    """Along noise-free paths that end in some lanes' last estimates; None if the models do not tell.

    A history remembers the record and the estimator it came from (`tracker.types.Run`).
    """
    run = history.run
    if run is None or not history.filtered.mean.size:
        return None
    batch, built = history.filtered.batch, run.estimator
    index: Any = None
    if batch:
        index = np.unique(np.linspace(0, batch[-1] - 1, min(LOOKED_AT, batch[-1])).astype(int))
        built = built.lanes(index)

    def some(values: Any, lead: int) -> Any:
        whole = index is None or values is None or np.ndim(values) <= lead
        return values if whole else values[..., index]

    t, u, pose = some(history.t, 1), some(history.u, 2), some(run.record.pose, 2)
    ends = some(history.filtered.mean, 2)
    try:
        path = noise_free_path(built.motion, t, ends, u)
        return observability(
            built.motion,
            built.sensors,
            t,
            path,
            some(history.predicted.cov[0], 2),
            pose=pose,
            sensor=run.record.sensor,
            measured=~np.isnan(some(run.record.z, 2)),
            u=u,
        )
    except (TrackerError, AttributeError, TypeError, ValueError):
        return None  # no derivatives, or a model that does not take many times at once


def warnings(history: History) -> list[str]:
    """What a person should be told before trusting a run; empty if nothing."""
    out = _gone(history)
    nis, band = nis_of(history)
    word = band.verdict(nis)
    if word in {"overconfident", "underconfident"} and abs(nis - 1.0) > MATTERS:
        than = "larger" if word == "overconfident" else "smaller"
        out.append(
            f"{word}: mean NIS is {nis:.3g} times its degrees of freedom, outside "
            f"[{band.low:.3g}, {band.high:.3g}]: innovations are {than} than the filter thinks."
        )
    white = whiteness(history.innovation).together
    size = float(
        np.max(np.abs(white.correlations), where=np.isfinite(white.correlations), initial=0.0)
    )
    if white.probability < FALSE_ALARM and size > MATTERS:
        next_step = float(white.correlations[0])
        hint = (
            "the motion is more restless than its noise says, or the sensor is biased"
            if next_step > 0
            else "the filter follows noise: its process noise is too large, or R too small"
        )
        out.append(
            f"innovations are not white: correlation {next_step:+.2f} from step to step (chance: "
            f"{float(white.probability):.1g}): {hint}."
        )
    return out + silences(history) + _approximated(history) + blind_spots(observability_of(history))


def _gone(history: History) -> list[str]:
    """Lanes that are no longer ok: those that an update has rounded away, and those that diverged."""
    ok = np.asarray(history.innovation.ok)
    if ok.all():
        return []
    flat = ok.reshape(len(ok), -1)
    lanes = np.flatnonzero(~flat.all(axis=0))
    first = (~flat[:, lanes]).argmax(axis=0)

    def finite(values: Any) -> Any:
        whole = np.asarray(values).reshape(*flat.shape[:1], -1, flat.shape[1])
        return np.isfinite(whole[first, :, lanes]).all(axis=1)

    # A finite prediction and covariance, and an update that disowns its estimate: see `condition`.
    before, after = history.predicted, history.filtered
    rounded = finite(before.mean) & finite(before.cov) & finite(after.cov) & ~finite(after.mean)
    digits = (
        "lost all digits: an update, first at step {}, left nothing but rounding of a variance. Use "
        "filter 'ekf1_joseph' or 'square_root', or a prior that is not so vague beside R."
    )
    diverged = (
        "diverged: no longer finite, first at step {}. Look at the record and the prior there, or use "
        "a filter that bears more nonlinearity."
    )
    out = []
    for which, words in ((rounded, digits), (~rounded, diverged)):
        if which.any():
            what = f"{int(which.sum())} of {flat.shape[1]} lanes" if ok.ndim > 1 else "the run"
            out.append(f"{what} " + words.format(int(first[which].min())))
    return out


def _approximated(history: History) -> list[str]:
    """What the smoother did not see of the filter's beliefs."""
    if history.run is None or history.smoothed is None:
        return []
    built = history.run.estimator
    words = unseen(built.filter, built.motion, built.smoother)
    return [words] if words else []


SINGULAR = 1e12
"""A condition number of information above this owes most of its digits to rounding."""


def summary(history: History) -> str:
    """The state of health of a run: numbers, and below them what a person should conclude."""
    batch = history.filtered.batch
    kind = "filtered" if history.smoothed is None else "filtered and smoothed"
    lanes = f", lanes {batch}" if batch else ""
    n = history.filtered.mean.shape[1]
    nis, band = nis_of(history)
    white = whiteness(history.innovation).together
    lines = [
        f"History: {len(history)} steps, {n} states{lanes}, {kind}",
        f"NIS / m        {nis:.4g} [{band.low:.4g}, {band.high:.4g}] {band.verdict(nis)}",
        f"innovations    {_coloured(white)}",
        f"observability  {_seen(observability_of(history), history)}",
    ]
    return "\n".join(lines + [f"Warning: {words}" for words in warnings(history)])


def _coloured(white: Whiteness) -> str:
    if not white.degrees > 0:
        return "unknown: no two that could be compared"
    chance = f"probability {float(white.probability):.2g} if white"
    return f"correlation {float(white.correlations[0]):+.3f}, {chance}"


def _seen(found: Observability | None, history: History) -> str:
    if found is None:
        if not history.filtered.mean.size:
            return "unknown: nothing was filtered"
        return "unknown: no record, or models without derivatives"
    known = found.ratios[0][np.isfinite(found.ratios[0])]
    least = float(np.median(known)) if known.size else np.nan
    full = len(found.ratios)
    seen = f"rank {int(np.median(found.rank))} of {full}, condition number {_condition(found)}"
    if least < LITTLE:
        few = full - int(np.median(found.rank))
        blind = f"{few} directions" if few > 1 else "one direction"
        return f"{seen}; of {blind} the record says next to nothing"
    return f"{seen}; {least:.3g} times as much as the prior of the direction that is seen least"


def _condition(found: Observability) -> str:
    """The median over the lanes; with more digits than a float has, none of it is known."""
    finite_ones = np.where(np.isnan(found.condition), np.inf, found.condition)
    value = float(np.median(finite_ones))
    return f"{value:.2g}" if value < SINGULAR else f"above {SINGULAR:.0e}".replace("e+", "e")
