"""Laws of smoothers, on histories that the textbook filter left on small linear problems."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.testing import textbook
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law, not_negative, symmetric
from tracker.testing.laws.filter import Traced
from tracker.testing.strategies import covariances
from tracker.testing.textbook import MOTION, Problem
from tracker.types import Array, Gaussian, History

_REACH = np.array([100.0, 100.0, 10.0, 10.0])


def _problem(
    case: Case, batch: tuple[int, ...] = (), steps: int = 6, *, pauses: bool = True
) -> Problem:
    """Uneven times, some equal where ``pauses``; some measurements missing."""
    gaps = case.rng.uniform(0.1, 2.0, steps)
    if pauses:
        gaps = gaps * case.rng.choice([0.0, 1.0, 1.0], steps)
    mean = _REACH.reshape(4, *(1,) * len(batch)) * case.rng.standard_normal((4, *batch))
    z = 100.0 * case.rng.standard_normal((steps, 2, *batch))
    z[case.rng.uniform(size=z.shape) < 0.2] = np.nan
    return Problem(mean, case.draw(covariances(4, batch, _REACH, 3.0)), np.cumsum(gaps), z)


def _smoothed(rule: Any, history: History) -> tuple[Array, Array]:
    out = rule.smooth(history, MOTION).smoothed
    assert out is not None, "smooth leaves the history without its smoothed trajectory"
    return out.mean, out.cov


def _call(rule: Any, *arrays: Any) -> tuple[Any, ...]:
    return _smoothed(rule, textbook.history(*arrays))


@calls_of("smoother")
def smoother_calls(_rule: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a smoother is called."""
    past = _problem(case, batch).filtered()
    given = (
        Given("t", past.t, None),
        Given("predicted.mean", past.predicted.mean, 2),
        Given("predicted.cov", past.predicted.cov, 3),
        Given("filtered.mean", past.filtered.mean, 2),
        Given("filtered.cov", past.filtered.cov, 3),
    )
    return [Call("smooth", _call, given, (2, 3), batch)]


@law("smoother", name="last step equals the filter")
def last_step(rule: Any, case: Case) -> None:
    """At the end of the record there is no future: the smoothed moments are the filtered ones."""
    for batch, steps in (((), 6), ((3,), 6), ((3,), 1)):
        past = _problem(case, batch, steps).filtered()
        mean, cov = _smoothed(rule, past)
        told = f"the smoothed {{}} of the last of {steps} steps differs from the filtered one"
        agree(mean[-1], past.filtered.mean[-1], 1e-12, told.format("mean"))
        agree(cov[-1], past.filtered.cov[-1], 1e-12, told.format("covariance"))


@law("smoother", name="equals batch least squares")
def equals_batch_least_squares(rule: Any, case: Case) -> None:
    """On a linear problem the result is the least-squares solution of all steps at once, to 1e-8."""
    for batch in ((), (3,)):
        problem = _problem(case, batch, pauses=False)
        mean, cov = _smoothed(rule, problem.filtered())
        for lane in np.ndindex(*batch):
            x, P = problem.lane(lane).batch_least_squares()
            sigma = np.sqrt(np.einsum("kii->ki", P))
            told = "the smoothed {} differs from the least-squares solution of the whole record"
            size = np.abs(x).max(axis=0) + sigma.max(axis=0)
            agree(mean[(..., *lane)], x, 1e-8, told.format("mean"), scale=size)
            worst = np.einsum("kii->ki", problem.lane(lane).filtered().predicted.cov) ** 0.5
            agree(cov[(..., *lane)], P, 1e-8, told.format("covariance"),
                  scale=worst[:, :, None] * worst[:, None])  # fmt: skip


@law("smoother", name="never above the filter")
def never_above(rule: Any, case: Case) -> None:
    """Knowing the future takes uncertainty away: filtered minus smoothed covariance is not negative."""
    past = _problem(case, (3,)).filtered()
    cov = _smoothed(rule, past)[1]
    for before, after in zip(past.filtered.cov, cov, strict=True):
        told = "a smoothed covariance is above the filtered one"
        not_negative(before - after, told, np.abs(before).max(), 1e-10)


@law("smoother", name="covariance is a covariance")
def covariance_is_a_covariance(rule: Any, case: Case) -> None:
    """Smoothed covariances are exactly symmetric and positive semi-definite."""
    for batch in ((), (3,)):
        past = _problem(case, batch).filtered()
        for before, after in zip(past.predicted.cov, _smoothed(rule, past)[1], strict=True):
            symmetric(after, "a smoothed covariance is not exactly symmetric")
            told = "a smoothed covariance is not positive semi-definite"
            not_negative(after, told, np.abs(before).max(), 1e-10)


@law("smoother", name="a diverged lane harms no neighbour")
def diverged_lane(rule: Any, case: Case) -> None:
    """A lane that has become NaN leaves the other lanes exactly as they are without it."""
    past = _problem(case, (3,)).filtered()
    arrays = [past.predicted.mean, past.predicted.cov, past.filtered.mean, past.filtered.cov]
    ill = [a.copy() for a in arrays]
    for a in ill:
        a[2:, ..., 1] = np.nan
    for a, b in zip(_call(rule, past.t, *arrays), _call(rule, past.t, *ill), strict=True):
        same = np.array_equal(a[..., [0, 2]], b[..., [0, 2]])
        assert same, "a lane of NaN changes what its neighbours get"


@law("smoother", name="keeps the history")
def keeps_the_history(rule: Any, case: Case) -> None:
    """The history that comes back holds what the filter left, and the smoothed moments beside it."""
    past = _problem(case, (3,)).filtered()
    out = rule.smooth(past, MOTION)
    assert past.smoothed is None, "smooth changes the history that it was given"
    for name in ("predicted", "filtered"):
        told = f"smooth changes the {name} moments"
        agree(getattr(out, name).mean, getattr(past, name).mean, 0.0, told)
        agree(getattr(out, name).cov, getattr(past, name).cov, 0.0, told)
    agree(out.t, past.t, 0.0, "smooth changes the times")


def _no_step(rule: Any) -> str:
    why = getattr(rule, "why_opaque", "")
    if why:
        return f"it cannot be traced: {why}"
    return "" if hasattr(rule, "step") else "it has no step that could be traced alone"


def _stepped(rule: Any, filtered: Gaussian, predicted: Gaussian, later: Gaussian, dt: Any) -> Any:
    belief = rule.begin(later) if hasattr(rule, "begin") else later
    return rule.step(filtered, predicted, belief, MOTION, dt).moments()


@law("smoother", name="interpretations agree", unless=_no_step)
def interpretations_agree(rule: Any, case: Case) -> None:
    """A step gives the same, to 1e-9, on lanes, on one run, and on graph nodes."""
    past = _problem(case, (), 2, pauses=False).filtered()
    dt = float(past.t[1] - past.t[0])
    parts = (past.filtered.at(0), past.predicted.at(1), past.filtered.at(1))
    one = _stepped(rule, *parts, dt)
    spread = [Gaussian.trusted(p.mean[:, None], p.cov[..., None]) for p in parts]
    several = _stepped(rule, *spread, dt)
    traced = Traced()
    inputs = [traced.gaussian(p, name) for p, name in zip(parts, "abc", strict=True)]
    nodes = _stepped(rule, *inputs, traced.vector("dt", [dt])[0])
    for name in ("mean", "cov"):
        told = f"a step: the {name} on {{}} differs from that of one run"
        agree(getattr(several, name)[..., 0], getattr(one, name), 1e-9, told.format("lanes"))
        agree(
            traced.worth(getattr(nodes, name)), getattr(one, name), 1e-9, told.format("graph nodes")
        )
