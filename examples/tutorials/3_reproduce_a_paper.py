"""
A paper reproduced: a ship between two coasts
=============================================

Two stations on islands measure the azimuth of a ship on its way out of the Persian Gulf, through the
Strait of Hormuz, into the Sea of Oman. The paper that this page is about (`paper 0
<../reference/papers.html>`_) tracks the ship with three filters, EKF1, EKF2 and UKF, smooths each result
by the Rauch-Tung-Striebel recursion, and prints six numbers and eleven figures. Here we run its
problem, meet two of its misprints, and ask whether its numbers can be had again.

One command does all of it, at 1,000 runs, with a verdict for each number, claim and misprint::

    tracker reproduce 0 --out build/paper0
"""

import matplotlib.pyplot as plt
import numpy as np

import tracker as tk
from tracker.metrics.resampling import spread_of_mean
from tracker.reproduction import Published, Reading, verdict

scene = tk.scenario("gulf_to_oman", preset="A")
print(scene.summary)

# %%
# The problem
# -----------
# The paper shows the path as a picture only, so the scenario draws a spline through points read off from
# it. It does not say how often the stations measure, how fast the ship goes, or what the filters are
# told of its start; presets "A" and "B" are two readings of that. Lengths are the paper's scaled units.

runs = scene.simulate(seed=4, runs=1)
truth, z = runs.truth[:, :2, 0], np.asarray(runs.record.z)[..., 0]
stations = np.array([[1.0, 1.0], [4.0, 1.1]])

fig, ax = plt.subplots(figsize=(7, 4.4), layout="constrained")
for k in range(0, len(truth), 8):  # every eighth pair of bearings
    for (sx, sy), angle, colour in zip(stations, z[k], ("tab:blue", "tab:orange"), strict=True):
        reach = 1.1 * np.hypot(*(truth[k] - (sx, sy)))
        ax.plot(
            [sx, sx + reach * np.cos(angle)], [sy, sy + reach * np.sin(angle)], color=colour, lw=0.7
        )
ax.plot(*truth.T, "k.-", label="true path")
ax.plot(*stations.T, "^", color="black", ms=10, label="stations, measured bearings")
ax.set(xlabel="x [scaled units]", ylabel="y [scaled units]", aspect="equal")
ax.legend(loc="lower left")

# %%
# Twice the ship crosses the line that joins the stations. There the two bearings lie on one line and
# say nothing about where on it the ship is.
#
# Three filters and their smoothers
# ---------------------------------
# All see the same 300 sequences of measurements.

NAMES = {"EKF1": "ekf1", "EKF2": "ekf2", "UKF": "ukf_symmetric"}
estimators = {
    title: tk.estimator(name, motion=scene.motion, sensor=scene.sensor, smoother="rts")
    for title, name in NAMES.items()
}
campaign = tk.monte_carlo(estimators, scene, runs=300, seed=1)
print(campaign.summary("rmse", "diverged"))

# %%
# Look at the distance between mean and median. Most runs are alike; a few start so badly that they are
# far off for a while, and they carry the mean. The paper prints means of 100 runs. Such a mean is a
# matter of luck, and one has to know how much of it before comparing anything.

fig, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
for title, stages in campaign.scores.items():
    for stage, line in (("filter", "-"), ("smoother", "--")):
        values = np.sort(stages[stage].per_run["rmse"])
        colour = f"C{list(NAMES).index(title)}"
        ax.step(values, np.arange(1, len(values) + 1) / len(values), line, color=colour,
                label=title if stage == "filter" else f"{title} + RTS")  # fmt: skip
ax.set(xscale="log", xlabel="RMSE of a run [scaled units]", ylabel="share of runs", ylim=(0, 1))
ax.legend()

# %%
# Are the paper's numbers ours?
# -----------------------------
# Table 1 prints 0.2487 for EKF1. The question is where a mean of *100* runs would lie, had we done
# what the paper did; drawing hundreds again and again from our 300 runs tells. Runs that diverged are left
# out, as one of them would have made a printed mean several times what it is.

PRINTED = {
    ("EKF1", "filter"): "0.2487", ("EKF1", "smoother"): "0.0815",
    ("EKF2", "filter"): "0.2513", ("EKF2", "smoother"): "0.0834",
    ("UKF", "filter"): "0.2383", ("UKF", "smoother"): "0.0791",
}  # fmt: skip
rng = np.random.default_rng(0)
for (title, stage), text in PRINTED.items():
    scores = campaign.scores[title][stage]
    values = scores.per_run["rmse"][~scores.diverged]
    spread = spread_of_mean(values, 100, rng=rng)
    number = Published(f"{title}/{stage}", "Table 1", f"{title}, {stage}", text, runs=100)
    word, _ = verdict(number, scores.rmse, [Reading("A", spread.low, spread.high)])
    print(f"{title:5}{stage:9} printed {text}, a mean of 100 runs: "
          f"{spread.low:.3f} to {spread.high:.3f}  {word}")  # fmt: skip

# %%
# Most are what preset A gives; for EKF2 this is not a fair question, as we run it with an equation that
# the paper does not print.
#
# Two misprints, and what they do
# -------------------------------
# Equation 10 lacks the second-order part of the innovation covariance, though the analogous equation 9
# has it. The option ``second_order_innovation=False`` is the equation as printed. Equation 33
# prints second derivatives of the azimuth that are no derivatives; the reproduction keeps them for one
# purpose, to show the harm.

from tracker_papers.paper0.methods import with_printed_hessian  # noqa: E402

as_printed = tk.filters.make("ekf2", second_order_innovation=False)
versions = {
    "EKF1": estimators["EKF1"],
    "EKF2": estimators["EKF2"],
    "eq. 10 as printed": tk.estimator(
        as_printed, motion=scene.motion, sensor=scene.sensor, smoother="rts"
    ),
    "eq. 33 as printed": next(iter(with_printed_hessian(scene).values())),
}
compared = tk.monte_carlo(versions, scene, runs=300, seed=1)
for title, stages in compared.scores.items():
    print(f"{title:18} median RMSE {stages['filter'].percentile('rmse', 50)[0]:.3f}, "
          f"smoothed {stages['smoother'].percentile('rmse', 50)[0]:.3f}, "
          f"90th percentile {stages['filter'].percentile('rmse', 90)[0]:.3f}")  # fmt: skip

# %%
# Complete, EKF2 has the shortest tail of the extended filters; with the printed equation 10 it is
# no better than EKF1, which it should improve upon, and with the printed equation 33 it is useless.
#
# What smoothing is worth
# -----------------------
# The paper says that smoothing cuts the error about three times. How much is it in the middle of the
# runs, where no bad start decides?

for preset in ("A", "B"):
    there = tk.scenario("gulf_to_oman", preset=preset)
    ekf1 = tk.estimator("ekf1", motion=there.motion, sensor=there.sensor, smoother="rts")
    scored = tk.monte_carlo(ekf1, there, runs=200, seed=2).scores["estimator"]
    before, after = (scored[stage].percentile("rmse", 50)[0] for stage in ("filter", "smoother"))
    print(f"preset {preset}: {before:.3f} before, {after:.3f} after: {before / after:.1f} times")

# %%
# One and a half to two and a half times. In the steady state theory says twice, for a target of constant
# velocity with white acceleration that is measured often; three times needs help from the start.
#
# What to take home
# -----------------
# * A number from a paper is compared with what chance allows, by a rule fixed before looking.
# * Where a few runs carry the mean, say so: medians and counts of diverged runs belong beside it.
# * An equation is checked before it is used. Each of the paper's misprints has a test here that shows it;
#   ``tracker reproduce 0`` lists them, and writes the eleven figures, the verdicts and the reasons.

if __name__ == "__main__":
    plt.show()
