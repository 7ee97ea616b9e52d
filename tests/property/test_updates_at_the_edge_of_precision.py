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


def test_the_joseph_form_goes_where_the_default_cannot():
    sensor = tk.sensors.make("position", sigma=1e-3)
    motion = tk.motions.make("constant_velocity", density=0.1)
    prior = tk.Gaussian(np.zeros(4), np.diag([1e12, 1e12, 1.0, 1.0]))
    for name in ("ekf1", "ekf1_joseph"):
        est = tk.estimator(name, motion=motion, sensor=sensor)
        state, innovation = est.step(prior, np.array([1.0, 2.0]), 0.0)
        if name == "ekf1_joseph":
            assert innovation.ok
            assert np.diag(state.cov)[:2] == pytest.approx([1e-6, 1e-6], rel=1e-6)
        else:
            assert (not innovation.ok) or np.diag(state.cov).min() >= 0
