"""
Planning the next experiment
============================

Two structures explain the data equally well. Which single new recording would distinguish them? The models
themselves tell you: simulate both from many starts, and choose the one where they disagree most.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

# %%
# Springs that stiffen with the distance from the centre hold a mass in the plane. The first recordings are
# the obvious ones: pulled along one axis and released, then along the other.

plane = systems.MechanicalSystem(
    name="plane",
    title="Mass in the plane",
    coordinates=("x", "y"),
    lagrangian={
        "x_dot**2": 0.5,
        "y_dot**2": 0.5,
        "x**2": -2.0,
        "y**2": -2.6,
        "(x**2+y**2)**2": -0.5,
    },
    known={"x_dot**2": 0.5},
    library=("x_dot**2", "y_dot**2"),
    initial=lambda rng: (np.zeros(2), np.zeros(2)),
)
NOISE = 0.02
rng = np.random.default_rng(3)
t = np.linspace(0.0, 8.0, 401)


def record(x0, y0, name):
    """Let go at (x0, y0) and measure with noise."""
    q = plane.simulate([x0, y0], [0.0, 0.0], t).q
    return la.Trajectory(t, q + NOISE * rng.standard_normal(q.shape), coordinates=["x", "y"], name=name)


first = [record(1.2, 0.0, "along x"), record(0.0, 1.2, "along y")]
candidates = [
    *("x_dot**2", "y_dot**2", "x_dot*y_dot", "x**2", "y**2", "x*y"),
    *("x**4+y**4", "(x**2+y**2)**2"),
]
known = {"x_dot**2": 0.5}
model = la.discover(first, la.Library(candidates, ["x", "y"]), known=known)
print(model.format_table())

# %%
# The warning states the problem: each spring may stiffen on its own (x⁴ + y⁴), or both together ((x² + y²)²).
# The trade-off curve lists the runners-up; a distance below 10 is not decisive.

path = model.diagnostics.path
chosen = next(point for point in path if point.chosen)
for point in path:
    if point.n_terms == chosen.n_terms:
        print(f"{point.bic:8.1f}  {', '.join(point.expressions)}")

# %%
# Fit each structure alone, and release the mass at every place within reach, 1.5 m from the centre.

rivals = {}
for quartic in ("x**4+y**4", "(x**2+y**2)**2"):
    terms = ["x_dot**2", "y_dot**2", "x**2", "y**2", quartic]
    rivals[quartic] = la.discover(first, la.Library(terms, ["x", "y"]), known=known)
    print(f"{quartic:16}", rivals[quartic].lagrangian)

side = np.linspace(-1.5, 1.5, 61)
starts = np.stack(np.meshgrid(side, side), axis=-1)


def released(system, step=0.02):
    """Return the motions from all starts, at rest first, shape (n_times, 61, 61, 2), by Runge–Kutta."""
    q, v, motion = starts, np.zeros_like(starts), [starts]
    for _ in range(round(t[-1] / step)):
        a1 = system.acceleration(q, v)
        a2 = system.acceleration(q + step / 2 * v, v + step / 2 * a1)
        a3 = system.acceleration(q + step / 2 * v + step**2 / 4 * a1, v + step / 2 * a2)
        a4 = system.acceleration(q + step * v + step**2 / 2 * a2, v + step * a3)
        q = q + step * v + step**2 / 6 * (a1 + a2 + a3)
        v = v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        motion.append(q)
    return np.array(motion)


one, two = (released(rival) for rival in rivals.values())
difference = np.sqrt(np.mean((one - two) ** 2, axis=(0, 3))) / NOISE
difference[np.hypot(*np.moveaxis(starts, -1, 0)) > 1.5] = np.nan  # out of reach
place = np.unravel_index(np.nanargmax(difference), difference.shape)
best = starts[place]
print(f"let go at x = {best[0]:.2f}, y = {best[1]:.2f}")
print(f"the models differ there by {difference[place]:.0f} times the noise")

# %%
# Make this recording, and forecast it with both models. One comes close to the noise, although its
# coefficients still come from the poor first data. The other is far off. With all three recordings, the
# question is settled.

new = record(*best, "planned")
for name, rival in rivals.items():
    forecast = rival.validate(new, horizon=2.0)
    print(f"{name:16} rms error / noise: {(forecast.rms / NOISE).round(1)}")
final = la.discover([*first, new], la.Library(candidates, ["x", "y"]), known=known)
print(final.format_table())

# %%
# Left: rms difference of the two models in units of the noise, for every starting position. The first two
# recordings started where the models agree. Right: the planned recording and both forecasts.

figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.6), layout="constrained", width_ratios=[1.1, 1])
image = left.pcolormesh(side, side, difference, cmap="viridis", shading="nearest", rasterized=True)
figure.colorbar(image, ax=left, label="difference of the forecasts / noise")
for k, run in enumerate([(1.2, 0.0), (0.0, 1.2)]):
    left.plot(*run, "wo", ms=8, mec="black", label="first recordings" if k == 0 else None)
left.plot(*best, "*", color="tab:red", ms=18, mec="white", label="next recording")
left.set(xlabel="x at the start (m)", ylabel="y at the start (m)", aspect="equal")
left.legend(loc="upper right", fontsize=8)

shown = t <= 3.0
right.plot(t[shown], new.q[shown, 0], ".", color="0.6", ms=4, label="x, measured")
for (name, rival), colour in zip(rivals.items(), ["tab:orange", "tab:blue"], strict=True):
    motion = rival.simulate(best, [0.0, 0.0], t[shown])
    right.plot(motion.t, motion.q[:, 0], color=colour, label=f"with {name.replace('**', '^')}")
right.set(xlabel="t (s)", ylabel="x (m)")
right.legend(fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
plt.show()

# %%
# **What to learn.** If two structures cannot be distinguished, more data of the same kind do not help. Record
# a motion in which they differ; the models tell you which.
