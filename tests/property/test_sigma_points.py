"""Sets of sigma points have the moments they claim, by closed form; covariances are refused or raised."""

import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import DomainError
from tracker_kalman.indefinite import raised, semidefinite, unless_refused
from tracker_kalman.sigma_points import (
    NAMED,
    CubatureDegree5,
    GaussHermite,
    MinimalSimplex,
    Scaled,
    SphericalSimplex,
    Symmetric,
    general,
    point_set,
)

SETS = [
    Symmetric(),
    Scaled(),
    Scaled(0.5, 2.0, 1.0),  # paper 2: the centre weighs -2.2 in means, 0.55 in covariances
    Scaled(1e-2, 2.0, 0.0),
    general(),
    general(1.0),
    SphericalSimplex(),
    SphericalSimplex(0.4),
    MinimalSimplex(),
    MinimalSimplex(0.4),
    CubatureDegree5(),
    GaussHermite(2),
    GaussHermite(3),
    GaussHermite(4),
]
seeds = st.integers(0, 2**32 - 1)


def normal_moment(powers):
    """The mean of a monomial of independent standard normals: products of double factorials."""
    if any(p % 2 for p in powers):
        return 0.0
    return float(math.prod(math.prod(range(p - 1, 0, -2)) for p in powers))


def monomials(n, degree):
    return (p for p in itertools.product(range(degree + 1), repeat=n) if sum(p) <= degree)


@pytest.mark.parametrize("rule", SETS, ids=repr)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_polynomials_of_the_claimed_degree_are_averaged_exactly(rule, n):
    made = rule.points(n)
    size = np.abs(made.mean).sum()
    for powers in monomials(n, min(rule.degree, 5)):
        terms = np.prod(made.places ** np.array(powers)[:, None], axis=0)
        scale = size * max(1.0, np.abs(terms).max())
        found = made.mean @ terms
        assert abs(found - normal_moment(powers)) < 1e-13 * scale, f"x^{powers}: {found}"


@pytest.mark.parametrize("rule", SETS, ids=repr)
@pytest.mark.parametrize("n", [1, 2, 4, 5])
def test_covariance_weights_give_the_covariance(rule, n):
    made = rule.points(n)
    found = (made.places * made.cov) @ made.places.T
    np.testing.assert_allclose(found, np.eye(n), atol=1e-12)
    np.testing.assert_array_equal(made.cross, (made.places * made.cov).T)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 7])
def test_gauss_hermite_is_exact_along_each_axis_to_twice_its_order(order):
    made = GaussHermite(order).points(2)
    for powers in itertools.product(range(2 * order), repeat=2):
        terms = np.prod(made.places ** np.array(powers)[:, None], axis=0)
        np.testing.assert_allclose(
            made.mean @ terms, normal_moment(powers), rtol=1e-11, atol=1e-11 * np.abs(terms).max()
        )
    missed = made.mean @ made.places[0] ** (2 * order)
    assert abs(missed / normal_moment((2 * order, 0)) - 1.0) > 1e-3, "one degree more is not exact"


@pytest.mark.parametrize("n", [2, 3, 4])
def test_the_degree_is_not_understated(n):
    """One even degree more fails somewhere, and simplexes have third moments."""
    for rule in (Symmetric(), CubatureDegree5(), SphericalSimplex(), MinimalSimplex()):
        made = rule.points(n)
        gaps = [
            made.mean @ np.prod(made.places ** np.array(p)[:, None], axis=0) - normal_moment(p)
            for p in monomials(n, rule.degree + 1)
        ]
        assert np.abs(gaps).max() > 1e-3, f"{rule} is better than it says"


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_the_minimal_simplex_has_no_skew_along_the_axes(n):
    made = MinimalSimplex(0.3).points(n)
    np.testing.assert_allclose(made.places**3 @ made.mean, 0.0, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_numbers_of_points(n):
    for rule, count in (
        (Symmetric(), 2 * n),
        (Scaled(), 2 * n + 1),  # the centre weighs 0 in means, but 2 in covariances
        (general(1.0), 2 * n + 1),
        (SphericalSimplex(), n + 1),
        (SphericalSimplex(0.1), n + 2),
        (MinimalSimplex(), n + 1),
        (CubatureDegree5(), 2 * n * n + 1 - (2 * n if n == 4 else 0)),
        (GaussHermite(3), 3**n),
    ):
        assert len(rule.points(n)) == count, rule


def test_the_weights_of_paper_2():
    made = Scaled(0.5, 2.0, 1.0).points(4)
    np.testing.assert_allclose(made.mean, [-2.2, *[0.4] * 8])
    np.testing.assert_allclose(made.cov, [0.55, *[0.4] * 8])
    np.testing.assert_allclose(np.abs(made.places).max(), np.sqrt(1.25))


def test_weights_are_negative_where_it_is_said():
    assert general().points(4).negative
    assert not Scaled().points(4).negative
    assert not CubatureDegree5().points(4).negative
    assert CubatureDegree5().points(5).negative


def test_the_unscented_set_at_kappa_zero_and_the_cubature_rule_are_the_same():
    np.testing.assert_array_equal(general(0.0).points(3).places, Symmetric().points(3).places)


def test_in_one_dimension_the_rules_of_degree_five_are_gauss_hermite():
    for rule in (CubatureDegree5(), general(2.0)):
        made, want = rule.points(1), GaussHermite(3).points(1)
        order = np.argsort(made.places[0])
        np.testing.assert_allclose(made.places[0, order], want.places[0], atol=1e-12)
        np.testing.assert_allclose(made.mean[order], want.mean, atol=1e-12)


def test_sets_are_values():
    assert Scaled(0.5) == Scaled(0.5) != Scaled(0.6)
    assert len({Symmetric(), Symmetric(), GaussHermite(3)}) == 2
    assert pickle.loads(pickle.dumps(GaussHermite(4))) == GaussHermite(4)
    assert not Symmetric().points(3).places.flags.writeable


@pytest.mark.parametrize("name", [*NAMED, "gauss_hermite_4"])
def test_sets_have_names(name):
    assert len(point_set(name).points(2)) > 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: point_set("octagonal"), "'points'.*octagonal.*symmetric"),
        (lambda: point_set(3), "'points'"),
        (lambda: Scaled(0.0), "'alpha'"),
        (lambda: Scaled(float("nan")), "'alpha'"),
        (lambda: Scaled(beta=float("inf")), "'beta'"),
        (lambda: general(-3.0).points(2), "'kappa'.*more than -2"),
        (lambda: SphericalSimplex(1.0), "'centre'"),
        (lambda: MinimalSimplex(-0.1), "'centre'"),
        (lambda: GaussHermite(1), "'order'"),
        (lambda: GaussHermite(2.5), "'order'"),
    ],
)
def test_what_is_no_set_is_refused_in_words(make, words):
    with pytest.raises(DomainError, match=words):
        make()


# ------------------------------------------------------------------------ indefinite covariances
def spectrum(rng, n, values):
    q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    scale = 10.0 ** rng.uniform(-4, 4, n)
    P = (q * values) @ q.T * np.outer(scale, scale)
    return (P + P.T) / 2


@given(seeds, st.integers(1, 6))
def test_only_an_indefinite_covariance_is_refused(seed, n):
    rng = np.random.default_rng(seed)
    values = rng.choice([0.0, 1e-6, 1.0, 1.0, -1e-3, -1.0], n)
    P = spectrum(rng, n, values)
    found = semidefinite(P)
    if (values < 0.0).any():
        assert np.isnan(found).all(), f"eigenvalues {values} pass"
    else:
        np.testing.assert_array_equal(found, P)


@given(seeds, st.integers(1, 6))
def test_raised_covariances_are_semidefinite_and_no_smaller(seed, n):
    rng = np.random.default_rng(seed)
    P = spectrum(rng, n, rng.choice([0.0, 1.0, 1.0, -1e-3, -1.0], n))
    found = raised(P, 1e-6)
    scale = np.sqrt(np.maximum(np.abs(np.diag(P)), 1e-300))
    assert np.linalg.eigvalsh(found / np.outer(scale, scale))[0] >= -1e-15
    np.testing.assert_array_equal(found - np.diag(np.diag(found)), P - np.diag(np.diag(P)))
    assert (np.diag(found) >= np.diag(P)).all()


@given(seeds, st.integers(1, 6))
def test_a_positive_covariance_is_not_raised(seed, n):
    rng = np.random.default_rng(seed)
    P = spectrum(rng, n, rng.uniform(0.1, 1.0, n))
    np.testing.assert_allclose(raised(P, 1e-9), P, rtol=1e-12)


def test_a_component_known_exactly_stays_so():
    P = np.diag([1.0, 0.0])
    np.testing.assert_array_equal(semidefinite(P), P)
    np.testing.assert_array_equal(raised(P, 1e-6), P)


def test_lanes_are_judged_one_by_one():
    P = np.stack([np.eye(2), [[1.0, 2.0], [2.0, 1.0]], np.full((2, 2), np.nan)], axis=-1)
    found = semidefinite(P)
    mean, nis = unless_refused(found, np.ones((2, 3)), np.arange(3.0))
    assert np.isnan(found).all(axis=(0, 1)).tolist() == [False, True, True]
    assert np.isnan(mean).all(axis=0).tolist() == [False, True, True]
    np.testing.assert_array_equal(nis, [0.0, np.nan, np.nan])
    assert np.isnan(raised(P, 1e-6)[..., 2]).any(), "NaN is no number to be raised"
