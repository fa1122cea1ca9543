"""
From camera pixels to a Lagrangian
==================================

A camera films a pendulum, and a tracker reports the position of the bob in whole pixels. The position of the
pivot in the picture is unknown, and the camera is not quite level. What is the length of the pendulum, how
strong is the friction, and by how much is the camera tilted?
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import leastaction as la

# %%
# The film is simulated: 60 frames per second, 640 × 480 pixels, a pendulum of 0.62 m at 500 pixels per metre.
# The camera is rolled by 1.5°. One frame in ten has no detection.

LENGTH, FRICTION, ROLL = 0.62, 0.12, np.deg2rad(1.5)
rng = np.random.default_rng(5)
t = np.arange(0.0, 20.0, 1 / 60)


def film(angle, rate):
    """Return the pixels (column, row) of the bob in every frame; NaN where the tracker lost it."""
    motion = solve_ivp(
        lambda _, s: [s[1], -9.81 / LENGTH * np.sin(s[0]) - FRICTION * s[1]],
        (t[0], t[-1]),
        [angle, rate],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    )
    seen = motion.y[0] + ROLL
    exact = [320.4, 71.7] + 500 * LENGTH * np.column_stack([np.sin(seen), np.cos(seen)])
    pixels = np.round(exact + 0.3 * rng.standard_normal(exact.shape))
    pixels[rng.random(t.size) < 0.1] = np.nan
    return pixels


films = [film(1.2, 0.0), film(-0.8, 1.0)]
print(films[0][:5])

# %%
# **From pixels to an angle.** The bob moves on a circle. Fit the circle; its centre is the pivot. The angle
# is measured from the vertical *of the picture*. The data will tell whether that is the vertical of the
# laboratory.

bob = np.concatenate(films)
bob = bob[np.isfinite(bob).all(axis=1)]
circle = least_squares(lambda c: np.hypot(*(bob - c[:2]).T) - c[2], [320.0, 100.0, 300.0])
column, row, radius = circle.x
print(f"pivot at ({column:.2f}, {row:.2f}), radius {radius:.2f} pixels")

angles = [np.arctan2(pixels[:, 0] - column, pixels[:, 1] - row) for pixels in films]
data = la.Trajectories(la.Trajectory(t, theta, coordinates=["theta"]) for theta in angles)
print(data)

# %%
# **From the angle to the law.** L is known up to a factor. With ½ for ``theta_dot**2`` it is L / (m l²), so
# the coefficient of ``cos(theta)`` is g / l.

library = la.Library(
    ["theta_dot**2", "theta_dot**2*cos(theta)", "cos(theta)", "sin(theta)", "cos(2*theta)", "theta**2"],
    ["theta"],
    angles=["theta"],
)
model = la.discover(data, library, {"theta_dot**2": 0.5}, dissipation=["theta_dot**2/2", "abs(theta_dot)"])
print(model.format_table())

# %%
# Gravity acts along the vertical of the laboratory: g/l · cos(θ − δ) = g/l · (cos δ cos θ + sin δ sin θ).
# Both the length and the roll of the camera are estimated, with standard errors.

found = {term.expression: term.coefficient for term in model.terms}
strength = np.hypot(found["cos(theta)"], found["sin(theta)"])
roll = np.arctan2(found["sin(theta)"], found["cos(theta)"])
table = model.table()
length = 9.81 / strength
print(f"length {length:.4f} m (true {LENGTH}), roll {np.rad2deg(roll):.2f}° (true {np.rad2deg(ROLL):.2f}°)")
print("\n".join(f"- {note}" for note in model.diagnostics.notes))

# %%
# Left: the positions that the camera reports. Right: half a second around a turning point, with the curve
# that obeys the law. The steps are whole pixels.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained", width_ratios=[1, 1.25])
for pixels, colour in zip(films, ["tab:blue", "tab:orange"], strict=True):
    left.plot(*pixels[:200].T, ".", ms=3, color=colour)
left.plot(column, row, "k+", ms=12)
left.plot([column, column], [row, row + 230], ":", color="0.4", label="vertical of the picture")
plumb = np.array([column, row]) + 230 * np.array([[0.0, 0.0], [np.sin(roll), np.cos(roll)]])
left.plot(*plumb.T, color="tab:red", label="vertical that the law found")
left.legend(fontsize=8, loc="lower center")
left.set(xlim=(0, 640), ylim=(480, 0), aspect="equal", xlabel="column (pixels)", ylabel="row (pixels)")

fine = np.linspace(0.0, 20.0, 12_001)
curve = model.diagnostics.curve([fine, fine])[0][:, 0]
inside, shown = (t > 15.4) & (t < 15.85), (fine > 15.4) & (fine < 15.85)
half = 0.5 / radius
right.plot(t[inside], angles[0][inside], "o", ms=5, color="0.45", label="from the pixels")
right.plot(fine[shown], curve[shown], color="tab:blue", label="fitted curve, half a pixel either way")
right.fill_between(fine[shown], curve[shown] - half, curve[shown] + half, color="tab:blue", alpha=0.2, lw=0)
right.set(xlabel="t (s)", ylabel="angle in the picture (rad)")
right.legend(fontsize=9, loc="upper center")
plt.show()

# %%
# **What to learn.** Convert recordings into coordinates with as little processing as possible. Do not filter,
# and do not difference frames. Unknown geometry (the pivot) must be determined first. A constant offset of an
# angle may remain: it appears in the law as a sine next to the cosine.
