"""
A pendulum without a sensor
===========================

A double pendulum has one encoder, at its first joint. The angle of the second link is not measured. But the
second link pulls on the first, and this is enough to find the law of both and the motion of the second.

The recording has a second encoder (Kaheman et al., HardwareX 15, 2023, MIT licence). We withhold it, and use
it at the end to check. Angles are measured from upright, so both links hang at π.
"""

from importlib.resources import as_file, files

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la

with as_file(files("leastaction") / "datasets" / "double_pendulum.csv.gz") as path:
    data = la.read_csv(path, coordinates=["theta1"])
    withheld = la.read_csv(path, coordinates=["theta2"])
data, withheld = data[:12], withheld[:12]
print(data)

# %%
# We offer the terms of two links on two joints: kinetic energies, one coupling, two weights, and viscous
# friction in each joint. Nothing drives the pendulum, so one coefficient must set the scale.

library = la.Library(
    [
        "theta1_dot**2",
        "theta2_dot**2",
        "theta1_dot*theta2_dot*cos(theta1-theta2)",
        "cos(theta1)",
        "cos(theta2)",
    ],
    ["theta1", "theta2"],
    angles=["theta1", "theta2"],
)
friction = ["theta1_dot**2/2", "(theta1_dot-theta2_dot)**2/2"]
model = la.discover(data, library, {"theta1_dot**2": 1.0}, friction, hidden=["theta2"])
print(model.format_table())
for finding in model.fit.findings:
    if finding.code.startswith("hidden"):
        print(finding)

# %%
# The coefficients published for this pendulum, from a fit with both encoders, are 0.5568, 0.9827, −117.92 and
# −55.81. How accurate is the estimated angle? We compare it with the encoder:

motions = model.diagnostics.hidden_motion["theta2"]
errors = []
for motion, run in zip(motions, withheld, strict=True):
    error = motion.q - run.q[:, 0]
    errors.append(np.median(np.abs(error - 2 * np.pi * np.round(error / (2 * np.pi)))))
median, largest = 1e3 * np.median(errors), 1e3 * np.max(errors)
print(f"median error {median:.1f} mrad, largest of a recording {largest:.1f} mrad")

figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
motion, run = motions[0], withheld[0]
turns = 2 * np.pi * np.round((motion.q[0] - run.q[0, 0]) / (2 * np.pi))
axes[0].plot(run.t, data[0].q[:, 0], ".", ms=2, color="0.6", label="first link, measured")
axes[0].plot(run.t, run.q[:, 0], color="tab:orange", lw=5, alpha=0.5, label="second link, withheld")
axes[0].plot(motion.t, motion.q - turns, color="tab:blue", label="second link, estimated")
axes[0].set_ylabel("angle (rad)")
axes[0].legend(loc="lower left")
reach = 1.96 * motion.standard_error
axes[1].plot(motion.t, 1e3 * (motion.q - turns - run.q[:, 0]), color="tab:blue", label="error")
axes[1].fill_between(motion.t, -1e3 * reach, 1e3 * reach, color="tab:blue", alpha=0.2, label="95 % band")
axes[1].set(xlabel="t (s)", ylabel="error (mrad)")
axes[1].legend(loc="upper center")
plt.show()

# %%
# The error leaves the band for some tenths of a second. The band includes noise, the coefficients, and a
# white equation error. The error from a missing friction term, such as dry friction, is correlated in time.
#
# **What to learn.** Name a coordinate without a sensor in ``hidden``, and offer few candidates that contain
# it. Read the findings: they state how its sign or zero was chosen, and whether the candidates leave more
# open.
