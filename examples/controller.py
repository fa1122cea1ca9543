"""
A model exported into a controller
==================================

A cart on a spring carries a pendulum. From recordings of free swings we find the model and export it as a
Python module that needs only ``math``. With it we design a controller that pushes the cart so that the
pendulum stands upside down.
"""

import tempfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are
from scipy.optimize import fsolve

import leastaction as la
from leastaction import systems

machine = systems.get("cart_spring_pendulum").with_dissipation({"x_dot**2/2": 0.4, "theta_dot**2/2": 0.02})
data = systems.generate(machine, noise=0.03, trials=4, duration=10.0, seed=0)
library = la.Library(machine.library, ["x", "theta"], angles=["theta"])
friction = ["x_dot**2/2", "theta_dot**2/2"]
model = la.discover(data, library, known={"cos(theta)": 9.81}, dissipation=friction)
print(model.format_table())

# %%
# The module has plain functions of plain numbers. ``format="c"`` writes the same for a microcontroller.

folder = Path(tempfile.mkdtemp())
text = la.export(model, "python", folder / "cart.py")
print(text.partition("def energy")[0])

spec = spec_from_file_location("cart", folder / "cart.py")
cart = module_from_spec(spec)
spec.loader.exec_module(cart)

# %%
# **The equilibrium** near θ = π is where the acceleration vanishes.

rest = fsolve(lambda q: cart.acceleration(q, [0.0, 0.0]), [0.5, np.pi])
print("equilibrium: x = {:.4f} m, theta = {:.6f} rad".format(*rest))


def derivative(state, force):
    """Rates of the state (x, θ, ẋ, θ̇) with a force on the cart, by the exported model."""
    return np.array([*state[2:], *cart.acceleration(state[:2], state[2:], [force, 0.0])])


# %%
# **The linear–quadratic regulator.** Linearise by central differences and solve the Riccati equation. The
# force on the cart is −K times the deviation from the equilibrium.

upright, step = np.array([*rest, 0.0, 0.0]), 1e-5
a = np.column_stack(
    [(derivative(upright + e, 0.0) - derivative(upright - e, 0.0)) / (2 * step) for e in step * np.eye(4)]
)
b = ((derivative(upright, step) - derivative(upright, -step)) / (2 * step))[:, None]
q_weight, r_weight = np.diag([2.0, 20.0, 1.0, 2.0]), 0.02
gain = (b.T @ solve_continuous_are(a, b, q_weight, np.array([[r_weight]])) / r_weight).ravel()
print("growth without control:", np.linalg.eigvals(a).real.max().round(2), "1/s")
print("gain:", gain.round(1))
print("poles with control:", np.linalg.eigvals(a - b * gain).round(2))

# %%
# **Test on the machine, not on the model.** The true system, which generated the data, starts 0.35 rad from
# upright.


def closed_loop(t, state):
    force = -gain @ (state - upright)
    acceleration = machine.acceleration(state[:2], state[2:], [force, 0.0])
    return [*state[2:], *acceleration]


start = upright + np.array([0.0, 0.35, 0.0, 0.0])
t = np.linspace(0.0, 5.0, 501)
run = solve_ivp(closed_loop, (0.0, 5.0), start, t_eval=t, rtol=1e-9, atol=1e-9).y.T
force = -(run - upright) @ gain
print(f"after 5 s {np.abs(run[-1] - upright).max():.3f} from the equilibrium")
print(f"greatest force {np.abs(force).max():.0f} N")

figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.4), layout="constrained", width_ratios=[1.3, 1])
frames = [0, 12, 24, 36, 50, 70, 100, 150, 300]
for k, frame in enumerate(frames):
    x, theta = run[frame, :2]
    colour = plt.get_cmap("viridis_r")(0.1 + 0.9 * k / (len(frames) - 1))
    tip = [x + np.sin(theta), -np.cos(theta)]
    left.plot([x, tip[0]], [0.0, tip[1]], "-", lw=2, color=colour, label=f"{t[frame]:.2f} s")
    left.plot(*tip, "o", ms=9, color=colour)
    left.plot(x, 0.0, "s", ms=11, color=colour)
left.axhline(-0.06, color="0.6", lw=1, zorder=0)
left.set(aspect="equal", xlabel="x (m)", ylabel="height (m)", title="the machine, caught")
left.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)

right.plot(t, run[:, 1] - np.pi, color="tab:blue", label="angle from upright (rad)")
right.plot(t, run[:, 0] - rest[0], color="tab:orange", label="cart from its rest (m)")
right.plot(t, force / 100, color="0.5", lw=1, label="force (100 N)")
right.axhline(0.0, color="0.7", lw=0.8, zorder=0)
right.set(xlabel="t (s)")
right.legend(fontsize=9)
plt.show()

# %%
# **What to learn.** The recordings are free swings, and yet the model is accurate enough to stabilise the
# upright position, because the law also holds outside the recorded motions. Still, check how far your
# recordings reach: a spring that is linear in the recorded range may not be linear elsewhere.
