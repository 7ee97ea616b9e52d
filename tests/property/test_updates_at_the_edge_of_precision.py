"""What an update does where double precision ends: it says so, and its likelihood does not underflow."""

import numpy as np
import pytest

import tracker as tk
from tracker.algebra import condition
from tracker.models.graph import Graph, evaluate


def priors(scale, count=100, n=4):
    rng = np.random.default_rng(3)
    root = rng.standard_normal((n, n, count)) * np.sqrt(scale * 1e-6)
    cov = np.einsum("ik...,jk...->ij...", root, root)
    H = np.repeat(np.eye(2, n)[..., None], count, axis=2)
    HP = np.einsum("ai...,ij...->aj...", H, cov)
    S = np.einsum("aj...,bj...->ab...", HP, H)
    S = 0.5 * (S + S.swapaxes(0, 1)) + 1e-6 * np.eye(2)[..., None]
    return (
        rng.standard_normal((n, count)),
        cov,
        rng.standard_normal((2, count)),
        S,
        HP.swapaxes(0, 1),
    )


@pytest.mark.parametrize("scale", [1e2, 1e8, 1e12])
def test_variances_stay_positive_up_to_a_million_million(scale):
    _, cov, nis, _, _ = condition(*priors(scale))
    assert np.einsum("ii...->i...", cov).min() > 0
    assert np.isfinite(nis).all()


@pytest.mark.parametrize("scale", [1e16, 1e18])
def test_a_negative_variance_is_never_passed_on_as_an_estimate(scale):
    with np.errstate(all="ignore"):
        _, cov, nis, loglik, _ = condition(*priors(scale))
    negative = (np.einsum("ii...->i...", cov) < 0).any(axis=0)
    assert negative.any(), "the case that this test is for did not occur"
    assert np.isnan(nis[negative]).all()
    assert np.isnan(loglik[negative]).all()
    for lane in range(100):  # one run says the same as a lane
        parts = [a[..., lane].copy() for a in priors(scale)]
        one = condition(*parts)
        assert np.isnan(one[2]) or one[1].diagonal().min() >= 0


@pytest.mark.parametrize("m", [1, 3, 4, 5, 8, 40])
def test_the_likelihood_of_many_tiny_variances_is_finite_and_right(m):
    rng = np.random.default_rng(m)
    S = np.diag(10.0 ** rng.uniform(-20, -16, m))
    v = np.sqrt(S.diagonal()) * rng.standard_normal(m)
    mean, cov, cross = np.zeros(2), np.eye(2), np.zeros((2, m))
    expected = -0.5 * (np.log(S.diagonal()) + v**2 / S.diagonal() + np.log(2 * np.pi)).sum()
    one = condition(mean, cov, v, S, cross)[3]
    lanes = condition(*(a[..., None] for a in (mean, cov, v, S, cross)))[3][0]
    graph = Graph()
    nodes = np.empty(m, dtype=object)
    nodes[:] = [graph.input(f"v{i}") for i in range(m)]
    traced = condition(
        mean.astype(object), cov.astype(object), nodes, S.astype(object), cross.astype(object)
    )[3]
    value = evaluate([traced], {f"v{i}": v[i] for i in range(m)})[0]
    assert [one, lanes, value] == pytest.approx([expected] * 3, rel=1e-12)


def interpreted(way, mean, cov, v, S, cross):
    """`condition` of one run under one of the three interpretations: covariance, nis, loglik."""
    if way == "one run":
        _, after, nis, loglik, _ = condition(mean, cov, v, S, cross)
        return after, nis, loglik
    if way == "lanes":
        parts = [a if a is None else a[..., None] for a in (mean, cov, v, S, cross)]
        _, after, nis, loglik, _ = condition(*parts)
        return None if after is None else after[..., 0], nis[0], loglik[0]
    graph, inputs = Graph(), {}

    def nodes(name, values):
        out = np.empty(values.shape, dtype=object)
        for place in np.ndindex(*values.shape):
            label = f"{name}{sorted(place) if name in 'PS' else place}"  # symmetric
            inputs[label] = values[place]
            out[place] = graph.input(label)
        return out

    given = (("x", mean), ("P", cov), ("v", v), ("S", S), ("c", cross))
    parts = [a if a is None else nodes(name, a) for name, a in given]
    _, after, nis, loglik, _ = condition(*parts)
    entries = [] if after is None else after.ravel().tolist()
    *entries, nis, loglik = evaluate([*entries, nis, loglik], inputs)
    return None if after is None else np.reshape(entries, after.shape), nis, loglik


WAYS = ["one run", "lanes", "components"]


def a_measurement_of_one(variances, R):
    """Arguments of `condition`: independent components, of which the first is measured."""
    P = np.diag(np.asarray(variances, dtype=float))
    return np.zeros(len(P)), P, np.array([0.5]), P[:1, :1] + R, P[:, :1]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("R", [1e-6, 1e2, 0.0])
def test_a_variance_of_which_only_rounding_is_left_is_not_ok(way, R):
    """It may come out as exactly zero: the filter would be certain of what it hardly knows."""
    cov, nis, loglik = interpreted(way, *a_measurement_of_one([1e18, 1.0], R))
    assert not 0.9 < cov[0, 0] / max(R, 1e-9) < 1.1, "the case that this test is for did not occur"
    assert np.isnan([nis, loglik]).all(), f"variance {cov[0, 0]} of {R} passes for an estimate"


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("variances", [[1.0, 1e18], [1.0, 0.0], [1.0, -1e-17]])
def test_what_is_not_measured_is_not_lost(way, variances):
    """A variance of zero, or one that rounding has made negative before, is none of this update's."""
    cov, nis, _ = interpreted(way, *a_measurement_of_one(variances, 2.0**-40))
    assert cov[0, 0] == pytest.approx(2.0**-40, rel=1e-3)
    assert cov[1, 1] == variances[1]
    assert nis == pytest.approx(0.25)


@pytest.mark.parametrize("way", WAYS)
def test_who_finds_the_covariance_by_itself_is_told_the_rest(way):
    mean, _, v, S, cross = a_measurement_of_one([1e18, 1.0], 1e-6)
    after, nis, loglik = interpreted(way, mean, None, v, S, cross)
    assert after is None
    assert nis == pytest.approx(0.25e-18)
    assert loglik == pytest.approx(-0.5 * np.log(2.0 * np.pi * 1e18))
    well = a_measurement_of_one([4.0, 1.0], 1.0)
    assert interpreted(way, well[0], None, *well[2:])[1:] == interpreted(way, *well)[1:]


@pytest.mark.parametrize("variance", [1e12, 1e18])
@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("compiled", [False, True])
def test_other_forms_go_where_the_default_cannot(variance, batch, compiled, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "on" if compiled else "off")
    sensor = tk.sensors.make("position", sigma=1e-3)
    motion = tk.motions.make("constant_velocity", density=0.1)
    cov = np.diag([variance, variance, 1.0, 1.0])
    prior = tk.Gaussian(np.zeros((4, *batch)), cov)
    record = tk.Record(np.zeros(1), np.ones((1, 2, *batch)))
    told = {}
    for name in ("ekf1", "ekf1_joseph", "square_root", "information"):
        est = tk.estimator(name, motion=motion, sensor=sensor)
        history = tk.filter(est, record, prior)
        told[name] = history.innovation.ok.all()
        if name != "ekf1":
            found = history.filtered.cov[0, [0, 1], [0, 1]]
            np.testing.assert_allclose(found, 1e-6, rtol=1e-6, err_msg=name)
    assert told == {"ekf1": False, "ekf1_joseph": True, "square_root": True, "information": True}


TAKEN = ["kf", "ekf1", "ekf2", "iekf", "iplf", "ukf", "ukf_general", "ckf", "huber", "student_t", "gaussian_sum",
         "imm", "strong_tracking", "variational_bayes", "smooth_variable_structure",
         "schmidt(considered=['vx'])", "schmidt(considered=['x'])"]  # fmt: skip


def losing(rule, lanes=5):
    """A record of which the first update takes all digits in lane 1, and what a filter makes of it."""
    sensor = tk.sensors.make("position", sigma=1e-3)
    motion = tk.motions.make("constant_velocity", density=0.1)
    variance = np.where(np.arange(lanes) == 1, 1e18, 1.0)
    cov = np.eye(4)[..., None] * np.stack([variance, variance, *np.ones((2, lanes))])[:, None]
    z = np.random.default_rng(3).normal(0.0, 1.0, (6, 2, lanes))
    z[3, 0] = np.nan
    est = tk.estimator(rule, motion=motion, sensor=sensor)
    return est, tk.Record(np.arange(6.0), z), tk.Gaussian(np.zeros((4, lanes)), cov)


@pytest.mark.parametrize("compiled", ["off", "on"])
@pytest.mark.parametrize("name", TAKEN)
def test_a_lane_that_has_lost_its_digits_is_never_ok_again(name, compiled, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", compiled)
    rule, _, options = name.partition("(")
    if options:
        rule = tk.filters.make(rule, considered=[options.split("'")[1]])
    est, record, prior = losing(rule)
    history = tk.filter(est, record, prior)
    ok = history.innovation.ok
    assert ok[:, [0, 2, 3, 4]].all()
    assert not ok[:, 1].any(), "an estimate is trusted that was not to be"
    assert np.isnan(history.filtered.mean[:, :, 1]).any(axis=1).all()
    assert np.isnan(history.innovation.nis[:, 1]).all()
    alone = tk.filter(est, tk.Record(record.t, record.z[..., [0, 2, 3, 4]]), prior[[0, 2, 3, 4]])
    np.testing.assert_array_equal(
        history.filtered.mean[..., [0, 2, 3, 4]], alone.filtered.mean, "neighbours were harmed"
    )


@pytest.mark.parametrize("compiled", ["off", "on"])
def test_nor_is_one_run_on_line(compiled, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", compiled)
    est, record, prior = losing("ekf1")
    for lane in (0, 1):
        state = prior[lane]
        for row in record.z[..., lane]:
            state, told = est.step(state, row, 1.0)
            assert bool(told.ok) is (lane == 0)
            assert bool(np.isnan(state.mean).all()) is (lane == 1)
