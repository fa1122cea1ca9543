"""
A robot arm with two joints
===========================

Torques drive both joints of a planar arm. The second angle is measured from the first link, as with encoders
on gear motors. We find its Lagrangian in newton metres (the torques set the scale). Then we use it to compute
the torques for a desired motion.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

# %%
# The arm in SI units: point masses m₁, m₂ at the ends of links l₁, l₂, angles from hanging, viscous friction
# in both joints. The class takes the Lagrangian as text and derives the equations of motion.

m1, m2, l1, l2, g = 1.2, 0.8, 0.5, 0.4, 9.81


def excitation(rng):
    """Draw three sines for each joint, with random frequencies and phases."""
    amplitude = rng.uniform(0.5, 1.0, (3, 2)) * [3.0, 1.2]
    frequency, phase = rng.uniform(1.0, 7.0, (3, 2)), rng.uniform(0.0, 2 * np.pi, (3, 2))
    return lambda t: (amplitude * np.sin(frequency * np.asarray(t)[..., None, None] + phase)).sum(axis=-2)


arm = systems.MechanicalSystem(
    name="arm",
    title="Arm with two joints",
    coordinates=("q1", "q2"),
    angles=("q1", "q2"),
    lagrangian={
        "q1_dot**2": 0.5 * (m1 * l1**2 + m2 * (l1**2 + l2**2)),
        "q1_dot**2*cos(q2)": m2 * l1 * l2,
        "q1_dot*q2_dot": m2 * l2**2,
        "q1_dot*q2_dot*cos(q2)": m2 * l1 * l2,
        "q2_dot**2": 0.5 * m2 * l2**2,
        "cos(q1)": (m1 + m2) * g * l1,
        "cos(q1+q2)": m2 * g * l2,
    },
    dissipation={"q1_dot**2/2": 0.15, "q2_dot**2/2": 0.08},
    library=("q1_dot**2", "q2_dot**2"),  # not used here: we let candidates be generated
    initial=lambda rng: (rng.uniform(-0.5, 0.5, 2), np.zeros(2)),
    forcing=excitation,
)
data = systems.generate(
    arm, noise=5e-3, noise_convention="absolute", trials=4, duration=8.0, rate=200.0, seed=1
)
print(data)

# %%
# The candidates are generated: 42 for L, and both kinds of friction in both joints. No coefficient has to be
# known.

library = la.Library.mechanical(["q1", "q2"], angles=["q1", "q2"])
friction = ["q1_dot**2/2", "q2_dot**2/2", "abs(q1_dot)", "abs(q2_dot)"]
model = la.discover(data, library, dissipation=friction)
print(model.format_table())

# %%
# The result has all nine terms, and no others. Compare with the truth:

table = model.table()
table["true"] = table.index.map({**arm.lagrangian, **arm.dissipation})
print(table[["coefficient", "standard_error", "true"]].to_string(float_format="{:.5f}".format))

# %%
# **Torques for a desired motion.** With the mass matrix M and the acceleration a(q, q̇) without torques, the
# torque for a desired q̈ is τ = M (q̈ − a). Both are methods of the model. The desired motion goes from
# hanging to a raised pose in one second, stays there, and returns. Each leg is the polynomial of fifth degree
# that starts and ends at rest.

t = np.linspace(0.0, 4.0, 801)
raised = np.array([1.3, -0.9])


def leg(s):
    """Return progress, and its first two derivatives, of the polynomial 10s³ − 15s⁴ + 6s⁵ on 0 ≤ s ≤ 1."""
    s = np.clip(s, 0.0, 1.0)
    return 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


up, down = leg(t - 0.25), leg(t - 2.25)
q, qdot, qddot = ((a - b)[:, None] * raised for a, b in zip(up, down, strict=True))
torque = np.einsum("tij,tj->ti", model.mass_matrix(q), qddot - model.acceleration(q, qdot))

# %%
# Apply these torques to the *true* arm in open loop, where no feedback corrects an error. For comparison, we
# also apply the torques of a model without friction candidates.

rigid = la.discover(data, library)
without_friction = np.einsum("tij,tj->ti", rigid.mass_matrix(q), qddot - rigid.acceleration(q, qdot))
driven = arm.simulate(q[0], qdot[0], t, torque)
driven_without = arm.simulate(q[0], qdot[0], t, without_friction)
print("found model:", np.abs(driven.q - q).max().round(4), "rad at most")
print("without friction:", np.abs(driven_without.q - q).max().round(4), "rad at most;", rigid.fit.status)

figure, axes = plt.subplots(
    3, 1, figsize=(9, 7), sharex=True, layout="constrained", height_ratios=[2, 2, 1.6]
)
for i, colour in enumerate(["tab:blue", "tab:orange"]):
    axes[0].plot(t, torque[:, i], color=colour, label=f"joint {i + 1}")
    axes[1].plot(t, q[:, i], color="0.75", lw=6, label="desired" if i == 0 else None)
    axes[1].plot(t, driven.q[:, i], color=colour, label=f"joint {i + 1}, torques of the found model")
    axes[1].plot(t, driven_without.q[:, i], ":", color=colour, label="the same, friction not offered")
    axes[2].plot(t, 1e3 * (driven.q - q)[:, i], color=colour)
axes[0].set_ylabel("torque (N m)")
axes[1].set(ylabel="angle (rad)", ylim=(-2.0, 2.5))
axes[2].set(ylabel="error with the\nfound model (mrad)", xlabel="t (s)")
axes[0].legend(fontsize=9)
axes[1].legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
plt.show()

# %%
# **What to learn.** With measured torques, no coefficient has to be known, and friction is distinguished from
# inertia as long as the excitation contains fast and slow movements. The model is accurate enough for some
# seconds of open-loop control. A controller only has to correct the rest.
