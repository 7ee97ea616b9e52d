"""The smoother of interacting multiple models goes back in compiled steps, on what the filter believed."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.compile import objects, run
from tracker.errors import CapabilityError
from tracker.estimation import smoothed
from tracker_kalman import InteractingMultipleModels, ModeSmoother
from tracker_motion import (
    acceleration_input,
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    switching,
)
from tracker_sensors import position

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

CHAIN = [[0.9, 0.1], [0.3, 0.7]]
TWO = switching([constant_velocity(0.01), constant_velocity(10.0)], CHAIN)
UNEVEN = switching(
    [constant_velocity(0.01), coordinated_turn(0.05, 0.1)], rates=[[0, 0.1], [0.2, 0]]
)
MOTIONS = {
    "one": constant_velocity(0.1),
    "two": TWO,
    "three": switching(
        [constant_velocity(density) for density in (0.01, 1.0, 100.0)],
        0.85 * np.eye(3) + 0.05,
    ),
    "of two sizes": UNEVEN,
    "never reached": switching(TWO.modes, np.eye(2), initial=[1.0, 0.0]),
}


def problem(
    motion: Any, batch: tuple[int, ...] = (5,), rule: Any = "imm", steps: int = 20, **more: Any
) -> tuple[tk.Estimator, tk.History]:
    """A filtered record of uneven times, some equal, and missing components."""
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.choice([0.0, 0.5, 1.0], steps))
    z = np.cumsum(rng.standard_normal((steps, 2, *batch)), axis=0)
    z[rng.uniform(size=z.shape) < 0.15] = np.nan
    n = motion.space.size
    built = tk.estimator(rule, motion=motion, sensor=position(1.0), smoother="imm_smoother")
    prior = tk.Gaussian(np.zeros(n), np.diag(([4.0] * 2 + [1.0] * n)[:n]))
    return built, tk.filter(built, tk.Record(t, z, **more), prior, start=0.0)


def both(monkeypatch: Any, built: tk.Estimator, history: tk.History) -> list[tk.History]:
    out = []
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        out.append(smoothed(built, history))
    return out


def agree(found: tk.History, arrays: tk.History) -> None:
    sigma = np.sqrt(np.einsum("kii...->ki...", arrays.filtered.cov))
    size = 1e-9 * (sigma + np.abs(arrays.smoothed.mean))
    assert (np.abs(found.smoothed.mean - arrays.smoothed.mean) <= size).all()
    apart = np.abs(found.smoothed.cov - arrays.smoothed.cov)
    assert (apart <= 1e-9 * sigma[:, :, None] * sigma[:, None]).all()
    for one, other in zip(found.beliefs.smoothed, arrays.beliefs.smoothed, strict=True):
        assert np.abs(one.probabilities - other.probabilities).max() <= 1e-9
        for a, b in zip(one.members, other.members, strict=True):
            np.testing.assert_allclose(a.moments().mean, b.moments().mean, rtol=1e-9, atol=1e-8)
    last = found.filtered.at(-1)
    assert np.array_equal(found.smoothed.mean[-1], last.mean)
    assert np.array_equal(found.smoothed.cov[-1], last.cov)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_compiled_smoother_of_modes_agrees_with_the_arrays(monkeypatch, motion):
    agree(*both(monkeypatch, *problem(motion)))


@pytest.mark.parametrize("batch", [(), (1,), (11,), (2, 3)], ids=str)
def test_over_any_batch(monkeypatch, batch):
    agree(*both(monkeypatch, *problem(TWO, batch)))


@pytest.mark.parametrize("missing", ["zero", "prior", "common"])
@pytest.mark.parametrize("rule", ["ekf1", "ukf", "square_root"])
def test_after_any_filter_of_modes(monkeypatch, rule, missing):
    filters = InteractingMultipleModels(rule, missing=missing)
    agree(*both(monkeypatch, *problem(UNEVEN, rule=filters)))


def test_after_a_filter_of_one_mode_moments_are_enough(monkeypatch):
    built, history = problem(constant_velocity(0.1), rule="ekf1")
    found, arrays = both(monkeypatch, built, history)
    agree(found, arrays)
    want = tk.smoothers.make("rts").smooth(history, built.motion).smoothed
    np.testing.assert_allclose(found.smoothed.cov, want.cov, rtol=1e-8, atol=1e-10)


def test_with_inputs_and_numbers_per_lane(monkeypatch):
    pushed = switching([acceleration_input(sigma=0.05), constant_velocity(5.0)], CHAIN)
    u = np.random.default_rng(1).standard_normal((20, 2, 5))
    agree(*both(monkeypatch, *problem(pushed, u=u)))
    each = TWO.with_parameters(density_1=np.geomspace(0.01, 1.0, 5))
    agree(*both(monkeypatch, *problem(each)))


def test_bits_do_not_depend_on_the_batch_and_a_lost_lane_harms_no_neighbour(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    built, history = problem(TWO, (21,))
    whole = smoothed(built, history, workers=2)
    for lanes in (slice(0, 1), slice(3, 20)):
        some = smoothed(built, tk.estimation._history_lanes(history, lanes))
        assert np.array_equal(some.smoothed.mean, whole.smoothed.mean[..., lanes])
        assert np.array_equal(
            some.beliefs.smoothed[0].probabilities,
            whole.beliefs.smoothed[0].probabilities[:, lanes],
        )
    rest = np.arange(21) != 4
    kept = history.beliefs
    ill = []
    for belief in kept.filtered:
        mean = belief.members[0].mean.copy()
        mean[:, 4] = np.nan
        lost = tk.Gaussian.trusted(mean, belief.members[0].cov)
        ill.append(attrs.evolve(belief, members=(lost, *belief.members[1:])))
    bad = attrs.evolve(history, beliefs=attrs.evolve(kept, filtered=tuple(ill)))
    other = smoothed(built, bad)
    assert np.array_equal(other.smoothed.mean[..., rest], whole.smoothed.mean[..., rest])
    assert np.isnan(other.smoothed.mean[0, :, 4]).all()


def test_a_campaign_scores_the_same_compiled_and_on_arrays(monkeypatch):
    scene, found = tk.scenario("line", steps=25, axes=2), []
    motion = switching([scene.motion, constant_velocity(2.0)], CHAIN)
    built = tk.estimator("imm", motion=motion, sensor=scene.sensor, smoother="imm_smoother")
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        found.append(tk.monte_carlo(built, scene, runs=40, seed=1).scores["estimator"])
    for stage in ("filter", "smoother"):
        for part in ("per_run", "per_step"):
            one, other = (getattr(scores[stage], part) for scores in found)
            for name in one:
                np.testing.assert_allclose(one[name], other[name], rtol=1e-7, err_msg=name)


def test_looking_back_on_line_is_the_same(monkeypatch):
    ends = []
    for mode in ("require", "off"):
        built = tk.estimator("imm", motion=TWO, sensor=position(1.0), smoother="imm_smoother")
        monkeypatch.setenv("TRACKER_COMPILE", "off")  # a step on line carries more than a Gaussian
        window = tk.FixedLag.begin(built, tk.Gaussian(np.zeros(4), np.eye(4)), lag=4)
        for t in (1.0, 2.0, 4.0, 3.0, 5.0, 6.5):
            window = window.step([t, -t], t)
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        ends.append(window.smoothed()[1])
    np.testing.assert_allclose(ends[0].mean, ends[1].mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ends[0].cov, ends[1].cov, rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------ what cannot be
def test_what_cannot_be_compiled_says_why(monkeypatch):
    large = switching([constant_acceleration(1.0, axes=3), constant_velocity(1.0, axes=3)], CHAIN)
    sensor = position(1.0, axes=3)
    built = tk.estimator("imm", motion=large, sensor=sensor, smoother="imm_smoother")
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    with pytest.raises(CapabilityError, match="2 modes of 9 components are too many to unroll"):
        run.why_not_backwards(built)


def test_a_history_that_does_not_hold_the_beliefs_is_left_to_the_arrays(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    built, history = problem(TWO)
    with pytest.raises(CapabilityError, match="imm_smoother"):
        smoothed(built, attrs.evolve(history, beliefs=None))
    wrong = attrs.evolve(built, motion=MOTIONS["three"])
    with pytest.raises(CapabilityError, match="beliefs in 2 modes for a motion of 3"):
        ModeSmoother().smooth(history, wrong.motion)
    assert not run.told_enough(wrong, history)
