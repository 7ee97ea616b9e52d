"""
A Kalman filter on a noisy line
===============================

A vehicle moves along a track. Once a second something measures where it is, with an error of a few
metres. How fast is it going, where is it now, and how sure may we be? This is the smallest problem
in which everything of the framework appears: models, a scenario, a filter, a smoother, and the
question that matters most: *does the filter know how wrong it is?*
"""

import matplotlib.pyplot as plt
import numpy as np

import tracker as tk

# %%
# Two models
# ----------
# A motion model says how the state changes in ``dt`` seconds; a sensor says what is measured of it.
# Both are looked up by name in the registry: ``tracker list`` prints the names, and
# ``tracker show constant_velocity`` the parameters with their units.

motion = tk.motions.make("constant_velocity", axes=1, density=0.1)  # m^2/s^3
sensor = tk.sensors.make("position", axes=1, sigma=3.0).over(motion.space)  # m
print("state:   ", motion.space)
print("measured:", sensor.space)

# %%
# Nothing is hidden in them. A step of one second from position 0 m and speed 2 m/s:

state = np.array([0.0, 2.0])
print("after 1 s:", motion.f(state, 1.0))
print("with the uncertainty\n", motion.Q(state, 1.0).round(3))

# %%
# A problem with a known answer
# -----------------------------
# A scenario says how truth arises and what an estimator is told beforehand (the *prior*). Here the
# truth is drawn from the prior, so a filter that is told the prior is told the truth, no less and
# no more.

scene = tk.Scenario(
    name="noisy line",
    motion=motion,
    sensor=sensor,
    prior=tk.Gaussian(mean=[0.0, 0.0], cov=np.diag([10.0**2, 2.0**2])),
    t=np.arange(1.0, 61.0),
)
sim = scene.simulate(seed=4, runs=1)
truth, measured = sim.truth[..., 0], sim.record.z[:, 0, 0]
print("truth", truth.shape, "(time, components); measured", measured.shape)

# %%
# Filter and smooth
# -----------------
# An estimator is a filter with the models it works on, and perhaps a smoother. The filter uses the
# past only; the smoother goes back over the record and uses all of it.

estimator = tk.estimator("kf", motion=motion, sensor=sensor, smoother="rts")
history = tk.smooth(estimator, sim.record, sim.prior, start=sim.start)


def mean_and_sigma(trajectory, component):
    """One component of the only run, and its standard deviation."""
    mean = trajectory.mean[:, component, 0]
    return mean, np.sqrt(trajectory.cov[:, component, component, 0])


fig, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
labels = ("position [m]", "speed [m/s]")
for ax, component, label in zip(axes, (0, 1), labels, strict=True):
    ax.plot(scene.t, truth[:, component], color="black", label="truth")
    for name, trajectory, colour in (
        ("filter", history.filtered, "tab:blue"),
        ("smoother", history.smoothed, "tab:orange"),
    ):
        mean, sigma = mean_and_sigma(trajectory, component)
        ax.plot(scene.t, mean, color=colour, label=name)
        low, high = mean - 2 * sigma, mean + 2 * sigma
        ax.fill_between(scene.t, low, high, color=colour, alpha=0.2)
    ax.set_ylabel(label)
axes[0].plot(scene.t, measured, ".", color="grey", label="measured")
axes[0].legend()
axes[1].set_xlabel("time [s]")

# %%
# The bands are two standard deviations wide. Speed was never measured: the filter infers it, and
# the smoother infers it better.
#
# Is it honest?
# -------------
# An estimate is a claim: "here, give or take that much". The *normalised estimation error squared*
# (NEES), ``e' P^-1 e``, compares the actual error with the claimed covariance. For an honest
# filter with n state components it averages n. One run cannot tell, but a thousand can; they are
# one array computation, because every run is a lane of the last axis.

campaign = tk.monte_carlo(estimator, scene, runs=1000, seed=7)
print(campaign.summary())

# %%
# NEES / n is close to 1, and at nearly all steps it lies in the band in which 95 % of the averages
# of an honest filter fall. NIS asks the same of the measurements alone, so it works without truth:
# that is what you have on real data. (A smoother has no innovations, hence no NIS.)

scores = campaign.scores["estimator"]["filter"]
band = scores.nees_band(step=0)
fig, ax = plt.subplots(figsize=(8, 3), layout="constrained")
ax.axhspan(band.low, band.high, color="tab:green", alpha=0.2, label="95 % band")
ax.plot(scene.t, scores.per_step["nees"], color="tab:blue", label="mean of 1000 runs")
ax.set(xlabel="time [s]", ylabel="NEES", ylim=(1.5, 2.5))
ax.legend()

# %%
# A dishonest filter
# ------------------
# Tell the filter that the sensor is twice as good as it is. Its estimates get a little worse; its
# opinion of them gets much better. The report says so in words: accuracy alone would not.

proud = tk.estimator("kf", motion=motion, sensor=sensor.with_parameters(sigma=1.5))
campaign = tk.monte_carlo({"proud": proud}, scene, runs=1000, seed=7)
print(campaign.summary("rmse", "nees"))

# %%
# Where to go next
# ----------------
# Here position is measured, all is linear, and the Kalman filter is exact. In the next tutorial only
# a *direction* is measured, and honesty is much harder to have.

if __name__ == "__main__":
    plt.show()
