"""
Basins of attraction of a magnetic pendulum
===========================================

An iron bob swings above three magnets. From five recordings with 10 % noise and without friction, we find the
Lagrangian. Then we ask a question that no recording answers: with friction, at which magnet would the bob
stop, for every starting position?
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap

import leastaction as la
from leastaction import systems

truth = systems.get("magnetic_pendulum")
data = systems.generate(truth, noise=0.10, trials=5, duration=10.0, seed=0)
model = la.discover(data, la.Library(truth.library, ["x", "y"]), known=truth.known)
print(model.format_table())

# %%
# All starts are simulated at once: accelerations accept arrays of any shape, so one Runge–Kutta step of order
# 4 moves every pixel. The model has no friction; it is added as an external force.

FRICTION, STEP, DURATION, PIXELS = 0.25, 0.03, 24.0, 72
side = np.linspace(-1.8, 1.8, PIXELS)
starts = np.stack(np.meshgrid(side, side), axis=-1)
magnets = np.array([[np.cos(a), np.sin(a)] for a in (0.0, 2 * np.pi / 3, -2 * np.pi / 3)])


def resting_magnet(system):
    """Return the number of the magnet next to the bob after the motion from each start."""

    def rates(q, v):
        return v, system.acceleration(q, v, forces=-FRICTION * v)

    q, v = starts, np.zeros_like(starts)
    for _ in range(round(DURATION / STEP)):
        k1, l1 = rates(q, v)
        k2, l2 = rates(q + STEP / 2 * k1, v + STEP / 2 * l1)
        k3, l3 = rates(q + STEP / 2 * k2, v + STEP / 2 * l2)
        k4, l4 = rates(q + STEP * k3, v + STEP * l3)
        q, v = q + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4), v + STEP / 6 * (l1 + 2 * l2 + 2 * l3 + l4)
    return np.linalg.norm(q[..., None, :] - magnets, axis=-1).argmin(axis=-1)


true_basins, found_basins = resting_magnet(truth), resting_magnet(model)
agree = true_basins == found_basins
print(f"{100 * agree.mean():.1f} % of the starts end at the same magnet")

# %%
# The picture is fractal, and in the mixed regions the smallest error decides. Most pixels agree even there,
# which requires coefficients accurate to a few thousandths.

colours = ListedColormap(["#4477aa", "#ddcc77", "#cc6677"])
figure, axes = plt.subplots(1, 3, figsize=(11, 4.1), sharex=True, sharey=True, layout="constrained")
extent = (-1.8, 1.8, -1.8, 1.8)
for axis, image, title in zip(
    axes, (true_basins, found_basins), ("true Lagrangian", "found Lagrangian"), strict=False
):
    axis.imshow(image, origin="lower", extent=extent, cmap=colours, interpolation="nearest")
    axis.set_title(title)
axes[2].imshow(agree, origin="lower", extent=extent, cmap="gray", vmin=-0.5, vmax=1, interpolation="nearest")
axes[2].set_title(f"same magnet (white): {100 * agree.mean():.1f} %")
for axis in axes:
    axis.plot(*magnets.T, "o", mfc="white", mec="black", ms=7)
    axis.set_xlabel("x (m) at the start")
axes[0].set_ylabel("y (m) at the start")
plt.show()

# %%
# **What to learn.** A Lagrangian also describes motions that were not recorded. You can add a force that was
# absent in the recordings, and the model still predicts the motion.
