"""Filters that carry information or a root: equal to the others, and better where those give up."""

import itertools
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import tracker as tk
from tracker.models import ComponentMotion, ComponentSensor
from tracker.types import Array
from tracker_kalman import InformationFilter, KalmanFilter, SquareRootFilter
from tracker_motion import constant_velocity, coordinated_turn
from tracker_sensors import azimuth, position, range_only, stack

MOTION = constant_velocity(0.1)
BEARINGS = stack([azimuth(0.02).at(sx=-1.0, sy=-2.0), azimuth(0.02).at(sx=1.0, sy=1.0)])
PRIOR = tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))


def a_record(steps: int, batch: tuple[int, ...], missing: bool = False) -> tk.Record:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.choice([0.0, 0.1, 0.3], steps))  # uneven, some at the same time
    x = np.stack([0.3 * t, 0.1 * t, 0 * t + 0.3, 0 * t + 0.1])
    z = BEARINGS.h(x).T.reshape(steps, 2, *(1,) * len(batch))
    z = z + 0.02 * rng.standard_normal((steps, 2, *batch))
    if missing:
        z[rng.uniform(size=z.shape) < 0.3] = np.nan
    return tk.Record(t, z)


@pytest.mark.parametrize("name", ["information", "square_root"])
@pytest.mark.parametrize("batch", [(), (1,), (7,), (3, 5)])
@pytest.mark.parametrize("missing", [False, True])
def test_it_is_the_extended_filter(name: str, batch: tuple[int, ...], missing: bool) -> None:
    record = a_record(15, batch, missing)
    found = [
        tk.smooth(tk.estimator(rule, motion=MOTION, sensor=BEARINGS, smoother="rts"), record, PRIOR)
        for rule in ("ekf1", name)
    ]
    for part in ("predicted", "filtered", "smoothed"):
        a, b = (getattr(history, part) for history in found)
        np.testing.assert_allclose(b.mean, a.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(b.cov, a.cov, rtol=0, atol=1e-9)
    for score in ("nis", "loglik", "count", "residual", "S"):
        a, b = (getattr(history.innovation, score) for history in found)
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-8)
    assert found[1].innovation.ok.all()


@pytest.mark.parametrize("name", ["information", "square_root"])
def test_nonlinear_motion_is_linearised_alike(name: str) -> None:
    motion = coordinated_turn(0.1, 1e-3)
    prior = tk.Gaussian([0.0, 0.0, 1.0, 0.0, 0.3], np.diag([0.1, 0.1, 1.0, 1.0, 0.1]))
    rng = np.random.default_rng(8)
    record = tk.Record(0.5 * np.arange(1, 20), rng.standard_normal((19, 2, 4)))
    found = [
        tk.filter(tk.estimator(rule, motion=motion, sensor=position(0.5)), record, prior).filtered
        for rule in ("ekf1", name)
    ]
    np.testing.assert_allclose(found[1].mean, found[0].mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found[1].cov, found[0].cov, rtol=0, atol=1e-8)


def test_a_belief_of_its_own_kind_may_go_on() -> None:
    record = a_record(10, ())
    for name, rule in (("information", InformationFilter()), ("square_root", SquareRootFilter())):
        estimator = tk.estimator(name, motion=MOTION, sensor=BEARINGS)
        belief: Any = rule.begin(PRIOR)
        assert rule.begin(belief) is belief
        before = record.t[0]
        for t, z in zip(record.t, record.z, strict=True):
            belief, _ = estimator.step(belief, z, float(t - before))
            before = t
        end = tk.filter(estimator, record, PRIOR).filtered
        np.testing.assert_allclose(belief.moments().mean, end.mean[-1], atol=1e-11)
        np.testing.assert_allclose(belief.moments().cov, end.cov[-1], atol=1e-11)


# ------------------------------------------------------------------------------- information
NOTHING = InformationFilter(unknown=("x", "y", "vx", "vy"))


def least_squares(t: Array, z: Array, density: float, sigma: float) -> tuple[Array, Array]:
    """State at the last time from positions alone, all states at once, without any prior."""
    steps = len(t)
    rows, targets = [], []
    motion = constant_velocity(density)
    for k in range(steps):
        if k:
            dt = float(t[k] - t[k - 1])
            root = np.linalg.cholesky(motion.Q(np.zeros(4), dt))
            block = np.zeros((4, 4 * steps))
            block[:, 4 * k - 4 : 4 * k] = -motion.jacobian(np.zeros(4), dt)
            block[:, 4 * k : 4 * k + 4] = np.eye(4)
            rows.append(np.linalg.solve(root, block))
            targets.append(np.zeros(4))
        seen = ~np.isnan(z[k])
        block = np.zeros((2, 4 * steps))
        block[0, 4 * k] = block[1, 4 * k + 1] = 1.0 / sigma
        rows.append(block[seen])
        targets.append(z[k][seen] / sigma)
    q, r = np.linalg.qr(np.concatenate(rows))
    half = np.linalg.solve(r, np.eye(4 * steps))
    return (half @ q.T @ np.concatenate(targets))[-4:], (half @ half.T)[-4:, -4:]


@pytest.mark.parametrize("batch", [(), (1,), (3,)])
def test_from_nothing_it_is_the_least_squares_solution(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(12)
    t = np.array([1.0, 2.0, 4.0, 4.5, 7.0])
    z = 5.0 * rng.standard_normal((5, 2, *batch))
    z[1, 0] = np.nan
    estimator = tk.estimator(NOTHING, motion=MOTION, sensor=position(0.3))
    history = tk.filter(estimator, tk.Record(t, z), PRIOR)
    for lane in np.ndindex(*batch):
        mean, cov = least_squares(t, z[(..., *lane)], 0.1, 0.3)
        np.testing.assert_allclose(history.filtered.mean[(-1, ..., *lane)], mean, atol=1e-9)
        np.testing.assert_allclose(history.filtered.cov[(-1, ..., *lane)], cov, atol=1e-9)


def test_until_every_component_is_determined_it_does_not_claim_to_know() -> None:
    t = np.array([1.0, 2.0, 3.0])
    z = np.array([[1.0, 2.0], [2.0, 2.5], [3.0, 3.0]])
    estimator = tk.estimator(NOTHING, motion=MOTION, sensor=position(0.3))
    history = tk.filter(estimator, tk.Record(t, z), PRIOR)
    assert np.isnan(history.filtered.mean[0]).any(), "one position does not tell the velocity"
    assert not history.innovation.ok[0]
    assert np.isfinite(history.filtered.mean[1:]).all(), "two positions do"
    assert history.innovation.ok[2]


def test_a_prior_may_tell_of_some_components_only() -> None:
    """Unknown velocities equal those of a prior that is as vague as numbers allow."""
    rng = np.random.default_rng(13)
    record = tk.Record(np.array([0.0, 1.0, 3.0]), rng.standard_normal((3, 2, 4)))
    vague = tk.Gaussian(PRIOR.mean, np.diag([0.1, 0.1, 1e7, 1e7]))
    found = [
        tk.filter(tk.estimator(rule, motion=MOTION, sensor=position(0.3)), record, prior).filtered
        for rule, prior in (
            (InformationFilter(unknown=["vx", "vy"]), PRIOR),
            ("ekf1_joseph", vague),
        )
    ]
    np.testing.assert_allclose(found[0].mean[-1], found[1].mean[-1], atol=1e-6)
    np.testing.assert_allclose(found[0].cov[-1], found[1].cov[-1], atol=1e-6)


def test_certainty_cannot_be_turned_into_information() -> None:
    """A lane with a singular covariance is NaN and not ok; the lane beside it is as without it."""
    cov = np.stack([PRIOR.cov, np.diag([0.0, 0.1, 1.0, 1.0])], axis=-1)
    mean = np.repeat(PRIOR.mean[:, None], 2, axis=1)
    rule = InformationFilter()
    z = np.array([[1.2, 1.2], [-2.2, -2.2]])
    after, told = rule.update(rule.begin(tk.Gaussian.trusted(mean, cov)), BEARINGS, z)
    assert told.ok.tolist() == [True, False]
    alone, _ = rule.update(rule.begin(PRIOR), BEARINGS, z[:, 0])
    np.testing.assert_allclose(after.moments().mean[:, 0], alone.moments().mean, atol=1e-12)


def test_measurements_add() -> None:
    """Information of independent measurements is their sum, whatever the order."""
    rule, state = InformationFilter(), InformationFilter().begin(PRIOR)
    sensors = [range_only(0.1).at(sx=3.0, sy=0.0), range_only(0.2).at(sx=0.0, sy=3.0)]
    one, _ = rule.update(state, sensors[0], np.array([2.0]))
    gained = one.matrix - state.matrix
    H = sensors[0].jacobian(PRIOR.mean)
    np.testing.assert_allclose(gained, H.T @ H / 0.1**2, atol=1e-9)


# ------------------------------------------------------------------------------- square root
SPACE = tk.Space.of("a", "b")
STILL = ComponentMotion(
    name="still",
    advance=lambda a, b: (a, b),
    noise=lambda: ((0.0, 0.0), (0.0, 0.0)),
    space=SPACE,
)
TINY = 2.0**-32


def nearly_the_same(second: float) -> ComponentSensor:
    return ComponentSensor(
        name="sum",
        measure=lambda a, b: (a + second * b,),
        noise=lambda: ((TINY**2,),),
        space=tk.Space.of("z"),
        state=SPACE,
    )


def by_fractions() -> list[list[Fraction]]:
    """The covariance after both measurements, without any rounding."""
    P = [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]]
    for h in ((Fraction(1), Fraction(1)), (Fraction(1), Fraction(1 + 2.0**-20))):
        PH = [sum(P[i][j] * h[j] for j in range(2)) for i in range(2)]
        S = sum(h[i] * PH[i] for i in range(2)) + Fraction(TINY) ** 2
        P = [[P[i][j] - PH[i] * PH[j] / S for j in range(2)] for i in range(2)]
    return P


@pytest.mark.parametrize("lanes", [False, True])
def test_a_root_keeps_what_a_covariance_loses(lanes: bool) -> None:
    """Two nearly equal, nearly exact measurements of two states (Bierman's example)."""
    exact = np.array([[float(e) for e in row] for row in by_fractions()])
    batch = (2,) if lanes else ()
    errors = {}
    for rule in (SquareRootFilter(), KalmanFilter()):
        state: Any = tk.Gaussian(np.zeros((2, *batch)), np.eye(2))
        state = rule.begin(state) if hasattr(rule, "begin") else state
        for second in (1.0, 1.0 + 2.0**-20):
            with np.errstate(all="ignore"):
                state, _ = rule.update(state, nearly_the_same(second), np.zeros((1, *batch)))
        cov = state.moments().cov
        cov = cov[..., 0] if lanes else cov
        errors[type(rule).__name__] = np.abs(cov - exact).max() / np.abs(exact).max()
    assert errors["SquareRootFilter"] < 1e-3, errors
    assert not errors["KalmanFilter"] < 0.1, f"the problem is too easy to tell: {errors}"


def test_a_singular_prior_is_allowed() -> None:
    prior = tk.Gaussian(PRIOR.mean, np.diag([0.0, 0.1, 1.0, 0.0]))
    found = [
        tk.filter(
            tk.estimator(name, motion=MOTION, sensor=BEARINGS), a_record(9, (3,)), prior
        ).filtered
        for name in ("ekf1", "square_root")
    ]
    np.testing.assert_allclose(found[1].mean, found[0].mean, atol=1e-10)
    np.testing.assert_allclose(found[1].cov, found[0].cov, atol=1e-10)


def test_covariances_of_roots_are_never_negative() -> None:
    """Random walks through updates that are 1e12 times better than the prediction."""
    rng = np.random.default_rng(6)
    rule: Any = SquareRootFilter()
    state = rule.begin(tk.Gaussian(np.zeros((4, 50)), 1e6 * np.eye(4)))
    sensor = position(1e-6)
    for _ in range(30):
        state = rule.predict(state, MOTION, float(rng.choice([1e-6, 1.0, 100.0])))
        state, told = rule.update(state, sensor, rng.standard_normal((2, 50)))
        assert np.all(told.ok)
        cov = np.moveaxis(state.moments().cov, -1, 0)
        scale = np.sqrt(np.einsum("kii->ki", cov))
        unit = cov / (scale[:, :, None] * scale[:, None])
        assert np.linalg.eigvalsh(unit).min() > -1e-14


def test_lanes_of_roots_are_alike_in_any_company() -> None:
    estimator = tk.estimator("square_root", motion=MOTION, sensor=BEARINGS)
    record = a_record(8, (2, 3))
    whole = tk.filter(estimator, record, PRIOR).filtered
    for lane in itertools.product(range(2), range(3)):
        alone = tk.filter(estimator, tk.Record(record.t, record.z[(..., *lane)]), PRIOR).filtered
        np.testing.assert_allclose(whole.mean[(..., *lane)], alone.mean, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_a_measurement_without_noise_has_no_information_form_and_says_so(
    batch: tuple[int, ...],
) -> None:
    """It must not be taken for one that was not made, with the prior as the answer."""
    perfect = ComponentSensor(
        name="perfect",
        measure=lambda a, b: (a,),
        noise=lambda: ((0.0,),),
        space=tk.Space.of("z"),
        state=SPACE,
    )
    prior = tk.Gaussian(np.zeros((2, *batch)), np.diag([3.0, 1.0]))
    record = tk.Record(np.zeros(1), np.full((1, 1, *batch), 2.0))
    found = {
        name: tk.filter(tk.estimator(name, motion=STILL, sensor=perfect), record, prior)
        for name in ("information", "square_root")
    }
    assert not found["information"].innovation.ok.any()
    assert np.isnan(found["information"].filtered.mean).all()
    assert found["square_root"].innovation.ok.all()
    np.testing.assert_allclose(found["square_root"].filtered.mean[0, 0], 2.0)


# ------------------------------------------------------------------- smoothing at the edge of precision
def exactly_smoothed(
    z: Array, variances: tuple[int, int], density: Fraction, R: Fraction
) -> tuple[list[Any], list[Any]]:
    """Means and covariances of one axis of a walk with steps of one second, in rational numbers."""
    one, zero = Fraction(1), Fraction(0)
    F = [[one, one], [zero, one]]
    Q = [[density / 3, density / 2], [density / 2, density]]

    def times(A: Any, B: Any) -> Any:
        return [
            [
                sum((a * b for a, b in zip(row, column, strict=True)), zero)
                for column in zip(*B, strict=True)
            ]
            for row in A
        ]

    def plus(A: Any, B: Any, sign: int = 1) -> Any:
        return [
            [a + sign * b for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)
        ]

    def across(A: Any) -> Any:
        return [list(column) for column in zip(*A, strict=True)]

    x, P = [[zero], [zero]], [[Fraction(variances[0]), zero], [zero, Fraction(variances[1])]]
    steps = []
    for value in z.tolist():
        before = times(F, x), plus(times(times(F, P), across(F)), Q)
        x, P = before
        if np.isfinite(value):
            K = [[P[0][0] / (P[0][0] + R)], [P[1][0] / (P[0][0] + R)]]
            news = [[Fraction(value) - x[0][0]]]
            x, P = plus(x, times(K, news)), plus(P, times(K, [P[0]]), -1)
        steps.append((before, (x, P)))
    smoothed = [steps[-1][1]]
    for (_, own), (ahead, _) in zip(steps[-2::-1], steps[:0:-1], strict=True):
        (a, b), (c, d) = ahead[1]
        inverse = [[e / (a * d - b * c) for e in row] for row in ([d, -b], [-c, a])]
        G = times(times(own[1], across(F)), inverse)
        later = smoothed[0]
        smoothed.insert(
            0,
            (
                plus(own[0], times(G, plus(later[0], ahead[0], -1))),
                plus(own[1], times(times(G, plus(later[1], ahead[1], -1)), across(G))),
            ),
        )
    return [np.array(m, float)[:, 0] for m, _ in smoothed], [
        np.array(c, float) for _, c in smoothed
    ]


@pytest.mark.parametrize("name", ["square_root_rts", "two_filter", "rts"])
def test_smoothers_of_a_root_filter_keep_its_means_and_not_all_digits_of_its_covariances(name):
    """A prior 1e12 times as uncertain as R, and nothing measured at first: what docs/explanation/smoothers.md says."""
    z = np.random.default_rng(4).normal(size=(6, 2))
    z[:2] = np.nan
    sensor = position(0.01)
    prior = tk.Gaussian(np.zeros(4), np.diag([1e8, 1e8, 1e2, 1e2]))
    motion = constant_velocity(1e-6)
    est = tk.estimator("square_root", motion=motion, sensor=sensor, smoother=name)
    found = tk.smooth(est, tk.Record(np.arange(1.0, 7.0), z), prior, start=0.0).smoothed
    axis = [0, 2]
    means, covs = exactly_smoothed(z[:, 0], (10**8, 10**2), Fraction(1e-6), Fraction(0.01) ** 2)
    for k, (mean, cov) in enumerate(zip(means, covs, strict=True)):
        sigma = np.sqrt(np.diag(cov))
        ours = found.cov[k][np.ix_(axis, axis)]
        assert (np.abs(found.mean[k][axis] - mean) < 1e-7 * sigma).all()
        assert (np.abs(ours - cov) < 5e-3 * np.outer(sigma, sigma)).all()
        if name == "square_root_rts":
            scaled = ours / np.sqrt(np.outer(np.diag(ours), np.diag(ours)))
            assert np.linalg.eigvalsh(scaled)[0] > -1e-15
