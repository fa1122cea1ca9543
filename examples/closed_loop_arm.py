"""
Identification under feedback
=============================

Robots are usually identified while a controller runs. It tracks a motion, feeds the steps of the encoders
back into the torques, and holds each torque until its next cycle. The logs therefore contain noisy torques
that jump. Use them without filtering.
"""

import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import leastaction as la

# %%
# The arm has two links that hang down. The second angle is measured from the first link, and both joints have
# dry and viscous friction. All trials are simulated at once, with one row per trial.

truth = {
    "q1_dot**2": 0.5,
    "q1_dot**2*cos(q2)": 0.2,
    "q1_dot*q2_dot": 0.15,
    "q1_dot*q2_dot*cos(q2)": 0.2,
    "q2_dot**2": 0.075,
    "cos(q1)": 6.0,
    "cos(q1+q2)": 2.0,
}
viscous, dry = np.array([0.10, 0.05]), np.array([0.20, 0.10])


def acceleration(q, v, torque):
    """Solve M q̈ = τ − friction − Coriolis and gravity terms."""
    c, s = np.cos(q[:, 1]), 0.2 * np.sin(q[:, 1])
    second = 2.0 * np.sin(q.sum(axis=1))
    f = torque - viscous * v - dry * np.tanh(v / 0.005)
    f0 = f[:, 0] + s * v[:, 1] * (2 * v[:, 0] + v[:, 1]) - 6.0 * np.sin(q[:, 0]) - second
    f1 = f[:, 1] - s * v[:, 0] ** 2 - second
    m00, m01, m11 = 1.0 + 0.4 * c, 0.15 + 0.2 * c, 0.15
    det = m00 * m11 - m01**2
    return np.stack([(m11 * f0 - m01 * f1) / det, (m00 * f1 - m01 * f0) / det], axis=1)


def step(q, v, torque, h):
    """Advance by one Runge–Kutta step; the torque is held."""
    a1 = acceleration(q, v, torque)
    a2 = acceleration(q + h / 2 * v, v + h / 2 * a1, torque)
    a3 = acceleration(q + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, torque)
    a4 = acceleration(q + h * v + h * h / 2 * a2, v + h * a3, torque)
    return q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


# %%
# The controller runs at 200 Hz. It reads encoders with 4096 counts per turn, differentiates and filters them,
# and tracks four sines per joint with a proportional and a derivative gain. The log contains counts and
# torques.

rate, count, trials, substeps = 200, 2 * np.pi / 4096, 4, 8
t = np.arange(12 * rate + 1) / rate
rng = np.random.default_rng(1)
size, frequency, phase = (rng.uniform(*r, (trials, 2, 4)) for r in ((0.2, 0.5), (0.5, 4.0), (0.0, 6.3)))
q, v = (size * np.sin(phase)).sum(-1), (size * frequency * np.cos(phase)).sum(-1)
before, rates, log_q, log_torque = np.round(q / count) * count, v, [], []
for now in t:
    seen = np.round(q / count) * count
    rates, before = 0.7 * rates + 0.3 * rate * (seen - before), seen
    angle = frequency * now + phase
    wanted, wanted_rates = (size * np.sin(angle)).sum(-1), (size * frequency * np.cos(angle)).sum(-1)
    torque = [40.0, 12.0] * (wanted - seen) + [6.0, 1.2] * (wanted_rates - rates)
    log_q.append(seen)
    log_torque.append(torque)
    for _ in range(substeps):
        q, v = step(q, v, torque, 1.0 / rate / substeps)
log_q, log_torque = np.array(log_q), np.array(log_torque)
data = la.Trajectories(
    la.Trajectory(t, log_q[:, k], log_torque[:, k], ["q1", "q2"], name=str(k)) for k in range(trials)
)
print(data)

# %%
# There are 42 candidates for L, and both kinds of friction in both joints.

library = la.Library.mechanical(["q1", "q2"], angles=["q1", "q2"])
friction = ["q1_dot**2/2", "q2_dot**2/2", "abs(q1_dot)", "abs(q2_dot)"]
first = la.discover(data, library, dissipation=friction)
print(first.fit.status)
for warning in first.fit.warnings:
    print("-", warning)

# %%
# The structure is right and the model forecasts well, so it is usable, but not ok. The warning states the
# reason: a torque that is held acts half a cycle later than its time stamp. One line corrects this (on the
# command line: ``--force-delay 0.0025``).

held = la.delay.shift_forces(data, 0.5 / rate)
model = la.discover(held, library, dissipation=friction)
print(model.format_table())

table = model.table()
true_friction = {"q1_dot**2/2": 0.10, "q2_dot**2/2": 0.05, "abs(q1_dot)": 0.20, "abs(q2_dot)": 0.10}
print(f"largest error of L: {max(abs(table.coefficient[k] / truth[k] - 1) for k in truth):.2%}")
print("true friction:", true_friction)

# %%
# Some intervals of friction miss the truth slightly. The sign of a velocity is smoothed here and in the arm,
# but over different velocities. An interval is valid for the candidates with which it was computed.
#
# Above: the logged torque of the second joint, and the torque that the motion needed according to the model.
# Below: friction in the joints, true and estimated. The first fit absorbed the delay in the friction.

motion = held[0]
smooth, speed, turning = (model.diagnostics.curve(nu=nu)[0] for nu in range(3))
needed = np.einsum("tij,tj->ti", model.mass_matrix(smooth), turning - model.acceleration(smooth, speed))
shown = slice(200, 480)

figure, axes = plt.subplots(2, 1, figsize=(8, 7), layout="constrained")
axes[0].step(motion.t[shown], motion.forces[shown, 1], where="mid", color="0.7", label="logged")
axes[0].plot(motion.t[shown], needed[shown, 1], color="C0", label="needed, by the model")
axes[0].set(xlabel="t (s)", ylabel="torque of joint 2 (N m)")
axes[0].legend(frameon=False)

x = np.linspace(-1.5, 1.5, 601)
for i in range(2):
    axes[1].plot(
        x, viscous[i] * x + dry[i] * np.sign(x), color="0.75", lw=6, label="true" if i == 0 else None
    )
for found, style, label in (
    (first, ":", "found, times as logged"),
    (model, "-", "found, half a cycle later"),
):
    for i, rate_of in enumerate(sp.symbols("q1_dot q2_dot", real=True)):
        force = sp.lambdify(rate_of, sp.diff(found.dissipation_function, rate_of))
        axes[1].plot(x, force(x), style, color=f"C{i}", label=f"joint {i + 1}: {label}")
axes[1].set(xlabel="velocity (rad/s)", ylabel="friction (N m)")
axes[1].legend(frameon=False, fontsize=8)
plt.show()

# %%
# **What to learn.** Keep the controller running, and do not filter the torques: the fit averages their noise
# and estimates its size. If the time stamps are off by half a cycle, the result says so.
