"""Angles: exact at the cut, and nothing changes when everything turns."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tracker.algebra.angles import circular_mean, difference, wrap

ANGLES = st.floats(-1e4, 1e4)
CLOSE = st.lists(st.floats(-1.4, 1.4), min_size=1, max_size=8)


@given(ANGLES, ANGLES)
def test_a_difference_is_the_shortest_turn(a, b):
    turn = float(difference(a, b))
    assert -math.pi < turn <= math.pi
    assert math.cos(b + turn) == pytest.approx(math.cos(a), abs=1e-9)
    assert math.sin(b + turn) == pytest.approx(math.sin(a), abs=1e-9)


@given(CLOSE, st.floats(-10.0, 10.0))
def test_turning_all_angles_turns_their_mean(near, turn):
    mean = circular_mean(np.array(near) + turn)
    assert float(difference(mean, circular_mean(near) + turn)) == pytest.approx(0.0, abs=1e-12)


@given(CLOSE, st.lists(st.integers(-3, 3), min_size=8, max_size=8))
def test_whole_turns_change_nothing(near, turns):
    moved = np.array(near) + 2 * np.pi * np.array(turns[: len(near)])
    assert float(difference(circular_mean(moved), circular_mean(near))) == pytest.approx(
        0, abs=1e-12
    )


@given(CLOSE)
def test_the_mean_is_that_of_scipy(near):
    expected = stats.circmean(near, high=math.pi, low=-math.pi)
    assert float(difference(circular_mean(near), expected)) == pytest.approx(0.0, abs=1e-12)


def test_at_the_cut_the_mean_is_pi_and_never_zero():
    assert circular_mean([math.pi, -math.pi]) == math.pi
    assert circular_mean([math.pi - 0.1, -math.pi + 0.1]) == pytest.approx(math.pi)
    assert -math.pi < circular_mean([-math.pi]) <= math.pi
    assert wrap(-math.pi) in (math.pi, math.nextafter(-math.pi, 0))


def test_directions_that_cancel_have_no_mean_and_nan_stays_nan():
    assert np.isnan(circular_mean([0.0, math.pi]))
    assert np.isnan(circular_mean([0.0, math.nan]))
    assert np.isnan(circular_mean([]))


def test_weights_and_batches():
    angles = np.array([[0.1, 3.0], [0.3, -3.0]])
    np.testing.assert_allclose(circular_mean(angles), [0.2, math.pi])
    np.testing.assert_allclose(circular_mean(angles[:, 0], weights=[1.0, 0.0]), 0.1)
    np.testing.assert_allclose(circular_mean(angles.T, axis=1), [0.2, math.pi])
