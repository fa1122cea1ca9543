"""
A measured double pendulum
==========================

Two links swing freely, and optical encoders record both angles every 2 ms. From 18 pieces of this recording
we find the Lagrangian and the friction. With them we forecast the 8 pieces that were held out.

The recording is included in the package (Kaheman et al., HardwareX 15, 2023, MIT licence). Angles are
measured from upright, so both pendulums hang at π.
"""

from importlib.resources import as_file, files

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la

with as_file(files("leastaction") / "datasets" / "double_pendulum.csv.gz") as path:
    data = la.read_csv(path, coordinates=["theta1", "theta2"])

held_out = data[2::3]
fitted = data.select([name for name in data.names if name not in held_out.names])
print(fitted)
print(held_out)

# %%
# The candidates do not presume the answer: products of two velocities with cosines and sines, the first
# harmonics of a potential, and viscous and dry friction in both joints. The friction of the second joint
# depends on the angle between the links.
#
# Nothing drives the pendulum, so its motion determines L only up to a factor. We set the coefficient of the
# first squared velocity to one. All other coefficients are relative to it.

candidates = [
    "theta1_dot**2",
    "theta2_dot**2",
    "theta1_dot*theta2_dot",
    "theta1_dot*theta2_dot*cos(theta1-theta2)",
    "theta1_dot*theta2_dot*sin(theta1-theta2)",
    "theta1_dot**2*cos(theta1)",
    "theta2_dot**2*cos(theta2)",
    "theta1_dot**2*cos(theta1-theta2)",
    "theta2_dot**2*cos(theta1-theta2)",
    "cos(theta1)",
    "cos(theta2)",
    "sin(theta1)",
    "sin(theta2)",
    "cos(theta1-theta2)",
    "cos(2*theta1)",
    "cos(2*theta2)",
]
friction = [
    "theta1_dot**2/2",
    "theta2_dot**2/2",
    "(theta2_dot-theta1_dot)**2/2",
    "abs(theta1_dot)",
    "abs(theta2_dot-theta1_dot)",
]
library = la.Library(candidates, ["theta1", "theta2"], angles=["theta1", "theta2"])
model = la.discover(fitted, library, known={"theta1_dot**2": 1.0}, dissipation=friction)
print(model.format_table())

# %%
# The five terms are those of the textbook. None of the eleven other candidates was needed. The notes report
# what the discovery did to the data, and how much the equations leave unexplained:

for note in model.diagnostics.notes:
    print("-", note)

# %%
# The decisive test is to forecast motions that were not used in the fit. Each forecast starts from the state
# that best fits the half second of data before it, and simulates one second.

forecast = model.validate(held_out, horizon=1.0)
print("rms error (rad):", forecast.rms.round(4), "in", len(forecast.traces), "forecasts")
print("of the spread:  ", (forecast.rms / forecast.std).round(4))

# %%
# The largest and the smallest of these errors, and the distribution of all of them.

worst_first = sorted(forecast.traces, key=lambda trace: -trace.rms.max())
shown = [worst_first[0], worst_first[-1]]
names = ["θ₁", "θ₂"]
colours = ["tab:blue", "tab:orange"]

figure, axes = plt.subplots(2, 2, figsize=(9, 5.4), sharex=True, layout="constrained", height_ratios=[2, 1])
for column, (trace, title) in enumerate(zip(shown, ["largest error", "smallest error"], strict=True)):
    seconds = trace.t - trace.origin
    top, bottom = axes[:, column]
    for i in range(2):
        top.plot(seconds[::12], trace.measured[::12, i], ".", color="0.6", ms=5)
        top.plot(seconds, trace.forecast[:, i], color=colours[i], label=f"forecast of {names[i]}")
        bottom.plot(seconds, 1e3 * (trace.forecast - trace.measured)[:, i], color=colours[i])
    top.set_title(f"{title}: trial {trace.trial}", loc="left", fontsize=10)
    bottom.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    bottom.set_xlabel("seconds after the start of the forecast")
axes[0, 0].plot([], [], ".", color="0.6", label="measured (every 12th sample)")
axes[0, 0].legend(loc="upper right", fontsize=8, framealpha=0.9)
axes[0, 0].set_ylabel("angle from upright (rad)")
axes[1, 0].set_ylabel("error (mrad)")
plt.show()

# %%
# **What to learn.** Judge a model by its forecasts. Here they are off by some thousandths of a radian after
# one second. Standard errors say less: they are small because there are 48 000 samples, and they assume that
# the terms are right. The friction is the least certain part.

assert np.all(forecast.rms < 0.01)
