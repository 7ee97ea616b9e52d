"""Four resampling schemes: unbiased, ordered in variance, safe with weights that are not weights.

Seeds are fixed; a stated false alarm is that of a seed drawn anew.
"""

from typing import Any

import numpy as np
import pytest

from tracker.errors import DomainError
from tracker_particle.resampling import SCHEMES, scheme

every = pytest.mark.parametrize("name", list(SCHEMES))
TRIALS = 4000


def counted(name: str, weights: Any, trials: int = TRIALS, seed: int = 1) -> Any:
    """Copies of each particle, ``(N, trials)``: each trial is a lane."""
    rule, count = SCHEMES[name], len(weights)
    uniform = np.random.default_rng(seed).random((rule.numbers(count), trials))
    ancestors = rule(np.repeat(weights[:, None], trials, axis=1), uniform)
    return np.stack([(ancestors == i).sum(axis=0) for i in range(count)])


def weights_of(count: int = 20) -> Any:
    weights = np.random.default_rng(7).exponential(size=count)
    return weights / weights.sum()


@every
def test_the_expected_number_of_copies_is_n_times_the_weight(name: str) -> None:
    weights = weights_of()
    copies = counted(name, weights)
    assert (copies.sum(axis=0) == len(weights)).all(), "particles are lost or made"
    # At most multinomial variance; 20 particles, 6 sigma: false alarm below 20 * 2e-9.
    sigma = np.sqrt(len(weights) * weights * (1.0 - weights) / TRIALS)
    gap = np.abs(copies.mean(axis=1) - len(weights) * weights) / sigma
    assert gap.max() < 6.0, f"{name} is biased by {gap.max():.1f} standard errors"


@pytest.mark.parametrize(
    ("name", "share"), [("systematic", 0.3), ("stratified", 0.4), ("residual", 0.7)]
)
def test_it_varies_less_than_independent_draws(name: str, share: float) -> None:
    weights = weights_of()
    ours, theirs = (counted(n, weights).var(axis=1).sum() for n in (name, "multinomial"))
    # Over 4,000 trials either is known to about 1 %; ours are 0.17, 0.26 and 0.52 of theirs: a false
    # alarm below 1e-9.
    assert ours < share * theirs, f"{name}: {ours:.2f} against {theirs:.2f} of independent draws"


def test_independent_draws_have_the_variance_of_independent_draws() -> None:
    weights = weights_of()
    found = counted("multinomial", weights).var(axis=1).sum()
    expected = (len(weights) * weights * (1.0 - weights)).sum()
    assert abs(found / expected - 1.0) < 0.1  # about 10 standard errors


@pytest.mark.parametrize("name", ["systematic", "residual"])
def test_even_weights_keep_every_particle_once(name: str) -> None:
    for count in (1, 3, 7, 1000):
        weights = np.exp(np.full(count, -np.log(count)))
        assert (counted(name, weights, 50) == 1).all(), "weights that are even in all but rounding"


@every
def test_a_particle_without_weight_has_no_copies(name: str) -> None:
    log_weights = np.array([-np.inf, 0.0, -np.inf, -1.0, -np.inf])
    copies = counted(name, np.exp(log_weights))
    assert (copies[[0, 2, 4]] == 0).all()


@every
@pytest.mark.parametrize("extreme", [0.0, 1.0 - 2.0**-53])
def test_the_ends_of_the_uniforms_do_no_harm(name: str, extreme: float) -> None:
    rule = SCHEMES[name]
    for weights in (weights_of(1000), np.array([1.0]), np.array([1.0, 0.0, 0.0])):
        uniform = np.full(rule.numbers(len(weights)), 0.5)
        uniform[-1] = uniform[0] = extreme
        with np.errstate(all="ignore"):
            ancestors = rule(weights, uniform)
        assert ancestors.min() >= 0
        assert (weights[ancestors] > 0.0).all(), "a particle without weight, or none at all"


@every
def test_a_lane_without_weights_keeps_its_particles_and_harms_no_neighbour(name: str) -> None:
    rule, weights = SCHEMES[name], weights_of()
    uniform = np.random.default_rng(3).random((rule.numbers(len(weights)), 3))
    lanes = np.stack([weights, np.full_like(weights, np.nan), weights[::-1]], axis=1)
    lanes[:, 1] = np.nan
    with np.errstate(all="ignore"):
        found = rule(lanes, uniform)
        nothing = rule(np.zeros_like(weights), uniform[:, 0])
    assert found[:, 1].tolist() == list(range(len(weights)))
    assert nothing.tolist() == list(range(len(weights)))
    for lane in (0, 2):
        alone = rule(np.ascontiguousarray(lanes[:, lane]), np.ascontiguousarray(uniform[:, lane]))
        assert found[:, lane].tolist() == alone.tolist(), "a lane depends on its company"


@every
def test_ancestors_ascend_and_any_batch_shape_does(name: str) -> None:
    rule, rng = SCHEMES[name], np.random.default_rng(4)
    for batch in ((), (1,), (2, 3), (2, 0)):
        weights = rng.exponential(size=(50, *batch))
        ancestors = rule(weights, rng.random((rule.numbers(50), *batch)))
        assert ancestors.shape == weights.shape
        assert (np.diff(ancestors, axis=0) >= 0).all()


@every
def test_equal_weights_are_treated_alike(name: str) -> None:
    weights = np.array([0.25, 0.125, 0.25, 0.125, 0.25])  # ties, and exact edges
    copies = counted(name, weights).mean(axis=1)
    # 4,000 trials of at most 1 copy more or less: 6 standard errors.
    assert np.abs(copies - 5 * weights).max() < 6.0 / np.sqrt(TRIALS)


def test_systematic_copies_differ_from_n_times_the_weight_by_less_than_one() -> None:
    weights = weights_of(1000)
    assert np.abs(counted("systematic", weights, 20) - 1000 * weights[:, None]).max() < 1.0


@pytest.mark.parametrize("name", ["residual", "stratified"])
def test_what_is_certain_is_not_left_to_chance(name: str) -> None:
    weights = weights_of()
    fewest = {"residual": 0.0, "stratified": 1.0}[name]
    copies = counted(name, weights)
    assert (copies >= np.floor(len(weights) * weights)[:, None] - fewest).all()


def test_the_multinomial_scheme_merges_as_a_search_would() -> None:
    rng, rule = np.random.default_rng(5), SCHEMES["multinomial"]
    weights, uniform = rng.exponential(size=300), rng.random(301)
    teeth = np.cumsum(-np.log1p(-uniform))
    expected = np.searchsorted(np.cumsum(weights) / weights.sum(), teeth[:-1] / teeth[-1], "right")
    assert rule(weights, uniform).tolist() == expected.tolist()


def test_an_unknown_scheme_is_refused_in_words_and_any_other_value_taken() -> None:
    with pytest.raises(DomainError, match="systematic, stratified, residual, multinomial"):
        scheme("best")
    mine = SCHEMES["residual"]
    assert scheme(mine) is mine
