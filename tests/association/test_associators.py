"""Both associators against their laws, and against all assignments tried one by one."""

import itertools

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import ShapeError
from tracker.protocols import Associator
from tracker.types import Array
from tracker_association import GlobalNearestNeighbour, NearestNeighbour

Flags = npt.NDArray[np.bool_]
BOTH = [NearestNeighbour(), GlobalNearestNeighbour()]
both = pytest.mark.parametrize("associator", BOTH, ids=lambda a: type(a).__name__)


@st.composite
def scenes(draw: st.DrawFn, batch: tuple[int, ...] = ()) -> tuple[Array, Flags]:
    """Distances, some of them NaN, and flags of a gate."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (draw(st.integers(0, 4)), draw(st.integers(0, 4)), *batch)
    distance = rng.exponential(10.0 ** draw(st.integers(-3, 3)), shape)
    distance[rng.random(shape) < draw(st.sampled_from([0.0, 0.2]))] = np.nan
    return distance, rng.random(shape) < draw(st.sampled_from([0.3, 0.7, 1.0]))


def pairs_of(slots: npt.NDArray[np.intp], detections: int) -> list[tuple[int, int]]:
    return [(i, int(j)) for i, j in enumerate(slots) if j < detections]


def best_by_trying(distance: Array, possible: Flags) -> tuple[int, float]:
    """Most pairs, then least sum, over every way to hand detections or a miss to the tracks."""
    tracks, detections = distance.shape
    best = (0, 0.0)
    for slots in itertools.product(range(detections + 1), repeat=tracks):
        taken = [j for j in slots if j < detections]
        pairs = pairs_of(np.array(slots, dtype=np.intp), detections)
        if len(set(taken)) < len(taken) or not all(possible[pair] for pair in pairs):
            continue
        best = max(best, (len(pairs), -sum(float(distance[pair]) for pair in pairs)))
    return best[0], -best[1]


@given(scenes())
def test_global_nearest_neighbour_is_the_best_of_all_assignments(
    scene: tuple[Array, Flags],
) -> None:
    distance, admitted = scene
    slots = GlobalNearestNeighbour().associate(distance, admitted).hard
    pairs = pairs_of(slots, distance.shape[1])
    count, total = best_by_trying(distance, admitted & ~np.isnan(distance))
    assert len(pairs) == count, "a track was missed although all could be served"
    assert sum(distance[pair] for pair in pairs) == pytest.approx(total)


@both
@given(scene=scenes(batch=(3,)))
def test_rows_sum_to_one_and_nothing_is_given_twice_or_through_the_gate(
    associator: Associator, scene: tuple[Array, Flags]
) -> None:
    distance, admitted = scene
    before = distance.copy(), admitted.copy()
    weights = associator.associate(distance, admitted).weights
    tracks, detections = distance.shape[:2]
    assert weights.shape == (tracks, detections + 1, 3)
    assert np.isin(weights, (0.0, 1.0)).all()
    assert (weights.sum(axis=1) == 1.0).all()
    assert (weights[:, :-1].sum(axis=0) <= 1.0).all(), "a detection was given away twice"
    assert not weights[:, :-1][~admitted | np.isnan(distance)].any()
    np.testing.assert_array_equal(distance, before[0])
    np.testing.assert_array_equal(admitted, before[1])


@both
@given(scene=scenes(), seed=st.integers(0, 2**32 - 1))
def test_a_permutation_of_tracks_and_detections_permutes_the_answer(
    associator: Associator, scene: tuple[Array, Flags], seed: int
) -> None:
    distance, admitted = scene
    rng = np.random.default_rng(seed)
    rows, columns = (rng.permutation(length) for length in distance.shape)
    weights = associator.associate(distance, admitted).weights
    mixed = associator.associate(distance[rows][:, columns], admitted[rows][:, columns]).weights
    expected = weights[rows][:, [*columns, distance.shape[1]]]
    np.testing.assert_array_equal(mixed, expected)


@both
@given(scene=scenes(batch=(2, 2)))
def test_lanes_of_a_batch_are_associated_each_on_its_own(
    associator: Associator, scene: tuple[Array, Flags]
) -> None:
    distance, admitted = scene
    together = associator.associate(distance, admitted).weights
    for lane in np.ndindex(2, 2):
        here = (slice(None), slice(None), *lane)
        alone = associator.associate(distance[here], admitted[here]).weights
        np.testing.assert_array_equal(together[here], alone)


@both
@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0), (2, 3, 0), (2, 0, 4), (2, 3, 2, 0)])
def test_nobody_and_nothing_are_values_like_others(
    associator: Associator, shape: tuple[int, ...]
) -> None:
    weights = associator.associate(np.ones(shape), np.ones(shape, dtype=np.bool_)).weights
    assert weights.shape == (shape[0], shape[1] + 1, *shape[2:])
    assert (weights.sum(axis=1) == 1.0).all()


@given(scenes())
def test_both_agree_where_no_two_tracks_want_the_same_detection(scene: tuple[Array, Flags]) -> None:
    distance, admitted = scene
    tracks, detections = distance.shape
    own = np.arange(detections) % max(tracks, 1) == np.arange(tracks)[:, None]
    greedy, best = (a.associate(distance, admitted & own).weights for a in BOTH)
    np.testing.assert_array_equal(greedy, best)


def test_the_nearer_track_gets_the_detection_and_the_other_what_is_left() -> None:
    distance = np.array([[2.0, 5.0], [1.0, 8.0]])
    every = np.ones((2, 2), dtype=np.bool_)
    assert NearestNeighbour().associate(distance, every).hard.tolist() == [1, 0]
    only = distance < 4.0
    assert NearestNeighbour().associate(distance, only).hard.tolist() == [2, 0], "2 means missed"


def test_global_nearest_neighbour_serves_both_where_the_greedy_one_misses_a_track() -> None:
    distance = np.array([[1.0, 9.0], [3.0, 99.0]])
    admitted = distance < 13.8
    assert NearestNeighbour().associate(distance, admitted).hard.tolist() == [0, 2]
    assert GlobalNearestNeighbour().associate(distance, admitted).hard.tolist() == [1, 0]


@both
def test_shapes_that_differ_are_refused(associator: Associator) -> None:
    with pytest.raises(ShapeError, match=r"\(tracks, D, \*batch\), both alike"):
        associator.associate(np.ones((2, 3)), np.ones((2, 2), dtype=np.bool_))
    with pytest.raises(ShapeError, match=r"\(tracks, D, \*batch\)"):
        associator.associate(np.ones(3), np.ones(3, dtype=np.bool_))
