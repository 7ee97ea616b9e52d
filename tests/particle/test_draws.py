"""Numbers that belong to a lane, a step and a purpose, and are what they say they are."""

import numpy as np
import pytest
from scipy import stats

from tracker_particle import draws


def key(*batch: int, seed: int = 1) -> draws.Keys:
    return draws.keys(np.random.default_rng(seed), batch)


def test_a_lane_draws_the_same_in_any_company() -> None:
    keys = key(2, 3)
    for rows, count in ((3, 101), (1, 8), (2, 5), (4, 1)):
        whole = draws.normals(keys, 4, draws.NOISE, rows, count)
        few = draws.uniforms(keys, 4, draws.RESAMPLING, count)
        for lane in np.ndindex(2, 3):
            own = keys[(slice(None), *lane)]
            assert np.array_equal(
                whole[(..., *lane)], draws.normals(own, 4, draws.NOISE, rows, count)
            )
            assert np.array_equal(
                few[(..., *lane)], draws.uniforms(own, 4, draws.RESAMPLING, count)
            )


def test_nothing_depends_on_what_was_drawn_before() -> None:
    first = draws.normals(key(), 1, draws.NOISE, 2, 10)
    draws.uniforms(key(), 2, draws.KERNEL, 1000)
    assert np.array_equal(first, draws.normals(key(), 1, draws.NOISE, 2, 10))


def test_more_particles_go_on_where_fewer_end() -> None:
    few, many = (draws.normals(key(), 1, draws.NOISE, 2, n) for n in (10, 100))
    assert np.array_equal(few, many[:, :10])


def test_lanes_steps_purposes_and_streams_are_different_numbers() -> None:
    keys = key(2)
    samples = [
        draws.uniforms(keys[:, lane], step, purpose, 500)
        for lane in (0, 1)
        for step in (0, 1, 256)
        for purpose in (draws.START, draws.NOISE)
    ]
    streams = draws.normals(keys[:, 0], 1, draws.NOISE, 2, 8 * 500).reshape(2, 500, 8)
    samples += [streams[r, :, j] for r in range(2) for j in range(8)]
    found = np.corrcoef(samples)
    np.fill_diagonal(found, 0.0)
    # 378 correlations of 500 numbers each, 5.5 standard errors: false alarm 2e-5.
    assert np.abs(found).max() < 5.5 / np.sqrt(500)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_normals_are_normal_and_uniforms_uniform(rows: int) -> None:
    sample = draws.normals(key(), 3, draws.NOISE, rows, 40_000)
    for row in sample:  # false alarm 1e-6 each
        assert stats.kstest(row, "norm").pvalue > 1e-6
    assert abs(np.mean(sample**4) - 3.0) < 6.0 * np.sqrt(96.0 / sample.size)
    assert np.isfinite(sample).all()
    assert stats.kstest(draws.uniforms(key(), 3, draws.START, 40_000), "uniform").pvalue > 1e-6


def test_the_largest_normal_that_there_can_be_is_far_out() -> None:
    a, b = np.array([0.0, 1.0 - 2.0**-53]), np.array([0.0, 0.5])
    draws._box_muller(a, b)
    assert np.isfinite([a, b]).all()
    assert np.abs([a, b]).max() > 8.0


def test_one_generator_or_one_for_each_lane() -> None:
    together = key(4)
    assert together.shape == (2, 4)
    assert len(np.unique(together)) == 8
    each = [np.random.default_rng(i) for i in range(4)]
    alone = draws.keys([np.random.default_rng(2)], (1,))
    assert np.array_equal(draws.keys(each, (4,))[:, 2:3], alone)
    assert np.array_equal(key(4)[:, :2], key(2)), "a lane's key depends on how many there are"
