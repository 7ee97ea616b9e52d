"""NEES and NIS of the Kalman filter where theory says exactly what they are: linear and Gaussian.

Seeds are fixed, so a test passes always or never; the stated probability is that of a wrong alarm
had the seed been drawn anew.
"""

import pytest

import tracker as tk
from tracker.metrics.consistency import chi_square_band

RUNS = 1000
STEPS = 200
EVERY = 10
PROBABILITY = 0.999
SEED = 20
TESTED = len(range(EVERY - 1, STEPS, EVERY))
FALSE_ALARM = TESTED * (1.0 - PROBABILITY)
"""At most, however the steps of a run are correlated: 2 %."""

pytestmark = pytest.mark.statistical


def campaign(**parameters: float) -> tk.Campaign:
    scenario = tk.scenario("line", steps=STEPS, **parameters)
    estimator = tk.estimator("kf", motion=scenario.motion, sensor=scenario.sensor, smoother="rts")
    return tk.monte_carlo(estimator, scenario, runs=RUNS, seed=SEED)


def test_nees_of_the_filter_lies_in_its_band_at_every_tenth_step() -> None:
    scores = campaign().scores["estimator"]["filter"]
    band = chi_square_band(scores.n * RUNS, PROBABILITY, per=RUNS)
    for step in range(EVERY - 1, STEPS, EVERY):
        value = scores.per_step["nees"][step]
        assert scores.per_step["finite"][step] == RUNS
        assert band.low <= value <= band.high, (
            f"at step {step} the mean NEES is {value:.4f}, outside [{band.low:.4f}, {band.high:.4f}]:"
            f" the filter is {band.verdict(value)} (wrong alarm of this test: {FALSE_ALARM:.0%})"
        )


def test_nees_of_the_smoother_lies_in_its_band_at_every_tenth_step() -> None:
    scores = campaign().scores["estimator"]["smoother"]
    band = chi_square_band(scores.n * RUNS, PROBABILITY, per=RUNS)
    outside = [
        (step, float(scores.per_step["nees"][step]))
        for step in range(EVERY - 1, STEPS, EVERY)
        if not band.low <= scores.per_step["nees"][step] <= band.high
    ]
    assert not outside, f"mean NEES outside [{band.low:.4f}, {band.high:.4f}]: {outside}"


def test_nis_over_all_runs_and_steps_lies_in_its_band() -> None:
    scores = campaign().scores["estimator"]["filter"]
    band = scores.nis_band(PROBABILITY)  # wrong alarm: 0.1 %
    assert band.low <= scores.mean_nis <= band.high, (
        f"NIS / m is {scores.mean_nis:.5f}, outside [{band.low:.5f}, {band.high:.5f}]"
    )


@pytest.mark.parametrize(
    ("claimed", "verdict"), [(0.025, "overconfident"), (0.4, "underconfident")]
)
def test_a_filter_told_the_wrong_noise_is_found_out(claimed: float, verdict: str) -> None:
    scenario = tk.scenario("line", steps=STEPS)
    wrong = scenario.motion.with_parameters(density=claimed)
    estimator = tk.estimator("kf", motion=wrong, sensor=scenario.sensor)
    scores = tk.monte_carlo(estimator, scenario, runs=RUNS, seed=SEED).scores["estimator"]["filter"]
    band = chi_square_band(scores.n * RUNS, PROBABILITY, per=RUNS)
    assert band.verdict(float(scores.per_step["nees"][-1])) == verdict
