"""
Bearings only: why a straight observer cannot see range
=======================================================

A ship with passive sonar, a camera, a direction finder: all of them hear or see *where to*, not *how
far*. If the target holds its course, is a sequence of bearings enough to find it? Only if the
observer turns. This page shows why, in a picture, in six lines of linear algebra, and in what an
extended Kalman filter makes of it, which is not flattering.
"""

import attrs
import matplotlib.pyplot as plt
import numpy as np

import tracker as tk

KM = 1000.0

# %%
# The geometry
# ------------
# Take a target on a straight course, and the bearings to it from an observer on a straight course.
# Now stretch everything *relative to the observer* by one and a half: another target on a straight
# course, one and a half times as far, faster, and seen under exactly the same bearings for all time.
# Nothing in the data can tell them apart. When the observer turns, only one of the two fits.

minutes = np.arange(0.0, 21.0, 4.0)
t = 60.0 * minutes
target = np.array([[6000.0], [5000.0]]) + np.array([[3.0], [-2.0]]) * t
straight = np.stack([0.0 * t, 5.0 * t])
turning = np.stack([5.0 * np.maximum(t - 480.0, 0.0), 5.0 * np.minimum(t, 480.0)])
stretched = straight + 1.5 * (target - straight)

fig, axes = plt.subplots(2, 1, figsize=(7, 8.5), sharex=True, layout="constrained")
for ax, observer, title in zip(
    axes,
    (straight, turning),
    ("straight observer: both fit every bearing", "after a turn: only one does"),
    strict=True,
):
    bearings = np.stack([observer, observer + 1.6 * (target - observer)])
    ax.plot(*bearings.swapaxes(0, 1) / KM, color="0.7", zorder=0)
    ax.plot(*observer / KM, "^-", color="black", label="observer, lines of bearing")
    ax.plot(*target / KM, "o-", color="tab:blue", label="target")
    ax.plot(*stretched / KM, "s--", color="tab:orange", label="one 1.5 times as far")
    ax.set(title=title, ylabel="y [km]", aspect="equal")
    ax.set(xlim=(-0.5, 15.0), ylim=(-0.6, 9.8))
axes[0].legend(loc="upper right", fontsize="small")
axes[1].set_xlabel("x [km]")

# %%
# The same, in numbers
# --------------------
# The registered scenario ``moving_observer`` has an observer at 5 m/s, a target some 8 km away, and
# one bearing every 10 s with an error of half a degree. Its path is "straight", or "manoeuvring":
# five minutes along y, five along x, in turn.
#
# Each bearing adds ``H' H / sigma^2`` to the information about where the target was at the start
# (the observability Gramian); the transition matrix F carries that start to the time of the bearing.
# An eigenvalue of zero is a direction about which nothing is learnt. The inverse root of the others
# is the best standard deviation that *any* unbiased estimator can reach along their directions.

paths = ("straight", "manoeuvring")
scenes = {path: tk.scenario("moving_observer", path=path) for path in paths}
start = np.array([6000.0, 5000.0, 3.0, -2.0])
units = np.diag([1000.0, 1000.0, 1.0, 1.0])  # count in km and m/s


def information(scene, steps):
    """What the first bearings say about the state at time zero, (4, 4)."""
    sigma = scene.sensor.parameters["sigma"]
    total = np.zeros((4, 4))
    for now, pose in zip(scene.t[:steps], scene.pose[:steps], strict=True):
        F = scene.motion.jacobian(start, now)
        H = scene.sensor.jacobian(scene.motion.f(start, now), pose) @ F @ units / sigma
        total += H.T @ H
    return total


for path, scene in scenes.items():
    for steps in (30, 60, 120):
        gramian = information(scene, steps)
        values, vectors = np.linalg.eigh(gramian)
        rank = np.linalg.matrix_rank(gramian, tol=1e-9 * values[-1])
        best = 1.0 / np.sqrt(values[0]) if rank == 4 else np.inf
        print(f"{path:12} {steps:3} bearings: rank {rank}, best possible sigma {best:.2g}")
    print("   in direction", np.round(vectors[:, 0] / vectors[0, 0] * 6.0, 2))

# %%
# The straight observer never gets beyond rank 3, however long it listens. The direction that stays
# dark is (6, 5) km with (3, -7) m/s: the position of the target relative to the observer, and its
# velocity relative to the observer's (0, 5) m/s. It is the stretching of the picture above. The other
# observer turns after 30 bearings, and from then on the rank is 4.
#
# What a filter makes of it
# -------------------------
# Now give the job to ``ekf1``, the first-order extended Kalman filter, which replaces the bearing's
# curve by a tangent at its own estimate. Before the first bearing it believes in a circle of 3 km
# about a point that is 8 km away: fair, as the truth is drawn from that belief.

campaigns = {}
for path, scene in scenes.items():
    ekf = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    campaigns[path] = tk.monte_carlo(ekf, scene, runs=500, seed=1)
    print(campaigns[path].summary("rmse", "nees"), "\n")

# %%
# NEES / n should be 1. It is a hundred and more: the filter is confident and wrong, on *both* paths.
# Compare what it claims with what is so, over time:


def error_and_claim(scene, runs=500):
    """Position error and the filter's own idea of it: medians over runs, (T,) each."""
    sim = scene.simulate(seed=2, runs=runs)
    ekf = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    history = tk.filter(ekf, sim.record, sim.prior, start=sim.start)
    wrong = history.filtered.mean[:, :2] - sim.truth[:, :2]
    cov = history.filtered.cov
    error = np.hypot(wrong[:, 0], wrong[:, 1])
    claim = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
    return np.median(error, axis=1), np.median(claim, axis=1)


def compare(scenes, title):
    """Error and claim against time, one panel per path."""
    fig, axes = plt.subplots(1, 2, figsize=(8, 3.6), sharey=True, layout="constrained")
    for ax, (path, scene) in zip(axes, scenes.items(), strict=True):
        error, claim = error_and_claim(scene)
        ax.semilogy(scene.t / 60.0, error, color="tab:blue", label="error")
        ax.semilogy(scene.t / 60.0, claim, "--", color="tab:red", label="claimed")
        ax.set(title=path, xlabel="time [min]", ylim=(80.0, 5000.0))
    axes[0].set_ylabel("position, median of 500 runs [m]")
    axes[0].legend(loc="lower left")
    fig.suptitle(title)
    return fig


compare(scenes, "prior of 3 km")

# %%
# Look at the left panel. The error is 2 km and grows, as it must: the range cannot be seen. But the
# filter claims to know it to some 600 m. It has invented information. Its tangents were taken at
# wrong ranges, each with another idea of the dark direction; together they pretend that no
# direction is dark. The manoeuvre brings true information (right panel) and the error falls to
# 1 km, and yet the false confidence of the first minutes is never paid back: it claims 400 m.
#
# When is it honest?
# ------------------
# Where the tangent is good: when the filter starts near the truth.

prior = tk.Gaussian(start, np.diag([500.0, 500.0, 3.0, 3.0]) ** 2)
near = {path: attrs.evolve(scene, prior=prior) for path, scene in scenes.items()}
compare(near, "prior of 500 m")
for path, scene in near.items():
    ekf = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    scores = tk.monte_carlo(ekf, scene, runs=500, seed=1).scores["estimator"]["filter"]
    print(f"{path:12} NEES / n = {scores.mean_nees / scores.n:.2f}")

# %%
# Now NEES / n is 1 within a few per cent, and claim and error move together (the median of an error is
# a little below its standard deviation). On the straight path both stay where they were. On the other
# they fall after the *second* turn, at 10 min; the table above says why: 60 bearings with one turn
# among them can give 1.6 km at best, and this prior knows more already.
#
# What to take home
# -----------------
# * A straight observer cannot find the range of a target on a straight course. No filter can change
#   that, and one that says otherwise is wrong.
# * The manoeuvre makes the range visible. It does not make a filter honest.
# * Look at NEES (with truth) or NIS (without) before you believe an accuracy. A start that does not
#   know the range needs another filter than this one: the tutorial on consistency has it.

if __name__ == "__main__":
    plt.show()
