"""The two-filter smoother against another program: where both agree, and why they differ elsewhere.

On linear problems the other program's backward filter starts from no information, and we agree. In
its demonstration with bearings (tables ``_tf``) it starts from the *last filtered estimate*, which has
used every measurement already: they count twice, and variances near the end come out up to half too
small. (Its backward filter is linearised about its own estimates, too, so that means differ from its
Rauch-Tung-Striebel tables by up to 0.08.) Ours starts from no information there as well and equals
those. Both are shown: that program's numbers, by its rule, from our filters; and, on a linear
problem, that its rule is not the solution.
"""

from typing import Any

import numpy as np
import pytest
from problems import accelerating, moments, two_bearings

import tracker as tk
from tracker.types import Array

TOLERANCE = 1e-9


def backwards_from_the_last_estimate(problem: Any, rule: Any, history: tk.History) -> tk.Trajectory:
    """The other program's rule, with our filter's updates; linear motion."""
    motion, sensor, record = problem.motion, problem.sensor, problem.record
    mean, cov = history.filtered.mean.copy(), history.filtered.cov.copy()
    state = history.filtered.at(len(history) - 1)
    for k in range(len(history) - 2, -1, -1):
        dt = float(record.t[k + 1] - record.t[k])
        state, _ = rule.update(state, sensor, record.z[k + 1])
        F, Q = motion.jacobian(state.mean, dt), motion.Q(state.mean, dt)
        half = np.linalg.solve(F, state.cov + Q)
        state = tk.Gaussian.trusted(np.linalg.solve(F, state.mean), np.linalg.solve(F, half.T))
        state = tk.Gaussian.trusted(state.mean, 0.5 * (state.cov + state.cov.T))
        mean[k], cov[k] = joined(history.filtered.at(k), state)
    return tk.Trajectory(mean, cov)


def joined(one: tk.Gaussian, other: tk.Gaussian) -> tuple[Array, Array]:
    """The product of two Gaussians."""
    K = np.linalg.solve(one.cov + other.cov, one.cov).T
    cov = one.cov - K @ one.cov
    return one.mean + K @ (other.mean - one.mean), 0.5 * (cov + cov.T)


RULES = {
    "ekf1": lambda: tk.filters.make("ekf1"),
    "ukf": lambda: tk.filters.make("ukf_general"),
}


@pytest.mark.parametrize("seed", ["seed1", "seed2", "seed3"])
@pytest.mark.parametrize("name", RULES)
def test_by_its_rule_our_filters_give_the_other_program_s_numbers(name: str, seed: str) -> None:
    problem, rule = two_bearings(seed), RULES[name]()
    found = backwards_from_the_last_estimate(problem, rule, problem.run(rule))
    problem.agrees(found, f"{name}_tf", TOLERANCE)


@pytest.mark.parametrize("seed", ["seed1", "seed2", "seed3"])
def test_from_no_information_both_smoothers_are_one(seed: str) -> None:
    problem = two_bearings(seed)
    problem.agrees(problem.run("ekf1", "two_filter").smoothed, "ekf1_rts", TOLERANCE)


def test_on_a_linear_problem_both_programs_agree() -> None:
    problem = accelerating()
    problem.agrees(problem.run("kf", "two_filter").smoothed, "kf_tf", TOLERANCE)


def test_from_the_last_estimate_measurements_count_twice() -> None:
    # On a linear problem there is one right answer: the other program's own, from no information.
    problem = accelerating()
    rule = tk.filters.make("kf")
    twice = backwards_from_the_last_estimate(problem, rule, problem.run(rule))
    _, mean, cov = moments(problem.folder / "kf_tf.csv.gz", 6)
    assert np.abs(twice.mean - mean).max() < TOLERANCE, "the best fit stays where it was"
    share = twice.cov[-2, 0, 0] / cov[-2, 0, 0]
    assert 0.45 < share < 0.55, (
        f"its variance is {share:.2f} of the right one: half, all but exactly"
    )


def test_square_root_and_fixed_lag_smoothers_agree_too() -> None:
    for name in ("square_root_rts", "fixed_lag"):
        rule = name if name != "fixed_lag" else tk.smoothers.make(name, lag=1000)
        for problem, filter_, table in (
            (two_bearings("seed1"), "ekf1", "ekf1_rts"),
            (accelerating(), "kf", "kf_rts"),
        ):
            problem.agrees(problem.run(filter_, rule).smoothed, table, TOLERANCE)
