"""The chi-square gate: what it admits, and what it refuses to be."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from tracker.errors import DomainError
from tracker.protocols import Gate
from tracker_association import ChiSquareGate

probabilities = st.floats(1e-6, 1.0 - 1e-9)
sizes = st.integers(1, 9)


@given(probabilities, sizes)
def test_the_threshold_is_the_quantile_of_the_chi_square_distribution(p: float, m: int) -> None:
    assert ChiSquareGate(p).threshold(m) == pytest.approx(chi2.ppf(p, m), rel=1e-9)


@given(probabilities, probabilities, sizes)
def test_a_larger_probability_gates_no_less(p: float, q: float, m: int) -> None:
    low, high = ChiSquareGate(min(p, q)), ChiSquareGate(max(p, q))
    distance = np.linspace(0.0, 60.0, 400)
    assert (low.admits(distance, m) <= high.admits(distance, m)).all()


def test_an_explicit_distance_serves_any_number_of_components_and_includes_its_edge() -> None:
    gate: Gate = ChiSquareGate(squared_distance=13.8)
    assert gate.threshold(1) == gate.threshold(7) == 13.8
    assert gate.admits(np.array([0.0, 13.8, 13.9]), 2).tolist() == [True, True, False]


@pytest.mark.parametrize("shape", [(), (3,), (2, 0), (2, 3, 4)])
def test_flags_have_the_shape_of_the_distances_and_nan_never_passes(shape: tuple[int, ...]) -> None:
    admitted = ChiSquareGate().admits(np.full(shape, np.nan), 2)
    assert np.shape(admitted) == shape
    assert not np.any(admitted)


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, 99.0, np.nan])
def test_a_probability_lies_between_0_and_1(probability: float) -> None:
    with pytest.raises(DomainError, match=r"'probability': got .*; expected .* between 0 and 1"):
        ChiSquareGate(probability)


@pytest.mark.parametrize("distance", [0.0, -1.0, np.inf, np.nan])
def test_a_distance_is_positive(distance: float) -> None:
    with pytest.raises(
        DomainError, match=r"'squared_distance': got .*; expected a positive number"
    ):
        ChiSquareGate(squared_distance=distance)


def test_nothing_measured_has_no_threshold() -> None:
    with pytest.raises(DomainError, match="at least one measured component"):
        ChiSquareGate().threshold(0)


def test_scipy_is_imported_only_for_a_quantile() -> None:
    code = (
        "import sys; from tracker_association import ChiSquareGate as G; "
        "G(squared_distance=9.0).threshold(2); assert 'scipy' not in sys.modules, 'too early'; "
        "G(0.9).threshold(2); assert 'scipy' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
