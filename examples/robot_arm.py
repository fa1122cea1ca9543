"""
A robot arm with two joints
===========================

A planar arm is driven by torques at both joints. The second angle is measured from the first link, as encoders on
gear motors do. We find its Lagrangian in newton metres (the torques set the scale), and use it for what
identified robot models are used for: to compute the torques that a wanted motion needs.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

# %%
# The arm, in SI units: point masses m₁, m₂ at the ends of links l₁, l₂, angles from hanging, viscous friction
# in both joints. The class takes the Lagrangian as text; it derives the equations of motion itself.

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
    arm, noise=1e-3, noise_convention="absolute", trials=5, duration=8.0, rate=200.0, seed=1
)
train, test = data[:4], data[4:]
print(train)

# %%
# Candidates are generated: 42 for L, and friction of both kinds in both joints. No coefficient has to be known.

library = la.Library.mechanical(["q1", "q2"], angles=["q1", "q2"])
friction = ["q1_dot**2/2", "q2_dot**2/2", "abs(q1_dot)", "abs(q2_dot)"]
model = la.discover(train, library, dissipation=friction)
print(model.format_table())

# %%
# All nine terms, and no others; compare with the truth:

table = model.table()
table["true"] = table.index.map({**arm.lagrangian, **arm.dissipation})
print(table[["coefficient", "standard_error", "true"]].to_string(float_format="{:.4f}".format))

# %%
# **Torques for a wanted motion.** With the mass matrix M and the acceleration a(q, q̇) that the arm would have
# without torques, the torque for a wanted q̈ is τ = M (q̈ − a). Both are methods of the model. We take the motion of
# the recording that was kept aside, smoothed without any model, and compare with the torques that were really applied.

(motion,) = la.smooth(test)
free = model.acceleration(motion.q, motion.qdot)
torque = np.einsum("tij,tj->ti", model.mass_matrix(motion.q), motion.qddot - free)

figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
for i, axis in enumerate(axes):
    axis.plot(motion.t, test[0].forces[:, i], color="0.65", lw=4, label="applied")
    axis.plot(motion.t, torque[:, i], color="tab:blue", lw=1.2, label="computed from the found model")
    inside = slice(40, -40)  # a smoother knows least about the ends
    error = np.sqrt(np.mean((torque - test[0].forces)[inside, i] ** 2))
    axis.set_title(f"joint {i + 1}: rms difference {1e3 * error:.0f} mN m", loc="left", fontsize=10)
    axis.set_ylabel("torque (N m)")
    axis.set_ylim(*(1.3 * np.abs(test[0].forces[:, i]).max() * np.array([-1, 1])))
axes[0].legend(loc="upper right", ncols=2, fontsize=9)
axes[1].set_xlabel("t (s)")
plt.show()

# %%
# **What to learn.** With measured torques nothing has to be known beforehand, and friction is told apart from
# inertia as long as the excitation holds fast and slow movements. The noise that is left in the computed torques
# comes from differentiating the test recording twice; the model itself never saw an acceleration.
