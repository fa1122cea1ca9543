"""
When the library lacks a term
=============================

A term that is not a candidate cannot be found, and the result should then say so. A cart on a spring carries
a pendulum; the spring stiffens when it is stretched, and the candidates do not include such a spring.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

cart = systems.get("cart_spring_pendulum")
stiffening = systems.MechanicalSystem(
    name="stiffening",
    title="Cart on a stiffening spring",
    coordinates=cart.coordinates,
    angles=cart.angles,
    lagrangian={**cart.lagrangian, "x**4": -0.6},
    known=cart.known,
    library=cart.library,
    initial=cart.initial,
)
data = systems.generate(stiffening, noise=0.01, trials=4, duration=10.0, seed=0)

without = [text for text in cart.library if text not in ("x**3", "x**4")]
lacking = la.discover(data, la.Library(without, ["x", "theta"], angles=["theta"]), known=cart.known)
print(lacking.format_table())

# %%
# The coefficients look plausible, the intervals are narrow, and the model is wrong. The status is *doubtful*.
# The warnings name the equation that does not hold and, because x⁴ is a common term, the remedy. A script
# should test ``model.fit.status`` before it continues.
#
# **What if the term is not a common one?** The warning names the equation to look at, that of x. Insert the
# fitted curve and its derivatives into the equations, and plot the remaining force on the cart.

q, qdot, qddot = (np.concatenate(lacking.diagnostics.curve(nu=nu)) for nu in range(3))
rest = np.einsum("tij,tj->ti", lacking.mass_matrix(q), qddot - lacking.acceleration(q, qdot))
x, x_dot, force = q[:, 0], qdot[:, 0], rest[:, 0]

# %%
# Plotted against the velocity, the remaining force is a cloud, so it is not friction. Plotted against the
# position, it is a cubic curve, so the potential has a fourth power. With this candidate, the discovery
# succeeds.

complete = la.discover(data, la.Library(cart.library, ["x", "theta"], angles=["theta"]), known=cart.known)
print(complete.format_table())


def trend(axis, u, colour):
    """Draw the mean of the force in 24 bins of u."""
    edges = np.quantile(u, np.linspace(0.0, 1.0, 25))
    place = np.clip(np.searchsorted(edges, u) - 1, 0, 23)
    middle = [np.mean(u[place == k]) for k in range(24)]
    axis.plot(middle, [np.mean(force[place == k]) for k in range(24)], "o-", ms=4, color=colour, label="mean")


figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.3), sharey=True, layout="constrained")
limit = 1.4 * np.quantile(np.abs(force), 0.99)
for axis, u, label in ((left, x_dot, "velocity of the cart (m/s)"), (right, x, "position of the cart (m)")):
    axis.plot(u, force, ".", ms=2.5, color="0.6", alpha=0.5, mew=0)
    trend(axis, u, "tab:blue")
    axis.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    axis.set(xlabel=label, ylim=(-limit, limit))
left.set_ylabel("force that the equations leave over (N)")
found = {t.expression: t.coefficient for t in lacking.terms}
line = np.linspace(x.min(), x.max(), 200)
true_spring = stiffening.lagrangian["x"] + 2 * stiffening.lagrangian["x**2"] * line - 4 * 0.6 * line**3
bent_spring = found["x"] + 2 * found["x**2"] * line
right.plot(line, true_spring - bent_spring, color="tab:red", label="true spring minus the linear one found")
right.legend(fontsize=9)
plt.show()

# %%
# **What to learn.** The warnings of a doubtful result name the equation that does not hold. Plot its
# remaining force against each coordinate and each velocity: this usually shows what kind of term to add.
