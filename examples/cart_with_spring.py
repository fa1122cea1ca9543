"""
A cart on a spring, with friction
=================================

A pendulum hangs from a cart, a spring holds the cart, and the bearings of the cart have viscous friction.
Both coordinates are recorded with 5 % noise. Where is friction, and how strong is it? And what happens to the
other coefficients if friction is not among the candidates?
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

truth = systems.get("cart_spring_pendulum").with_dissipation({"x_dot**2/2": 0.4})
data = systems.generate(truth, noise=0.05, trials=3, duration=10.0, seed=3)
print(data)
print("true L:", truth.lagrangian)

# %%
# Gravity sets the scale: the coefficient of ``cos(theta)`` is m g l, which can be measured with a ruler and a
# balance. The other candidates are generated from the types of the coordinates. We offer viscous and dry
# friction at the cart and at the joint.

library = la.Library.mechanical(["x", "theta"], angles=["theta"])
friction = ["x_dot**2/2", "theta_dot**2/2", "abs(x_dot)", "abs(theta_dot)"]
model = la.discover(data, library, known={"cos(theta)": 9.81}, dissipation=friction)
print(library.summary())
print(model.format_table())

# %%
# The same without friction candidates. The fit does not fail; it is biased, because other terms absorb the
# missing force. The status says that the coefficients should not be used, and the warning says why.

frictionless = la.discover(data, library, known={"cos(theta)": 9.81})
print(frictionless.format_table())

# %%
# Left: the energy along the first recording. It is computed from the model with friction, along the curve
# that was fitted together with it; no velocity was measured. The energy lost to friction is the integral of c
# ẋ². Right: the coefficients relative to their true values, with 95 % intervals.

(t, q, qdot) = (data[0].t, *(model.diagnostics.curve(nu=nu)[0] for nu in range(2)))
energy = model.energy(q, qdot)
coefficient = {term.expression: term.coefficient for term in model.dissipation}["x_dot**2/2"]
power = coefficient * qdot[:, 0] ** 2
lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained", width_ratios=[1, 1.1])
left.plot(t, energy, color="tab:blue", label="energy of the model")
left.plot(t, energy[0] - lost, "--", color="tab:red", label="initial energy minus work of friction")
left.set(xlabel="t (s)", ylabel="energy (J)")
left.legend(fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)

exact = {e: c for e, c in {**truth.lagrangian, **truth.dissipation}.items() if e not in truth.known}
for k, (name, found, colour) in enumerate(
    [("with friction", model, "tab:blue"), ("friction not offered", frictionless, "tab:red")]
):
    table = found.table().query("not known")
    table = table[table.index.isin(list(exact))]
    rows = np.array([list(exact).index(e) for e in table.index]) + 0.18 * (2 * k - 1)
    size = np.array([exact[e] for e in table.index])
    right.errorbar(
        table["coefficient"] / size,
        rows,
        xerr=1.96 * table["standard_error"] / np.abs(size),
        fmt="o",
        ms=4,
        capsize=3,
        color=colour,
        label=name,
    )
right.axvline(1.0, color="0.6", lw=0.8, zorder=0)
right.set_yticks(range(len(exact)), list(exact))
right.invert_yaxis()
right.set_xlabel("found / true")
right.legend(fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
plt.show()

# %%
# **What to learn.** Offer friction candidates for every real system. Absent friction is not selected, whereas
# friction without a candidate biases the other coefficients and makes them uncertain.
