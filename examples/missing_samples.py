"""
Missing and irregular samples
=============================

Cameras drop frames, links hide markers, and loggers share a bus. Samples need not be on a grid, need not be
simultaneous for all coordinates, and may be missing. Mark a missing sample by an empty cell in a table, or by
NaN in an array.
"""

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import systems

truth = systems.get("double_pendulum")
settings = {"noise": 0.02, "trials": 2, "duration": 10.0, "irregular": True, "seed": 4}

# %%
# Four versions of the same motions, sampled irregularly about 100 times per second. More and more samples are
# missing, independently for each coordinate. The last version has about five samples per second of each
# angle.

lost = [0.0, 0.5, 0.8, 0.95]
library = la.Library(truth.library, truth.coordinates, angles=truth.angles)
recordings = [systems.generate(truth, missing=fraction, **settings) for fraction in lost]
models = [la.discover(data, library) for data in recordings]
for fraction, data, model in zip(lost, recordings, models, strict=True):
    right = la.metrics.exact_support({t.expression: t.coefficient for t in model.terms}, truth.lagrangian)
    print(
        f"{100 * fraction:3.0f} % lost, {data.n_samples:5d} samples: {model.fit.status}, terms exact: {right}"
    )

# %%
# What not to do: fill the gaps by interpolation, so that the table looks complete. The filled values are not
# measurements, and their errors are neither small nor random.


def filled(run):
    """Return a trajectory whose missing samples are interpolated linearly."""
    columns = []
    for column in run.q.T:
        there = np.isfinite(column)
        columns.append(np.interp(run.t, run.t[there], column[there]))
    return la.Trajectory(run.t, np.column_stack(columns), run.forces, run.coordinates, run.name)


interpolated = la.discover([filled(run) for run in recordings[1]], library)
print(interpolated.format_table())

# %%
# Left: two seconds of the recording with 80 % of the samples missing, and the fitted curve. Right: the errors
# of the coefficients in per cent with 95 % intervals, on a scale that is linear up to one per cent. The fewer
# samples, the wider the intervals, as they should be. With half of the samples filled in, the coefficients
# are off by three quarters, and the status says that something is wrong.

figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.8), layout="constrained", width_ratios=[1, 1.2])
run = recordings[2][0]
fine = np.linspace(2.0, 4.0, 400)
times = [fine] + [r.t for r in recordings[2][1:]]
curve = models[2].diagnostics.curve(times)[0]
for i, (name, colour) in enumerate([("θ₁", "tab:blue"), ("θ₂", "tab:orange")]):
    inside = (run.t > 2.0) & (run.t < 4.0)
    left.plot(run.t[inside], run.q[inside, i], "o", ms=4, color=colour, alpha=0.6, label=f"{name}, measured")
    left.plot(fine, curve[:, i], color=colour)
left.set(xlabel="t (s)", ylabel="angle (rad)", title="80 % of the samples are missing")
left.legend(fontsize=9)

groups = [*zip([f"{100 * f:.0f} % lost" for f in lost], models, strict=True)]
groups.append(("50 % lost, gaps filled", interpolated))
for k, (name, model) in enumerate(groups):
    table = model.table().reindex(list(truth.lagrangian)).dropna(subset="coefficient")
    rows = np.array([list(truth.lagrangian).index(e) for e in table.index]) + 0.14 * (k - 2)
    size = np.array([truth.lagrangian[e] for e in table.index])
    colour = "tab:red" if "filled" in name else plt.get_cmap("Blues")(0.95 - 0.17 * k)
    right.errorbar(
        100 * (table["coefficient"] / size - 1),
        rows,
        xerr=100 * 1.96 * table["standard_error"] / size,
        fmt="o",
        ms=4,
        capsize=2,
        color=colour,
        label=name,
    )
right.axvline(0.0, color="0.6", lw=0.8, zorder=0)
right.set_yticks(range(len(truth.lagrangian)), ["θ̇₁²", "θ̇₂²", "θ̇₁θ̇₂cos(θ₁−θ₂)", "cos θ₁", "cos θ₂"])
right.invert_yaxis()
right.set_xscale("symlog", linthresh=1.0)
right.set_xlim(-2.0, 300.0)
ticks = [-1, 0, 1, 10, 100]
right.set_xticks(ticks, [str(tick) for tick in ticks])
right.set_xlabel("error of the coefficient (%)")
right.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
plt.show()

# %%
# **What to learn.** Provide the measurements as they are. Each sample counts at its own time. Gaps cost
# accuracy, and the intervals show how much. Filled gaps ruin the result.
