"""The public strategies keep their word, and derivatives by differences are as good as they claim."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.testing import batch_shapes, covariances, poses, records, states, time_steps
from tracker.testing.differences import first, second
from tracker.testing.textbook import BEARING, MOTION
from tracker.types import PLANAR, Gaussian, Space

POSE = Space.of("sx [m]", "sy [m]", "heading [rad] circular")


@given(st.data(), batch_shapes(), st.integers(1, 6))
def test_covariances_are_symmetric_definite_and_as_conditioned_as_they_say(
    data: st.DataObject, batch: tuple[int, ...], n: int
) -> None:
    cov = data.draw(covariances(n, batch))
    assert cov.shape == (n, n, *batch)
    assert np.array_equal(cov, cov.swapaxes(0, 1))
    Gaussian(np.zeros((n, *batch)), cov)
    for lane in np.ndindex(*batch):
        values = np.linalg.eigvalsh(cov[(..., *lane)])
        assert values[-1] == pytest.approx(1.0)
        assert values[0] > 0.9e-8


@given(st.data(), batch_shapes())
def test_states_and_poses_have_the_shape_of_their_space_and_keep_apart(
    data: st.DataObject, batch: tuple[int, ...]
) -> None:
    x, pose = data.draw(states(PLANAR, batch)), data.draw(poses(POSE, batch))
    assert x.shape == (4, *batch)
    assert pose is not None
    assert pose.shape == (3, *batch)
    assert np.all(np.hypot(*(x[:2] - pose[:2])) > 100.0)
    assert data.draw(states(MOTION)).shape == (4,)
    assert data.draw(poses(BEARING)) is None


@given(records(BEARING, steps=5, batch=(2,)), time_steps(zero=False))
def test_records_are_records(record: Any, dt: float) -> None:
    assert record.z.shape == (5, 1, 2)
    assert dt > 0.0


@given(states(PLANAR, (4,)))
def test_differences_are_far_better_than_the_laws_ask(x: Any) -> None:
    def wrapped(a: Any, b: Any) -> Any:
        return np.pi - (np.pi - (a - b)) % (2 * np.pi)

    def bearing(p: Any) -> Any:
        return np.arctan2(p[1:2], p[:1])

    scale = np.maximum(np.abs(x), 30.0)
    value, error = first(bearing, x, scale, wrapped)
    square = x[0] ** 2 + x[1] ** 2
    gap = np.abs(value[0, :2] - np.stack([-x[1], x[0]]) / square)
    assert np.all(gap * np.sqrt(square) < 1e-10)
    assert np.all(error[0, :2] * np.sqrt(square) < 1e-9)
    value, error = second(bearing, x, scale, wrapped)
    gap = np.abs(value[0, 0, 1] - (x[1] ** 2 - x[0] ** 2) / square**2)
    assert np.all(gap * square < 1e-7)
    assert np.all(error[0, 0, 1] * square < 1e-6)


def test_the_kit_is_loaded_by_nobody_who_did_not_ask() -> None:
    code = (
        "import sys, tracker; from tracker.registry import default_registry; default_registry();"
        "assert 'hypothesis' not in sys.modules and 'tracker.testing' not in sys.modules;"
        "import tracker.testing; assert 'pytest' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
