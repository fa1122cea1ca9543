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
# **What the camera measures.** The bob is at the end of a link that turns about the pivot. Pivot, length in
# pixels and roll are numbers in braces: they are estimated together with the law. `leastaction.measure`
# returns these functions as texts.

measure = la.measure.camera(["theta"], [("u", "v")])
print("\n".join(measure))
data = la.Trajectories(la.Trajectory(t, pixels, coordinates=["u", "v"]) for pixels in films)
print(data)

# %%
# **The law.** The columns are pixels, but the candidates are functions of the angle. The data determine L up
# to a factor. With ½ for ``theta_dot**2`` it is L / (m l²), so the coefficient of ``cos(theta)`` is g / l. No
# start values are needed.

library = la.Library(
    ["theta_dot**2", "theta_dot**2*cos(theta)", "cos(theta)", "cos(2*theta)", "theta**2"],
    ["theta"],
    angles=["theta"],
)
model = la.discover(
    data,
    library,
    {"theta_dot**2": 0.5},
    dissipation=["theta_dot**2/2", "abs(theta_dot)"],
    measure=measure,
)
print(model.format_table())

# %%
# The candidates have their zero at the vertical of the laboratory, along which gravity acts. The law
# therefore determines the roll of the camera, and g/l determines the length. Rounding to whole pixels counts
# as noise of the columns.

found = {number.name: number for number in model.calibration.numbers}
strength = next(term for term in model.terms if term.expression == "cos(theta)")
roll, column, row, radius = (found[name].value for name in ("tilt", "x0", "y0", "l1"))
print(f"length {9.81 / strength.coefficient:.4f} m (true {LENGTH})")
error = np.rad2deg(found["tilt"].standard_error)
print(f"roll {np.rad2deg(roll):.3f}° ± {error:.3f}° (true {np.rad2deg(ROLL):.1f}°)")
print(f"pivot at ({column:.2f}, {row:.2f}), {radius / (9.81 / strength.coefficient):.1f} pixels per metre")
print("noise of the columns:", np.round(model.calibration.noise_std, 2), "pixels")
print("\n".join(f"- {note}" for note in model.diagnostics.notes))

# %%
# Left: the positions that the camera reports. Right: half a second around a turning point, with the fitted
# curve. The steps are whole pixels.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained", width_ratios=[1, 1.25])
for pixels, colour in zip(films, ["tab:blue", "tab:orange"], strict=True):
    left.plot(*pixels[:200].T, ".", ms=3, color=colour)
left.plot(column, row, "k+", ms=12)
left.plot([column, column], [row, row + 230], ":", color="0.4", label="vertical of the picture")
plumb = np.array([column, row]) + 230 * np.array([[0.0, 0.0], [np.sin(roll), np.cos(roll)]])
left.plot(*plumb.T, color="tab:red", label="vertical that the law found")
left.legend(fontsize=8, loc="lower center")
left.set(xlim=(0, 640), ylim=(480, 0), aspect="equal", xlabel="column (pixels)", ylabel="row (pixels)")

fine = np.linspace(0.0, t[-1], 12_001)
curve = model.calibration.evaluate(model.diagnostics.curve([fine, fine])[0])[:, 0]
inside, shown = (t > 15.4) & (t < 15.85), (fine > 15.4) & (fine < 15.85)
right.plot(t[inside], films[0][inside, 0], "o", ms=5, color="0.45", label="column, whole pixels")
right.plot(fine[shown], curve[shown], color="tab:blue", label="fitted curve, half a pixel either way")
right.fill_between(fine[shown], curve[shown] - 0.5, curve[shown] + 0.5, color="tab:blue", alpha=0.2, lw=0)
right.set(xlabel="t (s)", ylabel="column (pixels)")
right.legend(fontsize=9)
plt.show()

# %%
# **What to learn.** Convert recordings as little as possible: do not filter them, and do not take differences
# of frames. Write what a sensor measures as a function, with a name in braces for each unknown number. The
# fit estimates these numbers. If ``sin(theta)`` were a candidate, too, it could absorb the roll.
