"""Sigma-point filters and their smoother: equal to the Kalman family where they must be, and safe elsewhere."""

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.models import ComponentMotion, ComponentSensor, atan2, cos, diagonal, sin, wrap
from tracker.types import Gaussian
from tracker_kalman.fixed_lag import FixedLagSmoother
from tracker_kalman.posterior_linearisation import PosteriorLinearisationFilter
from tracker_kalman.sigma_point import SigmaPointFilter, unscented, unscented_general
from tracker_kalman.sigma_point_rts import SigmaPointRauchTungStriebel
from tracker_kalman.sigma_points import (
    CubatureDegree5,
    GaussHermite,
    MinimalSimplex,
    Scaled,
    SphericalSimplex,
    Symmetric,
    general,
)
from tracker_kalman.square_root_sigma_point import SquareRootSigmaPointFilter
from tracker_motion import constant_velocity, coordinated_turn
from tracker_sensors import azimuth, position, range_azimuth, stack

SETS = [
    Symmetric(),
    Scaled(),
    Scaled(0.5, 2.0, 1.0),
    general(),
    SphericalSimplex(),
    SphericalSimplex(0.5),
    MinimalSimplex(),
    CubatureDegree5(),
    GaussHermite(3),
]
BATCHES = [(), (7,), (3, 5)]


@attrs.frozen
class Unadmitted:
    """A linear model that does not say so: sigma points must find out for themselves."""

    model: object

    def __getattr__(self, name):
        if name in {"linear", "model"}:
            raise AttributeError(name)
        return getattr(self.model, name)


def linear_problem(batch, seed=1):
    rng = np.random.default_rng(seed)
    steps = 12
    t = np.cumsum(rng.uniform(0.0, 0.5, steps))
    z = rng.standard_normal((steps, 2, *batch))
    z[rng.random(z.shape) < 0.2] = np.nan
    motion = constant_velocity(0.3)
    prior = Gaussian(np.array([0.1, 0.2, 0.3, 0.4]), np.diag([1.0, 2.0, 3.0, 0.5]))
    return motion, position(0.4).over(motion.space), tk.Record(t, z), prior


def run(rule, motion, sensor, record, prior, smoother=None):
    est = tk.estimator(rule, motion=motion, sensor=sensor, smoother=smoother)
    return (tk.filter if smoother is None else tk.smooth)(est, record, prior, start=-0.3)


def same(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=tolerance)
    np.testing.assert_allclose(a.cov, b.cov, rtol=0, atol=tolerance)


FORMS = {
    "plain": SigmaPointFilter,
    "augmented": lambda points: SigmaPointFilter(points, augmented=True),
    "augmented, drawn once": lambda points: SigmaPointFilter(
        points, redraw=False, augmented=True, measured=2
    ),
    "square root": SquareRootSigmaPointFilter,
    "iterated": lambda points: PosteriorLinearisationFilter(3, points),
}


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize("points", SETS, ids=repr)
@pytest.mark.parametrize("form", FORMS)
def test_points_find_the_kalman_filter_on_linear_problems(form, points, batch):
    if isinstance(points, GaussHermite) and "augmented" in form:
        points = GaussHermite(2)  # 3^10 points would do as well, in a minute
    motion, sensor, record, prior = linear_problem(batch)
    want = run("kf", motion, sensor, record, prior)
    rule = FORMS[form](points)
    got = run(rule, Unadmitted(motion), Unadmitted(sensor), record, prior)
    same(got.predicted, want.predicted)
    same(got.filtered, want.filtered)
    np.testing.assert_allclose(got.innovation.nis, want.innovation.nis, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(got.innovation.loglik, want.innovation.loglik, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_where_a_model_says_that_it_is_linear_the_result_differs_by_rounding_alone(form):
    if "drawn once" in form:
        pytest.skip("points that are drawn once are always propagated")
    motion, sensor, record, prior = linear_problem((7,))
    rule = FORMS[form](Scaled())
    exact = run(rule, motion, sensor, record, prior)
    points = run(rule, Unadmitted(motion), Unadmitted(sensor), record, prior)
    same(points.filtered, exact.filtered, 1e-12)


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize("points", SETS, ids=repr)
def test_the_smoother_is_that_of_rauch_tung_and_striebel_on_linear_problems(points, batch):
    motion, sensor, record, prior = linear_problem(batch)
    want = run("kf", motion, sensor, record, prior, "rts").smoothed
    for hidden, augmented in (
        (motion, False),
        (Unadmitted(motion), False),
        (Unadmitted(motion), True),
    ):
        if augmented and isinstance(points, GaussHermite):
            continue
        smoother = SigmaPointRauchTungStriebel(points, augmented)
        got = run(SigmaPointFilter(points), hidden, sensor, record, prior, smoother).smoothed
        same(got, want)


def test_points_that_are_kept_do_not_know_the_process_noise():
    """Without redraw and without augmentation S is that of P- less Q: why redraw is the default."""
    motion, sensor, _, prior = linear_problem(())
    rule = SigmaPointFilter(Symmetric(), redraw=False)
    ahead = rule.predict(prior, motion, 1.0)
    S = rule.project(ahead, sensor).S
    kept = ahead.cov - motion.Q(prior.mean, 1.0)
    np.testing.assert_allclose(S, kept[:2, :2] + 0.16 * np.eye(2), atol=1e-12)
    again = SigmaPointFilter(Symmetric()).project(ahead.moments(), sensor).S
    np.testing.assert_allclose(again, ahead.cov[:2, :2] + 0.16 * np.eye(2), atol=1e-12)


# ----------------------------------------------------------------------------- nonlinear problems
TURNING = ("plain", "augmented", "augmented, drawn once", "square root", "iterated")


def turning_problem(batch, missing=True, seed=3):
    """A coordinated turn seen by range and azimuth beyond the cut; n = 5, the motion not linear."""
    rng = np.random.default_rng(seed)
    motion = coordinated_turn(0.1, 0.01)
    sensor = range_azimuth(0.1, 0.02).at(sx=6.0, sy=0.3).over(motion.space)
    steps = 15
    t = np.cumsum(rng.uniform(0.02, 0.3, steps))
    start = np.array([0.1, -0.2, 1.0, 0.3, 0.4])
    x = np.stack([motion.f(start, s) for s in t])
    z = np.stack([sensor.h(s) for s in x]).reshape(steps, 2, *(1,) * len(batch))
    z = z + 0.05 * rng.standard_normal((steps, 2, *batch))
    if missing:
        z[rng.random(z.shape) < 0.15] = np.nan
    return motion, sensor, tk.Record(t, z), Gaussian(start, 0.05 * np.eye(5))


@pytest.mark.parametrize("form", TURNING)
def test_the_compiled_filter_is_that_of_the_arrays_and_of_one_run(form, monkeypatch):
    rule = FORMS[form](general())
    motion, sensor, record, prior = turning_problem((9,))
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays = run(rule, motion, sensor, record, prior, SigmaPointRauchTungStriebel("general"))
    one = tk.Record(record.t, record.z[..., 4])
    alone = run(rule, motion, sensor, one, prior)
    np.testing.assert_allclose(alone.filtered.mean, arrays.filtered.mean[..., 4], atol=1e-9)
    np.testing.assert_allclose(alone.filtered.cov, arrays.filtered.cov[..., 4], atol=1e-9)
    assert arrays.innovation.ok.all()
    pytest.importorskip("llvmlite")
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    fused = run(rule, motion, sensor, record, prior, SigmaPointRauchTungStriebel("general"))
    for a, b in (
        (arrays.predicted, fused.predicted),
        (arrays.filtered, fused.filtered),
        (arrays.smoothed, fused.smoothed),
    ):
        same(a, b)
    np.testing.assert_allclose(fused.innovation.nis, arrays.innovation.nis, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("points", [Symmetric(), Scaled(), general(), CubatureDegree5()], ids=repr)
def test_square_roots_change_nothing_but_rounding(points):
    motion, sensor, record, prior = turning_problem((4,))
    plain = run(SigmaPointFilter(points), motion, sensor, record, prior)
    rooted = run(SquareRootSigmaPointFilter(points), motion, sensor, record, prior)
    same(plain.filtered, rooted.filtered)
    np.testing.assert_allclose(rooted.innovation.S, plain.innovation.S, rtol=1e-9)
    np.testing.assert_allclose(rooted.innovation.nis, plain.innovation.nis, rtol=1e-7, atol=1e-9)


def test_square_roots_keep_what_covariances_lose():
    """Prior variance 1e18 times that of the measurement: P - K S K' has no digit left, the root has."""
    sensor = linear_problem(())[1]
    prior, z = Gaussian(np.zeros(4), 1e9 * np.eye(4)), np.array([1.0, 2.0])
    sharp = sensor.with_parameters(**dict.fromkeys(sensor.parameters, 3e-5))
    after, told = SquareRootSigmaPointFilter().update(prior, Unadmitted(sharp), z)
    np.testing.assert_allclose(after.root[[0, 1], [0, 1]], 3e-5, rtol=1e-6)
    assert told.ok
    plain, _ = SigmaPointFilter().update(prior, Unadmitted(sharp), z)
    assert abs(plain.cov[0, 0] / 9e-10 - 1.0) > 1e-3, "the plain form would do"


def test_iterating_helps_where_the_measurement_is_much_better_than_the_prior():
    """Against the posterior mean by quadrature; one iteration is the plain filter."""
    space = tk.Space.of("x")
    sensor = ComponentSensor(
        name="cube", measure=lambda x: (x * x * x,), noise=lambda: ((0.01,),),
        space=tk.Space.of("z"), state=space,
    )  # fmt: skip
    prior, z = Gaussian([1.0], [[0.25]]), np.array([4.0])
    grid = np.linspace(-2.0, 4.0, 60_001)
    weight = np.exp(-0.5 * (grid - 1.0) ** 2 / 0.25 - 0.5 * (4.0 - grid**3) ** 2 / 0.01)
    want = (grid * weight).sum() / weight.sum()
    gaps = [
        abs(PosteriorLinearisationFilter(k).update(prior, sensor, z)[0].mean[0] - want)
        for k in (1, 2, 5, 10)
    ]
    plain = SigmaPointFilter().update(prior, sensor, z)[0].mean[0]
    assert gaps[0] == pytest.approx(abs(plain - want))
    assert gaps[3] < 0.01 * gaps[0], f"distances from the posterior mean: {gaps}"


@pytest.mark.parametrize("form", TURNING)
def test_a_missing_component_equals_a_sensor_without_it(form):
    if "drawn once" in form or form == "augmented":
        rule, tolerance = FORMS[form](Symmetric()), None  # another dimension, other points
    else:
        rule, tolerance = FORMS[form](Symmetric()), 1e-9
    motion = coordinated_turn(0.1, 0.01)
    both = stack([azimuth(0.02).at(sx=6.0, sy=0.3), azimuth(0.05).at(sx=0.0, sy=4.0)]).over(
        motion.space
    )
    alone = azimuth(0.02).at(sx=6.0, sy=0.3).over(motion.space)
    state = Gaussian([0.1, -0.2, 1.0, 0.3, 0.4], 0.05 * np.eye(5))
    z = both.h(state.mean) + 0.01
    got, told = rule.update(state, both, np.array([z[0], np.nan]))
    want, said = rule.update(state, alone, z[:1])
    if tolerance is None:
        assert told.count == 1.0
        np.testing.assert_allclose(got.moments().mean, want.moments().mean, atol=1e-3)
        return
    same(got.moments(), want.moments(), tolerance)
    np.testing.assert_allclose([told.nis, told.loglik], [said.nis, said.loglik], atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("points", [Symmetric(), Scaled(0.5, 2.0, 1.0), general()], ids=repr)
def test_angles_on_both_sides_of_the_cut_are_averaged_rightly(form, points):
    """A target behind the sensor gives what the same picture, turned to lie ahead, gives."""

    def turned(angle):
        return ComponentSensor(
            name="turned",
            measure=lambda x, y: (wrap(atan2(y, x - 5.0) + angle), wrap(atan2(y - 1.0, x - 4.0) + angle)),
            noise=lambda: diagonal(0.02**2, 0.03**2),
            space=tk.Space.of("a [rad] circular", "b [rad] circular"),
        )  # fmt: skip

    state = Gaussian([0.0, 0.01, 1.0, 0.0], np.diag([0.3, 0.3, 0.1, 0.1]))
    behind, ahead = turned(0.0), turned(3.0)
    z = behind.h(np.array([0.1, -0.05, 0.0, 0.0]))  # just across the cut
    rule = FORMS[form](points)
    first = rule.update(state, behind, z)[0].moments()
    second = rule.update(state, ahead, np.array([wrap(a + 3.0) for a in z]))[0].moments()
    same(first, second, 1e-10)
    assert np.abs(first.mean - state.mean).max() < 1.0, (
        "a measurement nearby moves the state little"
    )


@pytest.mark.parametrize("form", FORMS)
def test_circular_states_are_averaged_on_the_circle(form):
    """A heading that f wraps, spread over the cut, is predicted as one far from it."""
    space = tk.Space.of("heading [rad] circular", "rate [rad/s]")
    motion = ComponentMotion(
        name="compass",
        advance=lambda heading, rate, *, dt: (wrap(heading + dt * rate), rate),
        noise=lambda *, dt: ((0.01 * dt, 0.0), (0.0, 0.01 * dt)),
        space=space,
    )
    assert not motion.linear, "a wrap is what makes points necessary"
    rule, cov = FORMS[form](Symmetric()), np.array([[0.2, 0.05], [0.05, 0.1]])
    far, near = (rule.predict(Gaussian([h, 0.1], cov), motion, 1.0).moments() for h in (0.0, 3.04))
    np.testing.assert_allclose(near.cov, far.cov, atol=1e-12)
    assert wrap(near.mean[0] - 3.04 - far.mean[0]) == pytest.approx(0.0, abs=1e-12)
    smoother = SigmaPointRauchTungStriebel(Symmetric())
    turns = []
    for heading in (0.0, 3.04):
        state = Gaussian([heading, 0.1], cov)
        ahead = SigmaPointFilter(Symmetric()).predict(state, motion, 1.0)
        after = Gaussian([wrap(ahead.mean[0] + 0.1), 0.1], 0.5 * ahead.cov)
        turns.append(smoother.step(state, ahead, after, motion, 1.0).mean[0] - heading)
    assert turns[0] == pytest.approx(turns[1], abs=1e-12)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("points", [Symmetric(), general(), CubatureDegree5()], ids=repr)
def test_singular_covariances_are_welcome(form, points):
    """Velocity known exactly (paper 2's P0): no NaN, and what is known stays known."""
    motion, sensor, record, _ = turning_problem(())
    rule = FORMS[form](points)
    state = Gaussian([0.1, -0.2, 1.0, 0.3, 0.4], np.diag([0.1, 0.1, 0.0, 0.0, 0.0]))
    after, told = rule.update(state, sensor, record.z[0])
    assert told.ok
    np.testing.assert_allclose(after.moments().cov[2:], 0.0, atol=1e-15)
    np.testing.assert_allclose(after.moments().mean[2:], [1.0, 0.3, 0.4], atol=1e-12)
    ahead = rule.predict(state, motion, 0.0).moments()
    same(ahead, state, 1e-12)


# -------------------------------------------------------------------------- indefinite covariances
PLANE = tk.Space.of("a", "b", "c", "d")


def squares(sigma):
    """The sum of squares of four components: at kappa = -1 its sample variance is -4 sigma^4."""
    return ComponentSensor(
        name="squares",
        measure=lambda a, b, c, d: (a * a + b * b + c * c + d * d,),
        noise=lambda: ((sigma * sigma,),),
        space=tk.Space.of("z"),
        state=PLANE,
    )


def growing():
    """Motion that adds the sum of squares to one component, without noise."""
    return ComponentMotion(
        name="growing",
        advance=lambda a, b, c, d, *, dt: (a + dt * (a * a + b * b + c * c + d * d), b, c, d),
        noise=lambda *, dt: diagonal(1e-6 * dt, 0.0, 0.0, 0.0),
        space=PLANE,
    )


def lanes_of_three():
    """The middle lane is too wide for kappa = -1; its neighbours are not."""
    cov = np.stack([s * np.eye(4) for s in (0.01, 4.0, 0.02)], axis=-1)
    return Gaussian(np.zeros((4, 3)) + 0.1, cov)


@pytest.mark.parametrize("form", ["plain", "iterated", "square root"])
def test_an_indefinite_innovation_covariance_costs_that_lane_alone(form):
    assert general().points(4).mean[0] == pytest.approx(-1.0 / 3.0)
    rule, state, sensor = FORMS[form](general()), lanes_of_three(), squares(1.0)
    with np.errstate(all="ignore"):
        after, told = rule.update(state, sensor, np.full((1, 3), 0.5))
        assert rule.project(state, sensor).S[0, 0, 1] < 0.0, "the example is none"
    assert told.ok.tolist() == [True, False, True]
    assert np.isnan(after.moments().mean[:, 1]).all()
    outer = rule.update(state[[0, 2]], sensor, np.full((1, 2), 0.5))[0].moments()
    np.testing.assert_array_equal(after.moments().mean[:, [0, 2]], outer.mean)


@pytest.mark.parametrize("form", ["plain", "iterated", "square root"])
def test_an_indefinite_prediction_costs_that_lane_alone(form):
    rule, state = FORMS[form](general()), lanes_of_three()
    with np.errstate(all="ignore"):
        ahead = rule.predict(state, growing(), 1.0)
        _, told = rule.update(ahead, squares(1.0), np.full((1, 3), 0.5))
    assert np.isnan(ahead.moments().cov).any(axis=(0, 1)).tolist() == [False, True, False]
    assert told.ok.tolist() == [True, False, True]


@pytest.mark.parametrize(
    "rule", [unscented_general(floor=1e-6), PosteriorLinearisationFilter(2, general(), 1e-6)]
)
def test_with_a_floor_that_lane_goes_on(rule):
    state, sensor = lanes_of_three(), squares(1.0)
    ahead = rule.predict(state, growing(), 1.0)
    after, told = rule.update(ahead, sensor, np.full((1, 3), 0.5))
    assert told.ok.all()
    for belief in (ahead, after):
        least = np.linalg.eigvalsh(np.moveaxis(belief.cov, -1, 0))[:, 0]
        assert (least >= -1e-12).all(), f"smallest eigenvalues {least}"
    plain = attrs.evolve(rule, floor=None).predict(state, growing(), 1.0)
    np.testing.assert_allclose(ahead.cov[..., [0, 2]], plain.cov[..., [0, 2]], rtol=1e-12)


@pytest.mark.parametrize(
    "rule", [unscented_general(floor=1e-6), PosteriorLinearisationFilter(2, general(), 1e-6)]
)
def test_with_a_floor_every_lane_goes_on(rule, monkeypatch):
    """4,000 priors of all widths, of which the update leaves hundreds with an indefinite covariance."""
    rng, lanes, sensor = np.random.default_rng(0), 4000, squares(0.3)
    var = 10 ** rng.uniform(-2, 1, (4, lanes))
    mean = rng.normal(0, 1.5, (4, lanes))
    state = Gaussian(mean, var * np.eye(4)[:, :, None])
    x = mean + np.sqrt(var) * rng.normal(size=(4, lanes))
    z = sensor.h(x) + 0.3 * rng.normal(size=(1, lanes))
    with np.errstate(all="ignore"):
        refused = ~attrs.evolve(rule, floor=None).update(state, sensor, z)[1].ok
        after, told = rule.update(state, sensor, z)
    assert refused.sum() > 100
    assert told.ok.all()
    assert np.isfinite(after.mean).all()
    assert np.isfinite(told.loglik).all()
    assert (np.linalg.eigvalsh(np.moveaxis(after.cov, -1, 0))[:, 0] > 0.0).all()
    for lane in np.flatnonzero(refused)[:20]:  # and a single run likewise
        alone, heard = rule.update(state[lane], sensor, z[:, lane])
        assert heard.ok
        np.testing.assert_allclose(alone.mean, after.mean[:, lane], rtol=1e-9, atol=1e-9)
    pytest.importorskip("llvmlite")
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    est = tk.estimator(rule, motion=growing(), sensor=sensor)
    fused = tk.filter(est, tk.Record([0.0], z[None]), state, start=0.0)
    assert fused.innovation.ok.all()


def test_positive_weights_never_need_a_floor():
    for points in (Scaled(), Symmetric(), SphericalSimplex(0.3), GaussHermite(3)):
        rule, state = SigmaPointFilter(points), lanes_of_three()
        after, told = rule.update(
            rule.predict(state, growing(), 1.0), squares(1.0), np.full((1, 3), 0.5)
        )
        assert told.ok.all(), points
        assert np.linalg.eigvalsh(np.moveaxis(after.cov, -1, 0)).min() > 0.0


def test_compiled_steps_refuse_and_raise_alike(monkeypatch):
    pytest.importorskip("llvmlite")
    state, z = lanes_of_three(), np.full((3, 1, 3), 0.5)
    for rule in (unscented_general(), unscented_general(floor=1e-6)):
        found = {}
        for choice in ("off", "require"):
            monkeypatch.setenv("TRACKER_COMPILE", choice)
            est = tk.estimator(rule, motion=growing(), sensor=squares(1.0))
            found[choice] = tk.filter(est, tk.Record([0.0, 0.1, 0.2], z), state, start=-0.1)
        a, b = found["off"], found["require"]
        np.testing.assert_array_equal(a.innovation.ok, b.innovation.ok)
        good = a.innovation.ok[-1]
        assert good.tolist() == ([True] * 3 if rule.floor else [True, False, True])
        np.testing.assert_allclose(
            b.filtered.mean[..., good], a.filtered.mean[..., good], rtol=1e-8, atol=1e-9
        )


# ----------------------------------------------------------------------------- lanes, dt, options
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("batch", [(4,), (2, 3)])
def test_time_steps_poses_and_parameters_may_differ_per_lane(form, batch):
    rng = np.random.default_rng(8)
    motion = coordinated_turn(0.1, 0.01)
    sensor = azimuth(rng.uniform(0.01, 0.1, batch)).over(motion.space)
    other = azimuth(0.03).over(motion.space)
    joint = stack([sensor, other])
    mean = rng.standard_normal((5, *batch))
    state = Gaussian(mean, 0.05 * np.eye(5))
    dt, pose = rng.uniform(0.0, 0.5, batch), rng.uniform(5.0, 8.0, (joint.pose_space.size, *batch))
    z = joint.h(mean, pose) + 0.01
    rule = FORMS[form](Symmetric())
    ahead = rule.predict(state, motion, dt)
    after = rule.update(ahead, joint, z, pose)[0].moments()
    for lane in np.ndindex(*batch):
        alone = Gaussian(mean[(..., *lane)], 0.05 * np.eye(5))
        own = joint.lanes(lane[-1]) if len(batch) == 1 else stack(
            [azimuth(float(sensor.parameters[next(iter(sensor.parameters))][lane])).over(motion.space), other]
        )  # fmt: skip
        one = rule.update(
            rule.predict(alone, motion, float(dt[lane])), own, z[(..., *lane)], pose[(..., *lane)]
        )[0].moments()
        np.testing.assert_allclose(after.mean[(..., *lane)], one.mean, atol=1e-9)
        np.testing.assert_allclose(after.cov[(..., *lane)], one.cov, atol=1e-9)


def test_too_many_points_run_on_arrays_and_say_so(monkeypatch):
    pytest.importorskip("llvmlite")
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    motion, sensor, record, prior = turning_problem(())
    est = tk.estimator(SigmaPointFilter(GaussHermite(4)), motion=motion, sensor=sensor)
    assert "1024 points in 5 dimensions" in est.explain()
    assert tk.filter(est, record, prior, start=0.0).innovation.ok.all()
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    with pytest.raises(CapabilityError, match="1024 points"):
        tk.filter(est, record, prior, start=0.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SigmaPointFilter("hexagonal"), "'points'"),
        (lambda: SigmaPointFilter(redraw=False, augmented=True), "'measured'"),
        (lambda: unscented(floor=-1.0), "'floor'"),
        (lambda: PosteriorLinearisationFilter(0), "'iterations'"),
        (lambda: PosteriorLinearisationFilter(floor=2.0), "'floor'"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_words(make, words):
    with pytest.raises(DomainError, match=words):
        make()


def test_a_wrong_number_of_measured_components_is_refused():
    motion, sensor, record, prior = turning_problem(())
    rule = SigmaPointFilter(Symmetric(), redraw=False, augmented=True, measured=1)
    with pytest.raises(DomainError, match=r"'measured'.*got 1.*expected 2"):
        rule.update(rule.predict(prior, motion, 0.1), sensor, record.z[0])


@pytest.mark.parametrize(
    "name",
    ["ukf", "ukf_symmetric", "ukf_general", "ckf", "ckf5", "ghkf", "ukf_spherical_simplex",
     "ukf_minimal_simplex", "ukf_square_root", "iplf"],
)  # fmt: skip
def test_every_name_makes_a_filter_that_follows_a_turn(name):
    motion, sensor, record, prior = turning_problem((3,), missing=False)
    history = run(name, motion, sensor, record, prior, "sigma_point_rts")
    assert history.innovation.ok.all()
    truth = motion.f(np.array([0.1, -0.2, 1.0, 0.3, 0.4]), float(record.t[-1]))
    assert np.abs(history.filtered.mean[-1, :2] - truth[:2, None]).max() < 0.5


def test_a_sine_of_a_normal_angle_has_the_moments_of_theory():
    """E sin = sin(m) exp(-s^2 / 2): Gauss-Hermite converges to it, degree three is farther away."""
    space = tk.Space.of("angle [rad]")
    sensor = ComponentSensor(
        name="circle", measure=lambda angle: (sin(angle), cos(angle)),
        noise=lambda: diagonal(0.0, 0.0), space=tk.Space.of("s", "c"), state=space,
    )  # fmt: skip
    state, s = Gaussian([0.7], [[0.5]]), 0.5
    want = np.array([np.sin(0.7), np.cos(0.7)]) * np.exp(-s / 2)
    gaps = [
        np.abs(SigmaPointFilter(p).project(state, sensor).z - want).max()
        for p in (Symmetric(), GaussHermite(3), GaussHermite(5), GaussHermite(10))
    ]
    assert gaps[0] > gaps[1] > gaps[2] > gaps[3]
    assert gaps[3] < 1e-12


@pytest.mark.parametrize("batch", [(), (4,)])
def test_the_smoother_serves_fixed_lag_and_missing_measurements(batch):
    """A lag as long as the record is the fixed-interval smoother, for nonlinear motion as well."""
    motion, sensor, record, prior = turning_problem(batch)
    smoother = SigmaPointRauchTungStriebel(Symmetric())
    whole = run("ckf", motion, sensor, record, prior, smoother).smoothed
    lagged = run("ckf", motion, sensor, record, prior, FixedLagSmoother(99, smoother)).smoothed
    same(lagged, whole)


def test_smoothing_with_points_beats_filtering_where_motion_is_not_linear():
    motion, sensor, record, prior = turning_problem((200,), missing=False)
    history = run("ckf", motion, sensor, record, prior, "sigma_point_rts")
    truth = np.stack([motion.f(np.array([0.1, -0.2, 1.0, 0.3, 0.4]), s) for s in record.t])
    before, after = (
        np.sqrt(((trajectory.mean - truth[..., None])[:, :2] ** 2).sum(axis=1).mean())
        for trajectory in (history.filtered, history.smoothed)
    )
    assert after < 0.8 * before, f"position error {before:.3f} filtered, {after:.3f} smoothed"
