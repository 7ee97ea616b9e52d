"""Laws of smoothers, on histories that a filter left on small linear problems.

The filter is the textbook one, or the one whose beliefs the smoother says it ``follows``.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.testing import textbook
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law, not_negative, symmetric
from tracker.testing.laws.filter import Traced, begun
from tracker.testing.strategies import covariances
from tracker.testing.textbook import MOTION, POSITION, Problem
from tracker.types import Array, Beliefs, Gaussian, History

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


def _filter_of(rule: Any) -> Any:
    """The filter whose beliefs a smoother needs, or None where moments are enough."""
    from tracker.registry import default_registry

    name = getattr(rule, "follows", "")
    return default_registry().get("filter", name).make() if name else None


def _past(rule: Any, problem: Problem) -> History:
    """What is to be smoothed: a filter's moments, with its beliefs where the smoother needs them."""
    chosen = _filter_of(rule)
    if chosen is None:
        return problem.filtered()
    belief = begun(chosen, Gaussian.trusted(problem.mean, problem.cov))
    pairs = []
    for k, z in enumerate(problem.z):
        before = belief
        if k:
            before = chosen.predict(belief, MOTION, float(problem.t[k] - problem.t[k - 1]))
        belief, _ = chosen.update(before, POSITION, z)
        pairs.append((before, belief))
    moments = [[belief.moments() for belief in whens] for whens in zip(*pairs, strict=True)]
    told = (
        np.stack([getattr(m, name) for m in one]) for one in moments for name in ("mean", "cov")
    )
    beliefs = Beliefs(*zip(*pairs, strict=True))
    return attrs.evolve(textbook.history(problem.t, *told), beliefs=beliefs)


def _matched(case: Case, steps: int = 6) -> Problem:
    """Runs of the textbook's own motion and sensor, over which means can be taken.

    Steps are long: their noise must be as wide as an estimate, or few particles lead to any other.
    """
    sigma, dt = np.array([4.0, 4.0, 2.0, 2.0]), 4.0
    noise = case.rng.standard_normal((2 * steps, 4, _RUNS))
    mean = 100.0 * case.rng.standard_normal((4, _RUNS))
    x, rows = mean + sigma[:, None] * noise[0], []
    for k in range(steps):
        if k:
            x = textbook.F(dt) @ x + np.linalg.cholesky(textbook.Q(dt)) @ noise[k]
        rows.append(textbook.H @ x + np.sqrt(textbook.R) @ noise[steps + k, :2])
    cov: Array = np.repeat(np.diag(sigma**2)[..., None], _RUNS, axis=2)
    return Problem(mean, cov, dt * np.arange(float(steps)), np.stack(rows))


_RUNS = 30
_MOST = 5.5
"""Standard errors, as known from so many runs, that an average may be off: 6e-6 of a Student's distribution
lie beyond, so that a law which looks at 48 averages fails falsely once in 3000 examples; these are fixed."""


def _off(values: Array) -> tuple[Array, Array]:
    """The means of values over runs, the last axis, and their standard errors."""
    return values.mean(axis=-1), values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])


def _draws(rule: Any) -> str:
    few = (
        "it follows a filter that draws random numbers: true of infinitely many draws, not of these"
    )
    return few if getattr(_filter_of(rule), "random", False) else ""


def _draws_not(rule: Any) -> str:
    return "" if _draws(rule) else "it draws nothing: this is true of every run"


def _smoothed(rule: Any, history: History) -> tuple[Array, Array]:
    out = rule.smooth(history, MOTION).smoothed
    assert out is not None, "smooth leaves the history without its smoothed trajectory"
    return out.mean, out.cov


def _call(rule: Any, *arrays: Any) -> tuple[Any, ...]:
    return _smoothed(rule, textbook.history(*arrays))


def _run(rule: Any, t: Array, mean: Array, cov: Array, z: Array) -> tuple[Any, ...]:
    return _smoothed(rule, _past(rule, Problem(mean, cov, t, z)))


@calls_of("smoother")
def smoother_calls(rule: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a smoother is called."""
    problem = _problem(case, batch)
    if _filter_of(rule) is not None:
        whole = (
            Given("t", problem.t, None),
            Given("mean", problem.mean, 1),
            Given("cov", problem.cov, 2),
            Given("z", problem.z, 2),
        )
        return [Call("filter, then smooth", _run, whole, (2, 3), batch)]
    past = problem.filtered()
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
        past = _past(rule, _problem(case, batch, steps))
        mean, cov = _smoothed(rule, past)
        told = f"the smoothed {{}} of the last of {steps} steps differs from the filtered one"
        agree(mean[-1], past.filtered.mean[-1], 1e-12, told.format("mean"))
        agree(cov[-1], past.filtered.cov[-1], 1e-12, told.format("covariance"))


@law("smoother", name="equals batch least squares", unless=_draws)
def equals_batch_least_squares(rule: Any, case: Case) -> None:
    """On a linear problem the result is the least-squares solution of all steps at once, to 1e-9."""
    for batch in ((), (7,), (3, 5)):
        problem = _problem(case, batch, pauses=False)
        mean, cov = _smoothed(rule, problem.filtered())
        for lane in np.ndindex(*batch):
            x, P = problem.lane(lane).batch_least_squares()
            sigma = np.sqrt(np.einsum("kii->ki", P))
            told = "the smoothed {} differs from the least-squares solution of the whole record"
            size = np.abs(x).max(axis=0) + sigma.max(axis=0)
            agree(mean[(..., *lane)], x, 1e-9, told.format("mean"), scale=size)
            worst = np.einsum("kii->ki", problem.lane(lane).filtered().predicted.cov) ** 0.5
            agree(cov[(..., *lane)], P, 1e-9, told.format("covariance"),
                  scale=worst[:, :, None] * worst[:, None])  # fmt: skip


@law("smoother", name="equals batch least squares on average", examples=2, unless=_draws_not)
def equals_least_squares_on_average(rule: Any, case: Case) -> None:
    """On a linear problem means and variances are, on average over 30 runs, those of batch least squares,
    to 5.5 standard errors.
    """
    problem = _matched(case)
    mean, cov = _smoothed(rule, _past(rule, problem))
    gaps = np.empty((2, *mean.shape))
    for run in range(_RUNS):
        x, P = problem.lane((run,)).batch_least_squares()
        square = np.einsum("kii->ki", P)
        gaps[0, ..., run] = (mean[..., run] - x) / np.sqrt(square)
        gaps[1, ..., run] = np.einsum("kii->ki", cov[..., run]) / square - 1.0
    for name, gap in zip(("means", "variances"), gaps, strict=True):
        average, error = _off(gap)
        assert error.max() < 0.2, f"the smoothed {name} scatter too much to say anything of them"
        worst = np.unravel_index(np.argmax(np.abs(average) / error), average.shape)
        assert abs(average[worst]) < _MOST * error[worst], (
            f"on average over {_RUNS} runs the smoothed {name} differ from the least-squares solution "
            f"of the whole record (by {average[worst]:.3g}, with a standard error of {error[worst]:.2g})"
        )


@law("smoother", name="never above the filter", unless=_draws)
def never_above(rule: Any, case: Case) -> None:
    """Knowing the future takes uncertainty away: filtered minus smoothed covariance is not negative."""
    past = _problem(case, (3,)).filtered()
    cov = _smoothed(rule, past)[1]
    for before, after in zip(past.filtered.cov, cov, strict=True):
        told = "a smoothed covariance is above the filtered one"
        not_negative(before - after, told, np.abs(before).max(), 1e-10)


@law("smoother", name="never above the filter on average", examples=2, unless=_draws_not)
def never_above_on_average(rule: Any, case: Case) -> None:
    """On average over 30 runs no variance is above the filtered one, by more than 5.5 standard errors, and
    some are below.
    """
    past = _past(rule, _matched(case))
    less = np.einsum("kii...->ki...", past.filtered.cov - _smoothed(rule, past)[1])[:-1]
    average, error = _off(less)
    told = "on average smoothed variances are above the filtered ones"
    assert (average > -_MOST * error).all(), told
    assert (average[0] > _MOST * error[0]).any(), "on average the future takes no uncertainty away"


@law("smoother", name="covariance is a covariance")
def covariance_is_a_covariance(rule: Any, case: Case) -> None:
    """Smoothed covariances are exactly symmetric and positive semi-definite."""
    for batch in ((), (3,)):
        past = _past(rule, _problem(case, batch))
        for before, after in zip(past.predicted.cov, _smoothed(rule, past)[1], strict=True):
            symmetric(after, "a smoothed covariance is not exactly symmetric")
            told = "a smoothed covariance is not positive semi-definite"
            not_negative(after, told, np.abs(before).max(), 1e-10)


@law("smoother", name="a diverged lane harms no neighbour")
def diverged_lane(rule: Any, case: Case) -> None:
    """A lane that has become NaN leaves the other lanes exactly as they are without it."""
    (call,) = smoother_calls(rule, case, (3,))
    well = [one.value for one in call.given]
    ill = [value if one.lead is None else np.array(value)
           for one, value in zip(call.given, well, strict=True)]  # fmt: skip
    for value, one in zip(ill, call.given, strict=True):
        if one.lead is not None:  # over time from the third step on, a prior from the start
            value[(slice(2 if len(value) > 4 else 0, None), ..., 1)] = np.nan
    for a, b in zip(call.make(rule, well), call.make(rule, ill), strict=True):
        same = np.array_equal(a[..., [0, 2]], b[..., [0, 2]])
        assert same, "a lane of NaN changes what its neighbours get"


@law("smoother", name="keeps the history")
def keeps_the_history(rule: Any, case: Case) -> None:
    """The history that comes back holds what the filter left, and the smoothed moments beside it."""
    past = _past(rule, _problem(case, (3,)))
    copy = pickle.loads(pickle.dumps(past.beliefs))  # noqa: S301 - our own bytes
    out = rule.smooth(past, MOTION)
    assert pickle.dumps(copy) == pickle.dumps(past.beliefs), "smooth changes the beliefs"
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


def _stepped(rule: Any, moments: Sequence[Gaussian], dt: Any) -> Any:
    filtered, predicted, later = moments
    belief = rule.begin(later) if hasattr(rule, "begin") else later
    return rule.step(filtered, predicted, belief, MOTION, dt).moments()


@law("smoother", name="interpretations agree", unless=_no_step)
def interpretations_agree(rule: Any, case: Case) -> None:
    """A step gives the same, to 1e-9, on lanes, on one run, and on graph nodes."""
    past = _problem(case, (), 2, pauses=False).filtered()
    dt = float(past.t[1] - past.t[0])
    parts = (past.filtered.at(0), past.predicted.at(1), past.filtered.at(1))
    one = _stepped(rule, parts, dt)
    spread = [Gaussian.trusted(p.mean[:, None], p.cov[..., None]) for p in parts]
    several = _stepped(rule, spread, dt)
    traced = Traced()
    inputs = [traced.gaussian(p, name) for p, name in zip(parts, "abc", strict=True)]
    nodes = _stepped(rule, inputs, traced.vector("dt", [dt])[0])
    for name in ("mean", "cov"):
        told = f"a step: the {name} on {{}} differs from that of one run"
        agree(getattr(several, name)[..., 0], getattr(one, name), 1e-9, told.format("lanes"))
        agree(
            traced.worth(getattr(nodes, name)), getattr(one, name), 1e-9, told.format("graph nodes")
        )
