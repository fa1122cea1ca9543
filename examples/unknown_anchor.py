"""
A spring with an unknown anchor
===============================

A mass swings on a spring in a vertical plane, in front of a camera. The spring has a rest length and hangs on
a nail above the picture. Its energy is ½k(ρ − ℓ)², where ρ is the distance from the nail. The coordinates of
the nail are inside a square root, so no choice of coefficients can replace them. The nail and the law must be
found together.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la

# %%
# The experiment
# --------------
# 1 kg on a spring of 40 N/m with a rest length of 0.6 m. In the coordinates of the camera, the nail is at
# (0.31, 0.94) m. There are three recordings of 6 s; the noise is 1 % of the spread of each coordinate.

MASS, STIFFNESS, LENGTH, GRAVITY = 1.0, 40.0, 0.6, 9.81
NAIL = np.array([0.31, 0.94])


def motion(t, state):
    from_nail = state[:2] - NAIL
    distance = np.hypot(*from_nail)
    pull = -STIFFNESS * (distance - LENGTH) * from_nail / distance
    return [*state[2:], *(pull / MASS - [0.0, GRAVITY])]


rng = np.random.default_rng(0)
t = np.linspace(0.0, 6.0, 361)
data = []
for start in ([0.9, 0.5, 0.0, 0.5], [-0.3, 0.4, 0.6, -0.8], [0.4, 0.0, 1.6, 0.0]):
    q = solve_ivp(motion, (0.0, 6.0), start, t_eval=t, rtol=1e-9, atol=1e-9).y[:2].T
    data.append(la.Trajectory(t, q + 0.01 * q.std(axis=0) * rng.normal(size=q.shape), coordinates=["x", "y"]))

# %%
# Candidates
# ----------
# Common terms, and one with two unknown numbers in braces: the distance from a point (p, r). The energy of
# the spring has parts that are quadratic and linear in x and y, which common terms cover, and −kℓρ, which
# only the distance covers. The mass was weighed, so ½ẋ² is known.

library = la.Library(
    [*la.Library.mechanical(["x", "y"]), "sqrt((x-{p})**2+(y-{r})**2)"],
    ["x", "y"],
)
print(library.shapes)
model = la.discover(data, library, known={"x_dot**2": MASS / 2})
print(model.format_table())

# %%
# The last rows are the coordinates of the nail, with standard errors. The other constants follow from the
# coefficients: k from that of x², and ℓ from that of the distance, which is kℓ.

for shape, true in zip(model.shapes, NAIL, strict=True):
    print(f"{shape.name} = {shape.value:.4f} ± {shape.standard_error:.4f} m (true: {true} m)")
coefficients = {term.written: term.coefficient for term in model.terms}
stiffness = -2.0 * coefficients["x**2"]
length = coefficients["sqrt((x-{p})**2+(y-{r})**2)"] / stiffness
print(f"stiffness {stiffness:.2f} N/m (true: {STIFFNESS}), rest length {length:.4f} m (true: {LENGTH})")

# %%
# The motions, the estimated nail, and the potential of the model.

x, y = np.meshgrid(np.linspace(-0.9, 1.5, 121), np.linspace(-0.9, 1.6, 121))
q = np.stack([x, y], axis=-1)
potential = model.energy(q, 0.0 * q)
figure, axes = plt.subplots(figsize=(6.4, 5.6), layout="constrained")
levels = potential.min() + np.geomspace(0.5, 40.0, 12)
axes.contour(x, y, potential, levels, colors="0.8", linewidths=1, linestyles="solid")
for k, run in enumerate(data):
    axes.plot(*run.q.T, lw=0.9, label=f"run {k + 1}")
(p, r) = model.shapes
axes.errorbar(
    p.value,
    r.value,
    xerr=2 * r.standard_error,
    yerr=2 * r.standard_error,
    fmt="k+",
    ms=14,
    label="nail, found",
)
axes.plot(*NAIL, "o", ms=10, mfc="none", mec="tab:red", label="nail, true")
axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="found potential, motions and nail")
axes.legend(loc="lower right", fontsize=9)
plt.show()

# %%
# **What to learn.** If a number inside a function is unknown, write a name in braces. The fit that finds the
# law estimates it, with a standard error. Each such number makes a term more flexible, so use few of them.
# Record motions along which other terms cannot imitate this one: here the mass comes close to the nail and
# swings far to both sides.
