"""Laws of associators."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law
from tracker.testing.strategies import BATCHES
from tracker.types import Array

_GATE = 9.0
_SIZES = ((3, 4), (4, 2), (1, 1), (2, 0), (0, 2))


def _scan(
    case: Case, batch: tuple[int, ...] = (), size: tuple[int, int] = (3, 4)
) -> tuple[Array, Any]:
    """Squared distances, no two alike, and gate flags; a track may have diverged."""
    distance = case.rng.uniform(0.0, 15.0, (*size, *batch))
    if size[0] > 2 and case.rng.uniform() < 0.5:
        distance[0] = np.nan
    return distance, distance < _GATE


def _weights(rule: Any, distance: Array, admitted: Any) -> Array:
    return np.asarray(rule.associate(distance, admitted).weights)


@calls_of("associator")
def associator_calls(_rule: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How an associator is called."""
    distance, admitted = _scan(case, batch)
    given = (Given("distance", distance, 2), Given("admitted", admitted, 2))
    return [Call("associate", lambda r, *a: (_weights(r, *a),), given, (2,), batch)]


@law("associator", name="rows sum to one")
def rows_sum_to_one(rule: Any, case: Case) -> None:
    """Each track's weights are not negative and sum to one, the last slot being 'missed'."""
    for size in _SIZES:
        for batch in BATCHES:
            weights = _weights(rule, *_scan(case, batch, size))
            tracks, slots = size
            want = (tracks, slots + 1, *batch)
            assert weights.shape == want, f"weights have shape {weights.shape} instead of {want}"
            assert np.all(weights >= 0.0), "a weight is negative or NaN"
            total = weights.sum(axis=1)
            agree(total, np.ones(total.shape), 1e-9, "the weights of a track do not sum to one")


@law("associator", name="a detection is given away at most once")
def at_most_once(rule: Any, case: Case) -> None:
    """The weights of a detection over all tracks sum to one at most."""
    for size in _SIZES:
        total = _weights(rule, *_scan(case, (5,), size))[:, :-1].sum(axis=0)
        assert np.all(total <= 1.0 + 1e-9), (
            f"a detection is given to {float(total.max()):.3g} tracks: one target made it"
        )


@law("associator", name="outside the gate is zero")
def outside_is_zero(rule: Any, case: Case) -> None:
    """A pair that the gate does not admit has weight exactly zero, also where its distance is NaN."""
    for size in _SIZES:
        distance, admitted = _scan(case, (5,), size)
        weights = _weights(rule, distance, admitted)
        assert np.all(weights[:, :-1][~admitted] == 0.0), "a pair outside the gate has a weight"
    none = np.zeros((3, 4), dtype=bool)
    missed = _weights(rule, case.rng.uniform(0.0, 1.0, (3, 4)), none)[:, -1]
    agree(missed, np.ones(3), 0.0, "with nothing admitted, a track is not simply missed")


@law("associator", name="uses what is admitted", examples=3)
def uses_what_is_admitted(rule: Any, _case: Case) -> None:
    """A track alone with a detection where it was expected has some weight on it."""
    weights = _weights(rule, np.array([[0.1]]), np.array([[True]]))
    assert weights[0, 0] > 0.0, "the only track ignores the only detection, which is close to it"


@law("associator", name="follows permutations")
def follows_permutations(rule: Any, case: Case) -> None:
    """Tracks or detections in another order have the same weights in that order."""
    distance, admitted = _scan(case, (2,))
    weights = _weights(rule, distance, admitted)
    rows, columns = case.rng.permutation(3), case.rng.permutation(4)
    told = "the answer depends on the order of the {}"
    moved = _weights(rule, distance[rows], admitted[rows])
    agree(moved, weights[rows], 1e-9, told.format("tracks"), scale=1.0)
    moved = _weights(rule, distance[:, columns], admitted[:, columns])
    slots = np.append(columns, 4)
    agree(moved, weights[:, slots], 1e-9, told.format("detections"), scale=1.0)
