"""
An unmeasured drive
===================

A trolley of a crane carries a load on a rope of 0.8 m. The position of the trolley and the angle of the rope
are recorded, but not the force of the motor, so the equation of the trolley cannot be used. The equation of
the load is enough to move it without swinging.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la

g, rope, load, trolley = 9.81, 0.8, 5.0, 20.0


def crane(motor, start, t):
    """Simulate the position of the trolley and the angle of the rope."""

    def rates(time, y):
        _, theta, x_dot, theta_dot = y
        mass = [[trolley + load, load * rope * np.cos(theta)], [load * rope * np.cos(theta), load * rope**2]]
        push = motor(time) - 30.0 * x_dot - 25.0 * np.sign(x_dot) + load * rope * theta_dot**2 * np.sin(theta)
        return [x_dot, theta_dot, *np.linalg.solve(mass, [push, -load * g * rope * np.sin(theta)])]

    return solve_ivp(rates, (t[0], t[-1]), start, t_eval=t, max_step=0.01).y[:2].T


rng, t = np.random.default_rng(1), np.arange(0.0, 10.0, 0.01)
noise = np.array([0.002, 0.005])  # m, rad
recordings = []
for _ in range(4):
    size, rate, phase = rng.uniform(40, 120, 3), rng.uniform(1, 5, 3), rng.uniform(0, 6, 3)

    def motor(time, size=size, rate=rate, phase=phase):
        return np.sum(size * np.sin(rate * time + phase))

    q = crane(motor, [0, 0.2, 0, 0], t)
    recordings.append(la.Trajectory(t, q + noise * rng.normal(size=q.shape), coordinates=["x", "theta"]))

# %%
# The trolley also has a mass and two kinds of friction. We neither offer nor find them: ``prescribed``
# excludes the equation of the trolley. No force is known, so one coefficient must be given. The inertia of
# the load, m l²/2, sets the scale.

library = la.Library.mechanical(["x", "theta"], angles=["theta"])
inertia = {"theta_dot**2": 0.5 * load * rope**2}
model = la.discover(recordings[:3], library, inertia, prescribed=["x"])
print(model.format_table())
print(*model.diagnostics.dropped[:3], sep="\n")

# %%
# Both coefficients are found: m l = 4 and m g l = 39.24. Their ratio to the inertia gives the length of the
# rope, 0.8 m. The equation contains the acceleration of the trolley,

(swing,) = model.equations_of_motion()
print(swing)

# %%
# which drives the model: where the model takes forces, the entry of x is its acceleration. The last recording
# was held out. Its trolley moves as measured, and the model predicts the rope.

check = model.validate(recordings[3], horizon=4.0)
print(check)
figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
upper.plot(recordings[3].t, recordings[3].q[:, 0], color="tab:gray")
upper.set_ylabel("trolley (m)")
lower.plot(recordings[3].t, recordings[3].q[:, 1], ".", ms=2, color="0.6", label="measured")
for k, trace in enumerate(check.traces):
    lower.plot(trace.t, trace.forecast[:, 1], color="tab:red", label="" if k else "forecast over 4 s")
lower.set(xlabel="t (s)", ylabel="rope (rad)")
lower.legend(loc="upper right")
plt.show()

# %%
# Now we use the model. A move of 2 m that accelerates and decelerates for one period of the swing each leaves
# the load at rest. The same move in less time does not.

coefficient = {term.expression: term.coefficient for term in model.terms}
length = coefficient["theta_dot**2"] * 2.0 / coefficient["x_dot*theta_dot*cos(theta)"]
period = 2.0 * np.pi * np.sqrt(length / g)
figure, axis = plt.subplots(figsize=(9, 3.5), layout="constrained")
for ramp, colour, label in (
    (period, "tab:blue", "ramps of one period"),
    (0.7 * period, "tab:orange", "ramps of 0.7 periods"),
):
    push = 2.0 / (2.0 * ramp**2)  # two metres: up to speed, on, and down again, as long each
    state, begin = ([0.0, 0.0], [0.0, 0.0]), 0.0
    for end, x_dot_dot in ((ramp, push), (2 * ramp, 0.0), (3 * ramp, -push), (9.0, 0.0)):
        times = np.linspace(begin, end, 200)
        run = model.simulate(*state, times, np.tile([x_dot_dot, 0.0], (200, 1)))
        axis.plot(times, run.q[:, 1], color=colour, label=label)
        state, begin, label = (run.q[-1], run.qdot[-1]), end, ""
axis.set(xlabel="t (s)", ylabel="rope (rad)")
axis.legend()
plt.show()

# %%
# **What to learn.** If an unmeasured force moves a coordinate (a drive, a hand, the ground), name the
# coordinate in ``prescribed``. Otherwise the fit expresses the force of the motor by terms of L, and the
# result is not *ok*.
