"""
A measured triple pendulum
==========================

Three links swing freely, and encoders record the three angles at 500 Hz. From 11 pieces of 1.5 s we find the
Lagrangian and the friction. With them we forecast the 11 other pieces.

The recording is from the laboratory pendulum of Kaheman et al., HardwareX 15, 2023 (MIT licence). Each angle
is measured from upright, so all links hang at π.
"""

from itertools import combinations, pairwise
from pathlib import Path

import matplotlib.pyplot as plt

import leastaction as la

here = Path(__file__).parent if "__file__" in globals() else Path()  # the gallery runs it in its folder
names = ["theta1", "theta2", "theta3"]
data = la.read_csv(here / "data" / "triple_pendulum.csv.gz", coordinates=names)

fitted, held_out = data[::2], data[1::2]
print(fitted)
print(held_out)

# %%
# The textbook law has nine terms: three squared velocities, three products with the cosine of a difference,
# and three cosines. The candidates include 27 others: products without a cosine, with a sine, and with the
# cosine of a sum, inertias that depend on an angle, springs between links, and further harmonics.

pairs = list(combinations(names, 2))
candidates = [
    *(f"{a}_dot**2" for a in names),
    *(
        f"{a}_dot*{b}_dot{factor}"
        for a, b in pairs
        for factor in ("", f"*cos({a}-{b})", f"*sin({a}-{b})", f"*cos({a}+{b})")
    ),
    *(f"{a}_dot**2*cos({b}-{c})" for a in names for b, c in pairs),
    *(f"{function}({a})" for a in names for function in ("cos", "sin")),
    *(f"cos({a}-{b})" for a, b in pairs),
    *(f"cos(2*{a})" for a in names),
]
friction = [
    *(f"{a}_dot**2/2" for a in names),
    *(f"({b}_dot-{a}_dot)**2/2" for a, b in pairwise(names)),
    "abs(theta1_dot)",
    *(f"abs({b}_dot-{a}_dot)" for a, b in pairwise(names)),
]
library = la.Library(candidates, names, angles=names)
model = la.discover(fitted, library, known={"theta1_dot**2": 1.0}, dissipation=friction)
print(model.format_table())

# %%
# The nine terms of L are those of the textbook. Friction is the least certain part: it is small, and viscous
# friction in a joint is hard to tell from that of a link in the air.
#
# What the equations leave unexplained, and how far ahead the model forecasts by its own intervals:

print(model.fit.status)
for statement, words in model.fit.statements.items():
    print(f"{statement}: {words}")

# %%
# Forecasts of the pieces that were held out. Each starts from the state that best fits half a second of data,
# and simulates one second.

forecast = model.validate(held_out, horizon=1.0, window=0.5)
print("rms error (rad):", forecast.rms.round(4), "in", len(forecast.traces), "forecasts")
print("of the spread:  ", (forecast.rms / forecast.std).round(4))

# %%
# The forecast with the largest error, above, and its error, below.

worst = max(forecast.traces, key=lambda trace: trace.rms.max())
seconds = worst.t - worst.origin
figure, (top, bottom) = plt.subplots(2, figsize=(8, 5), sharex=True, layout="constrained")
for i, name in enumerate(["θ₁", "θ₂", "θ₃"]):
    top.plot(seconds[::10], worst.measured[::10, i], ".", color="0.6", ms=5)
    top.plot(seconds, worst.forecast[:, i], color=f"C{i}", label=f"forecast of {name}")
    bottom.plot(seconds, 1e3 * (worst.forecast - worst.measured)[:, i], color=f"C{i}")
top.plot([], [], ".", color="0.6", label="measured (every 10th sample)")
top.legend(fontsize=8, ncols=2)
top.set_ylabel("angle from upright (rad)")
top.set_title(f"largest error: {worst.trial}", loc="left", fontsize=10)
bottom.axhline(0.0, color="0.7", lw=0.8, zorder=0)
bottom.set_ylabel("error (mrad)")
bottom.set_xlabel("seconds after the start of the forecast")
plt.show()

# %%
# **What to learn.** Offer the terms that links can have and some that they cannot have: a law without the
# latter is more convincing. Short pieces are enough if there are several: these 11 last 17 s together.

assert len(model.terms) == 9
