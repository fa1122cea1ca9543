"""
What a payload changes
======================

A motor turns a link that hangs from its shaft. Three trials are recorded with the empty link, three with a
weight of 1 kg at an unknown place. Which coefficients differ, and by how much? And where is the weight?
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la

G = 9.81
INERTIA, MOMENT, VISCOUS, DRY = 0.12, 3.0, 0.25, 0.4  # kg m², N m, N m s, N m: the empty link
MASS, ARM = 1.0, 0.35  # kg, m: the payload


def torque(t, trial):
    """Return three slow sines, whose phases depend on the trial."""
    phases = np.random.default_rng(trial).uniform(0.0, 6.0, 3)
    return sum(2.0 * np.sin(w * t + p) for w, p in zip((0.9, 2.3, 4.1), phases, strict=True))


def motion(t, trial, mass):
    """Simulate the angle of the link with a weight."""

    def rate(time, state):
        q, v = state
        friction = VISCOUS * v + DRY * v / np.sqrt(v**2 + 0.02**2)
        weight = (MOMENT + mass * G * ARM) * np.sin(q)
        return [v, (torque(time, trial) - weight - friction) / (INERTIA + mass * ARM**2)]

    start = [0.5 - 0.1 * trial, 0.0]
    return solve_ivp(rate, t[[0, -1]], start, t_eval=t, rtol=1e-8, atol=1e-8).y[0]


t, trials, loads = np.arange(0.0, 8.0, 0.01), [], []
for trial in range(8):
    load, mass = ("1 kg", MASS) if trial % 2 else ("empty", 0.0)
    noise = 0.002 * np.random.default_rng(100 + trial).normal(size=t.size)
    q = motion(t, trial, mass) + noise
    trials.append(la.Trajectory(t, q, forces=torque(t, trial), coordinates=["q"]))
    loads.append(load)

# %%
# ``groups`` names the group of every trial. Coefficients are shared by all groups unless the data show that
# they differ; you need not know which.

library = la.Library.mechanical(["q"], ["q"])
model = la.discover(trials[:6], library, dissipation="auto", groups=loads[:6])
print(model.format_table())
for difference in model.groups.differences:
    print(f"{difference.expression}: {difference.difference:+.4f} ± {difference.standard_error:.4f}")
print(model.fit.status)

# %%
# Two coefficients differ, neither of them of friction. A mass m at the distance l from the shaft adds ½ m l²
# to the one and m g l to the other. Their ratio gives l, and then m follows.

change = {d.expression: d.difference for d in model.groups.differences}
arm = 2 * G * change["q_dot**2"] / change["cos(q)"]
mass = change["cos(q)"] / (G * arm)
print(f"the payload: {mass:.3f} kg at {arm:.3f} m (true: {MASS} kg at {ARM} m)")

# %%
# ``of_group`` is the law with the payload. We forecast the last trial, which was not used, with both laws.

unseen = trials[7]
laws = {"law with 1 kg": model.of_group("1 kg"), "law of the empty link": model}
figure, axis = plt.subplots(figsize=(8, 3.5))
axis.plot(unseen.t, unseen.q[:, 0], color="0.6", linewidth=4, label="measured, 1 kg")
for name, law in laws.items():
    result = law.validate(unseen, horizon=6.0, window=1.0)
    axis.plot(result.traces[0].t, result.traces[0].forecast[:, 0], label=f"forecast, {name}")
    print(f"{name}: {result.rms[0]:.4f} rad over 6 s, noise {model.noise_std[0]:.4f}")
axis.set_xlabel("time (s)")
axis.set_ylabel("angle (rad)")
axis.set_title("Only the law of the right group forecasts the loaded link")
axis.legend(frameon=False)
figure.tight_layout()
plt.show()

# %%
# **What to learn.** Record with and without the change, and state the group of each trial. The differences
# are more accurate than those of two separate fits, because all other coefficients are shared.
