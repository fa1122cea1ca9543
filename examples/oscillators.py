"""
Polynomial oscillators
======================

Which polynomial is the potential? We start with a Duffing oscillator with two wells and continue with two
oscillators that have a coupling of fourth degree. The candidates are all monomials up to a degree that is too
high on purpose.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

# %%
# One coordinate, two wells
# -------------------------
# L = ½ẋ² + ½x² − ¼x⁴, with viscous friction, so the motion settles in one of the wells.

duffing = systems.MechanicalSystem(
    name="duffing",
    title="Duffing oscillator",
    coordinates=("x",),
    lagrangian={"x_dot**2": 0.5, "x**2": 0.5, "x**4": -0.25},
    dissipation={"x_dot**2/2": 0.06},
    known={"x_dot**2": 0.5},
    library=("x_dot**2", "x**2", "x**4"),
    initial=lambda rng: (rng.uniform(-1.8, 1.8, 1), rng.uniform(-0.5, 0.5, 1)),
)
data = systems.generate(duffing, noise=0.05, trials=4, duration=25.0, rate=20.0, seed=2)

candidates = ["x_dot**2", "x_dot**2*x", "x_dot**2*x**2", *(f"x**{k}" for k in range(1, 9))]
library = la.Library(candidates, ["x"])
model = la.discover(data, library, known={"x_dot**2": 0.5}, dissipation=["x_dot**2/2", "abs(x_dot)"])
print(model.format_table())

# %%
# Two coordinates
# ---------------
# A generated library of degree 6. With two lengths it has 27 monomials for the potential and 18 kinetic
# terms.

pair = systems.MechanicalSystem(
    name="pair",
    title="Two coupled oscillators",
    coordinates=("x", "y"),
    lagrangian={
        "x_dot**2": 0.5,
        "y_dot**2": 0.5,
        "x**2": -0.5,
        "y**2": -1.0,
        "x**4": -0.1,
        "x**2*y**2": -0.6,
    },
    known={"x_dot**2": 0.5},
    library=("x_dot**2", "y_dot**2", "x**2", "y**2", "x**4", "x**2*y**2"),
    initial=lambda rng: (rng.uniform(-2.0, 2.0, 2), rng.uniform(-1.0, 1.0, 2)),
)
pair_data = systems.generate(pair, noise=0.05, trials=4, duration=15.0, rate=40.0, seed=0)
pair_library = la.Library.mechanical(["x", "y"], degree=6)
pair_model = la.discover(pair_data, pair_library, known={"x_dot**2": 0.5})
print(pair_library.summary())
print(pair_model.format_table())

# %%
# Both potentials. A potential is −L at rest, which is the energy of the model at zero velocity.

x = np.linspace(-2.1, 2.1, 201)[:, None]
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
left.plot(x, duffing.energy(x, 0 * x), color="0.75", lw=6, label="true")
left.plot(x, model.energy(x, 0 * x), color="tab:blue", label="found")
left.set(xlabel="x", ylabel="potential", ylim=(-0.5, 1.6), title="Duffing oscillator")
recorded = np.concatenate([run.q[:, 0] for run in data])
below = left.inset_axes([0.0, 0.0, 1.0, 0.12], sharex=left)
below.hist(recorded, bins=80, color="0.6")
below.axis("off")
left.legend(loc="upper center", fontsize=9)

grid = np.stack(np.meshgrid(np.linspace(-2.2, 2.2, 121), np.linspace(-2.2, 2.2, 121)), axis=-1)
levels = np.arange(0.5, 12.0, 1.0)
true, found = pair.energy(grid, 0 * grid), pair_model.energy(grid, 0 * grid)
right.contour(*np.moveaxis(grid, -1, 0), true, levels, colors="0.75", linewidths=4)
right.contour(*np.moveaxis(grid, -1, 0), found, levels, colors="tab:blue", linewidths=1)
path = pair_model.diagnostics.curve()[0]
right.plot(*path[:300].T, color="tab:orange", lw=0.8)
right.set(xlabel="x", ylabel="y", aspect="equal", title="found (blue) on true (grey), and a motion")
plt.show()

# %%
# **What to learn.** Within the range of the motion, candidates of too high a degree do no harm: superfluous
# powers are not selected. Outside the recorded range (the histogram and the orange path), the potential is an
# extrapolation, and the data contain no information about it.
