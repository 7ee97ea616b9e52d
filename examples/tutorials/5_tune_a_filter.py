"""
Tune a filter, and do not fool yourself
=======================================

A filter has numbers that nobody measured: how restless is the target, how noisy is the sensor, how fast
should an adapter follow. ``tk.tune`` searches them with an optimiser whose cost is what whole filter
runs score. Every candidate on every run is a lane of one computation, so a thousand candidates on twenty
runs take a second. What is hard is not the search but the question: *better by which measure, and on
which runs?*
"""

import matplotlib.pyplot as plt
import numpy as np

import tracker as tk

# %%
# A target that the model does not know
# -------------------------------------
# A boat zigzags; the filter believes that it keeps its velocity but for white noise in the acceleration,
# of spectral density ``density``. No density is true. Position is measured each second, sigma 10 m.

t = np.arange(1.0, 121.0)
heading = 0.5 + 0.8 * np.sin(2.0 * np.pi * t / 60.0)
velocity = 4.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
position = np.cumsum(velocity, axis=0)
scene = tk.Scenario(
    name="zigzag",
    motion=tk.motions.make("constant_velocity", density=0.1),
    sensor=tk.sensors.make("position", sigma=10.0),
    prior=tk.Gaussian([*position[0], *velocity[0]], np.diag([100.0, 100.0, 4.0, 4.0])),
    prior_time=1.0,
    t=t,
    path=np.concatenate([position, velocity], axis=1),
    initial="prior around truth",
)
kf = tk.estimator("kf", motion=scene.motion.with_parameters(density=1e-3), sensor=scene.sensor)
print(tk.monte_carlo(kf, scene, runs=200, seed=0).summary("rmse", "nees"))

# %%
# It was told that the boat hardly turns, believes itself and lags behind. Let the density be sought, on
# a logarithmic scale, for the smallest error:

bounds = {"motion.density": (1e-4, 10.0, "log")}
found = tk.tune(kf, scene, bounds, "rmse", evaluations=500, runs=20, seed=1)
print(found)

# %%
# Beside the score on the 20 runs of the search stands that on 100 others, which the search has not seen. They
# agree, so the number may be used: ``found.estimator`` is the filter with it.
#
# Better by which measure?
# ------------------------
# Ask for consistency instead (NEES: do the errors have the size that the filter claims?), or for what can be
# asked without knowing the truth: the likelihood of the measurements, or the size of the
# innovations.

answers = {"rmse": found}
for objective in ("nees", "likelihood", "innovation"):
    answers[objective] = tk.tune(kf, scene, bounds, objective, evaluations=500, seed=1)

densities = np.geomspace(3e-3, 10.0, 15)
scores = [
    tk.monte_carlo(
        tk.estimator(
            "kf", motion=scene.motion.with_parameters(density=density), sensor=scene.sensor
        ),
        scene,
        runs=100,
        seed=0,
    ).scores["estimator"]["filter"]
    for density in densities
]
fig, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
axes[0].loglog(densities, [s.rmse.value for s in scores], color="black")
axes[0].set_ylabel("RMSE [m]")
axes[1].loglog(densities, [s.mean_nees / 4 for s in scores], color="black")
axes[1].axhline(1.0, color="grey", linestyle=":")
axes[1].set(ylabel="NEES / n", xlabel="density [m$^2$/s$^3$]")
for k, (objective, answer) in enumerate(answers.items()):
    for ax in axes:
        value = answer.values["motion.density"]
        ax.axvline(value, color=f"C{k}", label=f"{objective}: {value:.2g}")
axes[0].legend()

# %%
# All find the same region, and not the same number. Where the error is least, this filter claims errors that
# are larger than they are (NEES below n): it needs room for the turns, and the boat does not always
# turn. The filter that is honest on average errs a little more. The model is wrong; tuning chooses *how* it
# is wrong. Say what you need, and tune for that.
#
# How the search went
# -------------------
# Restarts are searches that know nothing of each other. If they end at one cost, it was found.

several = tk.tune(kf, scene, bounds, "rmse", "differential_evolution", evaluations=300, restarts=5)
fig, ax = plt.subplots(figsize=(8, 3), layout="constrained")
ax.plot(several.evaluated, several.best)
ax.set(xlabel="evaluations of a restart", ylabel="lowest RMSE so far [m]")
print("densities:", several.settings[0].round(4))

# %%
# On which runs?
# --------------
# Now something with many numbers: an adapter that moves R by a fuzzy system, with sixteen numbers of rules and
# sets. Tune it on one run of forty steps:

numbers = tk.adapters.make("fuzzy_measurement_noise").parameters
short = tk.Scenario(
    name="zigzag, 40 s",
    motion=scene.motion,
    sensor=scene.sensor,
    prior=scene.prior,
    prior_time=1.0,
    t=t[:40],
    path=scene.path[:40],
    initial="prior around truth",
)
adapter = tk.adapters.make("fuzzy_measurement_noise", window=5)
fuzzy = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=adapter)
wide = {
    f"adapter.{name}": (0.1, 10.0) if name == "scale" or "width" in name else (-10.0, 10.0)
    for name in numbers
    if name != "floor"
}
by_heart = tk.tune(fuzzy, short, wide, "rmse", evaluations=2000, runs=1, seed=1)
rmse = {
    f"{where}, {which}": scores[which].interval("rmse").value
    for where, scores in (("training", by_heart.training), ("held out", by_heart.held_out))
    for which in ("given", "tuned")
}
print({name: round(value, 2) for name, value in rmse.items()})
print("\n".join(by_heart.warnings()))

# %%
# On its run it is much better, on others it is worse than what it began with: it has learnt that run by
# heart. The remedy is more runs; they cost lanes, not patience.

honest = tk.tune(fuzzy, short, wide, "rmse", evaluations=2000, runs=50, seed=1)
fig, ax = plt.subplots(figsize=(8, 3), layout="constrained")
for k, (label, result) in enumerate({"1 run": by_heart, "50 runs": honest}.items()):
    for at, (where, scores) in enumerate(
        (("training", result.training), ("held out", result.held_out))
    ):
        before, after = (scores[which].interval("rmse").value for which in ("given", "tuned"))
        change = 100.0 * (after / before - 1.0)
        ax.barh(2 * k + at, change, color=f"C{at}")
        ax.text(
            change,
            2 * k + at,
            f" {label}, {where} ",
            ha="left" if change > 0 else "right",
            va="center",
        )
ax.axvline(0.0, color="black")
ax.set(yticks=[], xlabel="change of the RMSE by tuning [%]", xlim=(-60.0, 130.0))

# %%
# Without the truth
# -----------------
# On real data there is a record and no truth. The likelihood needs none; the last quarter of the rows is kept
# from the search. Here sensor and motion are both sought, from one run:

sim = scene.simulate(seed=3, runs=1)
record, prior = tk.Record(sim.record.t, sim.record.z[..., 0]), sim.prior[0]
both = bounds | {"sensor.sigma": (1.0, 100.0, "log")}
alone = tk.tune(kf, record, both, "likelihood", evaluations=1000, prior=prior, start=sim.start)
print(alone)

# %%
# The sensor's sigma, 10 m, is found to a few percent. For linear models there is another way to the same likelihood:
# expectation maximisation (Shumway and Stoffer 1982), which climbs at every iteration.

em = tk.expectation_maximisation(
    kf, record, prior, start=sim.start, process="scaled", measurement="scaled", iterations=500
)
print(em)

# %%
# Where to go next
# ----------------
# ``found.save(path)`` keeps a result, ``tk.load_tuning`` reads it back, and ``applied_to(estimator)`` puts its
# numbers into any estimator that has them. The how-to page on tuning lists objectives and options.

if __name__ == "__main__":
    plt.show()
