"""The Gaussian-sum filter over any filter, and the start that does not know the range."""

import numpy as np
import pytest

import tracker as tk
from tracker.adaptation import (
    with_noise,
    with_process_noise,
    with_scaled_noise,
    with_scaled_process_noise,
)
from tracker.errors import CapabilityError, DomainError
from tracker.models import ComponentSensor
from tracker.types import SPATIAL
from tracker_kalman import GaussianSumFilter
from tracker_kalman.gaussian_sum import GaussianSum, merged, pruned, split
from tracker_motion import constant_velocity
from tracker_passive import RangeParameterised
from tracker_passive.range_parameterised import cells
from tracker_sensors import azimuth, azimuth_elevation, position

MOTION = constant_velocity(0.1)
PRIOR = tk.Gaussian(np.array([1.0, 2.0, 0.5, 0.0]), np.diag([9.0, 4.0, 1.0, 1.0]) + 0.5)
FILTERS = ["kf", "ekf1", "ukf", "ukf_square_root"]


def record(batch=(), steps=20, seed=1):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.0, 0.5, 1.0], steps))
    z = np.cumsum(rng.standard_normal((steps, 2, *batch)), axis=0)
    z[rng.uniform(size=z.shape) < 0.1] = np.nan
    return tk.Record(t, z)


def run(rule, batch=(), prior=PRIOR, sensor=None):
    built = tk.estimator(rule, motion=MOTION, sensor=sensor or position(1.0))
    return tk.filter(built, record(batch), prior, start=0.0)


# -------------------------------------------------------------------------------- the filter
@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
@pytest.mark.parametrize("rule", FILTERS)
def test_one_component_equals_its_filter(rule, batch):
    want, found = run(rule, batch), run(GaussianSumFilter(rule), batch)
    for name in ("predicted", "filtered"):
        ours, theirs = getattr(found, name), getattr(want, name)
        np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.cov, theirs.cov, rtol=0, atol=1e-9)
    for name in ("nis", "loglik", "count"):
        ours, theirs = getattr(found.innovation, name), getattr(want.innovation, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
@pytest.mark.parametrize("rule", FILTERS)
def test_equal_members_equal_their_filter(rule, batch):
    # Before its first direction a bank is just that; a position is none.
    want, found = run(rule, batch), run(RangeParameterised(rule, components=3), batch)
    np.testing.assert_allclose(found.filtered.mean, want.filtered.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.filtered.cov, want.filtered.cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.innovation.loglik, want.innovation.loglik, atol=1e-9)


def test_members_are_those_of_bayes_rule_written_out():
    built = tk.estimator(GaussianSumFilter("kf", components=4), motion=MOTION, sensor=position(1.0))
    state = built.begin(PRIOR)
    own, weights = state.members.moments(), state.weights
    z = np.array([3.0, -1.0])
    after, told = built.step(state, z, 0.7)
    alone = tk.estimator("kf", motion=MOTION, sensor=position(1.0))
    likelihoods = []
    for k in range(4):
        one, its = alone.step(tk.Gaussian(own.mean[:, k], own.cov[:, :, k]), z, 0.7)
        likelihoods.append(weights[k] * np.exp(its.loglik))
        np.testing.assert_allclose(after.members.mean[:, k], one.mean, rtol=1e-12)
    np.testing.assert_allclose(after.weights, likelihoods / np.sum(likelihoods), rtol=1e-12)
    np.testing.assert_allclose(told.loglik, np.log(np.sum(likelihoods)), rtol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 32])
def test_a_split_prior_has_the_moments_of_the_prior(count):
    rng = np.random.default_rng(count)
    root = rng.standard_normal((4, 4, 5))
    prior = tk.Gaussian(rng.standard_normal((4, 5)), np.einsum("ikl,jkl->ijl", root, root))
    parts, weights = split(prior, count, (0, 1))
    whole = GaussianSum(parts, np.repeat(np.log(weights)[:, None], 5, axis=1), (False,) * 4)
    np.testing.assert_allclose(whole.moments().mean, prior.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(whole.moments().cov, prior.cov, rtol=0, atol=1e-11)
    smallest = np.linalg.eigvalsh(np.moveaxis(parts.cov, (0, 1), (-2, -1)))[..., 0]
    assert smallest.min() > -1e-12


def test_a_lane_does_not_depend_on_its_company():
    rule = GaussianSumFilter("ekf1", components=5, prune=1e-3, merge=0.01)
    together = run(rule, (9,))
    built = tk.estimator(rule, motion=MOTION, sensor=position(1.0))
    alone = tk.filter(built, tk.Record(record((9,)).t, record((9,)).z[..., 2:5]), PRIOR, start=0.0)
    assert np.array_equal(together.filtered.mean[..., 2:5], alone.filtered.mean)


def test_weights_do_not_underflow_and_a_lost_member_is_given_up():
    far = np.array([[0.0, 1e8, np.nan], [0.0, 1e8, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    members = tk.Gaussian.trusted(far, np.repeat(np.eye(4)[..., None], 3, axis=2))
    state = GaussianSum(members, np.log(np.full(3, 1.0 / 3.0)), (False,) * 4)
    rule = GaussianSumFilter("kf")
    with np.errstate(invalid="ignore"):
        after, told = rule.update(state, position(1.0), np.array([1e8, 1e8]))
    assert told.ok
    np.testing.assert_allclose(after.weights, [0.0, 1.0, 0.0])
    assert np.isfinite(after.moments().mean).all()
    far[:] = np.nan
    after, told = rule.update(state, position(1.0), np.array([0.0, 0.0]))
    assert not told.ok
    assert np.isnan(after.moments().mean).all()


def test_pruning_gives_up_what_is_unlikely_and_the_rest_sums_to_one():
    members = tk.Gaussian.trusted(
        np.zeros((2, 3, 1)), np.repeat(np.eye(2)[..., None, None], 3, axis=2)
    )
    state = GaussianSum(members, np.log(np.array([[0.6], [0.3999], [1e-4]])), (False,) * 2)
    np.testing.assert_allclose(
        pruned(state, 1e-3).weights[:, 0], [0.6, 0.3999, 0.0] / np.sum([0.6, 0.3999])
    )
    assert np.array_equal(pruned(state, 1e-5).weights > 0, np.ones((3, 1), bool))


def test_merging_keeps_the_moments_and_takes_the_closest_pair():
    mean = np.array([[0.0, 5.0, 5.1], [0.0, 0.0, 0.0]])
    members = tk.Gaussian.trusted(mean, np.repeat(np.eye(2)[..., None], 3, axis=2))
    state = GaussianSum(members, np.log(np.array([0.5, 0.3, 0.2])), (False,) * 2)
    rule = GaussianSumFilter("kf")
    less = merged(state, 0.01, rule.filter)
    np.testing.assert_allclose(less.weights, [0.5, 0.5, 0.0])
    np.testing.assert_allclose(less.members.mean[0, :2], [0.0, 5.04])
    for ours, theirs in zip((less.moments().mean, less.moments().cov),
                            (state.moments().mean, state.moments().cov), strict=True):  # fmt: skip
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
    assert merged(state, 1e-9, rule.filter) is state


@pytest.mark.parametrize("change", [{"components": 0}, {"prune": 1.0}, {"merge": -1.0}])
def test_options_out_of_range_are_refused(change):
    with pytest.raises(DomainError, match=next(iter(change))):
        GaussianSumFilter("ekf1", **change)


# ------------------------------------------------------------------------- the unknown range
WIDE = tk.Gaussian(np.array([6000.0, 5000.0, 0.0, 0.0]), np.diag([3000.0**2] * 2 + [10.0**2] * 2))


def polar_posterior(prior, z, sigma, site):
    """Mean, covariance and likelihood of a position by quadrature over the plane, in polar form."""
    r = np.linspace(1.0, 40_000.0, 6000)[:, None]
    angle = z + sigma * np.linspace(-6.0, 6.0, 201)
    x, y = site[0] + r * np.cos(angle), site[1] + r * np.sin(angle)
    P, m = prior.cov[:2, :2], prior.mean[:2]
    apart = np.stack([x - m[0], y - m[1]])
    white = np.linalg.solve(np.linalg.cholesky(P), apart.reshape(2, -1)).reshape(apart.shape)
    log = -0.5 * (white**2).sum(axis=0)
    density = np.exp(log) / (2.0 * np.pi * np.sqrt(np.linalg.det(P)))
    seen = np.exp(-0.5 * ((angle - z) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    weight = density * seen * r * (r[1] - r[0]) * (angle[1] - angle[0])
    total = weight.sum()
    mean = np.array([(weight * x).sum(), (weight * y).sum()]) / total
    d = np.stack([x - mean[0], y - mean[1]])
    return mean, np.einsum("ab,iab,jab->ij", weight, d, d) / total, np.log(total)


@pytest.mark.parametrize("bearing", [0.2, 0.7, 1.5])
def test_a_bank_is_the_posterior_of_the_first_bearing(bearing):
    sensor = azimuth(np.deg2rad(0.5)).at(sx=100.0, sy=-50.0)
    bank = RangeParameterised("ekf1", components=64, nearest=5.0, farthest=30_000.0)
    after, told = bank.update(WIDE, sensor, np.array([bearing]))
    mean, cov, loglik = polar_posterior(WIDE, bearing, np.deg2rad(0.5), (100.0, -50.0))
    found = after.moments()
    sigma = np.sqrt(np.trace(cov))
    assert np.abs(found.mean[:2] - mean).max() < 0.01 * sigma
    assert np.abs(found.cov[:2, :2] - cov).max() < 0.02 * sigma**2
    assert abs(told.loglik - loglik) < 0.01


def test_velocity_follows_the_position_that_it_is_correlated_with():
    prior = tk.Gaussian(WIDE.mean, WIDE.cov + 0.0)
    cov = prior.cov.copy()
    cov[0, 2] = cov[2, 0] = 0.8 * 3000.0 * 10.0
    prior = tk.Gaussian(prior.mean, cov)
    after, _ = RangeParameterised().update(
        prior, azimuth(0.01).at(sx=0.0, sy=0.0), np.array([0.69])
    )
    members = after.sum.members
    slope = np.polyfit(members.mean[0, 10:30], members.mean[2, 10:30], 1)[0]
    np.testing.assert_allclose(slope, cov[0, 2] / cov[0, 0], rtol=0.1)


@pytest.mark.parametrize("convention", ["math", "north"])
def test_a_turn_of_everything_turns_the_estimate(convention):
    turn = 2.5
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    both = np.kron(np.eye(2), R)
    turned = tk.Gaussian(both @ WIDE.mean, both @ WIDE.cov @ both.T)
    sensor = azimuth(0.01, convention=convention)
    site, bank = np.array([300.0, -200.0]), RangeParameterised()
    place = np.array([4000.0, 3000.0, 0.0, 0.0])
    first, told = bank.update(WIDE, sensor, sensor.h(place, site), site)
    second, again = bank.update(turned, sensor, sensor.h(both @ place, R @ site), R @ site)
    np.testing.assert_allclose(second.moments().mean, both @ first.moments().mean, rtol=1e-9)
    np.testing.assert_allclose(
        second.moments().cov, both @ first.moments().cov @ both.T, rtol=0, atol=1e-3
    )
    np.testing.assert_allclose(again.loglik, told.loglik, rtol=1e-9)


@pytest.mark.parametrize("convention", ["math", "north"])
def test_azimuth_and_elevation_lay_members_along_a_line_in_space(convention):
    prior = tk.Gaussian(
        np.array([3000.0, 2000.0, 800.0, 0.0, 0.0, 0.0]), np.diag([1500.0**2] * 3 + [100.0] * 3)
    )
    sensor = azimuth_elevation(0.01, 0.02, convention=convention)
    site, target = np.array([10.0, 20.0, 30.0]), np.array([2500.0, 2600.0, 1200.0, 0, 0, 0])
    z = sensor.h(target, site)
    after, told = RangeParameterised(nearest=100.0).update(prior, sensor, z, site)
    assert told.ok
    members = after.sum.members
    heavy = after.weights > 0.01
    unit = (target[:3] - site) / np.linalg.norm(target[:3] - site)
    apart = members.mean[:3][:, heavy] - site[:, None]
    r = np.linalg.norm(apart, axis=0)
    off = np.linalg.norm(apart / r - unit[:, None], axis=0)
    assert off.max() < 0.01  # of the order of the sensor's error: the prior pulls a little
    across = np.array([-unit[1], unit[0], 0.0]) / np.hypot(*unit[:2])
    width = np.sqrt(np.einsum("i,ijk,j->k", across, members.cov[:3, :3][..., heavy], across))
    np.testing.assert_allclose(width, 0.01 * r * np.hypot(*unit[:2]), rtol=0.1)
    np.testing.assert_allclose(sensor.h(after.moments().mean, site), z, atol=0.02)


def test_cells_hold_the_area_and_volume_of_their_ring():
    edges = np.geomspace(50.0, 20_000.0, 33)
    for dimensions in (2, 3):
        middle, spread, size = cells(edges, dimensions)
        r = np.linspace(edges[4], edges[5], 100_001)
        weight = r ** (dimensions - 1) / np.sum(r ** (dimensions - 1))
        np.testing.assert_allclose(middle[4], (weight * r).sum(), rtol=1e-6)
        np.testing.assert_allclose(spread[4], (weight * (r - middle[4]) ** 2).sum(), rtol=1e-4)
        whole = (edges[-1] ** dimensions - edges[0] ** dimensions) / dimensions
        np.testing.assert_allclose(size.sum(), whole, rtol=1e-12)


def test_each_lane_starts_with_its_own_first_bearing():
    sensor = azimuth(0.01).at(sx=0.0, sy=0.0)
    z = np.array([[[0.7, np.nan, np.nan]], [[0.7, 0.8, np.nan]], [[0.7, 0.8, np.nan]]])
    built = tk.estimator(RangeParameterised(components=8), motion=MOTION, sensor=sensor)
    together = tk.filter(built, tk.Record(np.arange(3.0), z), WIDE)
    for lane in range(3):
        alone = tk.filter(built, tk.Record(np.arange(3.0), z[..., lane]), WIDE)
        np.testing.assert_allclose(
            together.filtered.mean[..., lane], alone.filtered.mean, rtol=1e-9, atol=1e-6
        )
    predicted = tk.estimator("kf", motion=MOTION, sensor=position(1.0))
    nothing = tk.filter(predicted, tk.Record(np.arange(3.0), np.full((3, 2), np.nan)), WIDE)
    np.testing.assert_allclose(
        together.filtered.cov[..., 2], nothing.filtered.cov, rtol=1e-12, atol=1e-12
    )


def test_what_is_no_direction_updates_the_members_and_starts_nothing():
    built = tk.estimator(
        RangeParameterised(components=4), motion=MOTION,
        sensor=[position(50.0), azimuth(0.01).at(sx=0.0, sy=0.0)],
    )  # fmt: skip
    state = built.begin(WIDE)
    state, _ = built.step(state, [6100.0, 5100.0], 1.0, sensor=0)
    assert state.started == 0.0
    state, told = built.step(state, [0.69], 1.0, sensor=1)
    assert state.started == 1.0
    assert told.ok


def test_a_sensor_that_hides_where_it_is_is_refused():
    def measure(x, y, *, px, py):
        from tracker.models import atan2

        return (atan2(y - py, x - px),)

    sensor = ComponentSensor(
        name="hidden", measure=measure, noise=lambda: ((1e-4,),),
        space=tk.Space.of("azimuth [rad] circular"), parameters={"px": 500.0, "py": 0.0},
    )  # fmt: skip
    with pytest.raises(CapabilityError, match="sx, sy"):
        RangeParameterised().update(WIDE, sensor, np.array([0.7]))


def test_ranges_must_be_in_order():
    with pytest.raises(DomainError, match="nearest"):
        RangeParameterised(nearest=100.0, farthest=50.0)
    with pytest.raises(DomainError, match="farthest"):
        RangeParameterised(farthest=np.inf)
    assert SPATIAL.position == (0, 1, 2)


def test_merging_goes_on_after_a_member_was_given_up():
    """Its place weighs nothing, so that merging it would cost nothing, and change nothing."""
    rule = GaussianSumFilter("ekf1")
    mean = np.array([[0.0, 0.1, 10.0, 10.1, 20.0]])
    state = tk.Gaussian.trusted(mean, np.ones((1, 1, 5)))
    belief = GaussianSum(state, np.full(5, -np.log(5.0)), (False,))
    for _ in range(3):
        belief = merged(belief, 0.5, rule.filter)
    assert np.sort(belief.weights) == pytest.approx([0.0, 0.0, 0.2, 0.4, 0.4]), (
        "two pairs are close"
    )


@pytest.mark.parametrize("members", [2, 3])
def test_noise_that_differs_between_lanes_is_that_of_all_members(members):
    """As many members as lanes, or as measured components: nothing may broadcast over the wrong axis."""
    sigma, density = np.array([0.5, 2.0]), np.array([0.1, 3.0])
    plain, still = position(1.0), constant_velocity(1.0)
    R, dt = np.einsum("ij,b->ijb", np.eye(2), sigma**2), 1.0
    Q = still.Q(PRIOR.mean, dt)[..., None] * density
    rule = GaussianSumFilter("ekf1", components=members)
    z = np.random.default_rng(4).standard_normal((2, 2))

    def after(motion, sensor):
        prior = tk.Gaussian(np.repeat(PRIOR.mean[:, None], 2, axis=1), PRIOR.cov)
        state = rule.predict(rule.begin(prior, motion), motion, dt)
        return rule.update(state, sensor.over(motion.space), z)[0].moments()

    want = after(constant_velocity(density), position(sigma))
    for motion in (
        with_process_noise(still, Q),
        with_scaled_process_noise(still, np.ones((4, 1)) * density),
    ):
        for sensor in (with_noise(plain, R), with_scaled_noise(plain, np.ones((2, 1)) * sigma**2)):
            found = after(motion, sensor)
            np.testing.assert_allclose(found.mean, want.mean, atol=1e-12)
            np.testing.assert_allclose(found.cov, want.cov, atol=1e-12)


@pytest.mark.parametrize("name", ["bootstrap", "auxiliary", "regularised"])
@pytest.mark.parametrize("mixture", ["gaussian_sum", "range_parameterised", "imm"])
def test_a_mixture_refuses_members_that_draw_random_numbers(mixture, name):
    option = "filters" if mixture == "imm" else "filter"
    for value in (tk.filters.make(name), name):
        with pytest.raises(
            CapabilityError, match="which draws random numbers; expected a Gaussian"
        ):
            tk.filters.make(mixture, **{option: value})
    if mixture == "imm":
        with pytest.raises(CapabilityError, match="BootstrapFilter"):
            tk.filters.make(mixture, filters=["ekf1", "bootstrap"])
