"""
A robot arm from its torques
============================

Two motors drive a double pendulum. The table has angles from encoders and torques from motor currents.
Identification often fails here: friction in the gears is as large as the torques and was not measured, and
least squares on filtered accelerations shrinks every parameter to a half or a third.

The recording is from a laboratory robot (Wiebe et al., IEEE Robotics & Automation Magazine 2023,
BSD-3-Clause). The first angle is measured from hanging, the second relative to the first link.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import leastaction as la

here = Path(__file__).parent if "__file__" in globals() else Path()  # the gallery runs it in its folder
path = here / "data" / "driven_double_pendulum.csv.gz"
forces = {"q1": "tau1", "q2": "tau2"}
data = la.read_csv(path, coordinates=["q1", "q2"], time="t", forces=forces, trial="trial")

held_out = data.select(["3", "12"])
fitted = data.select([name for name in data.names if name not in held_out.names])
print(fitted)

# %%
# The candidates are the terms that two planar links can have, and some that they cannot have. Dry friction is
# ``abs`` of a joint's velocity. The torques are known, so L is in joules, and no coefficient has to be given.

candidates = [
    *(f"q1_dot**2{g}" for g in ("", "*cos(q2)", "*sin(q2)", "*cos(q2)**2")),
    *(f"q1_dot*q2_dot{g}" for g in ("", "*cos(q2)", "*sin(q2)")),
    *(f"q2_dot**2{g}" for g in ("", "*cos(q2)")),
    *("cos(q1)", "sin(q1)", "cos(q2)", "sin(q2)", "cos(q1+q2)", "sin(q1+q2)", "cos(q1)**2"),
]
friction = ["q1_dot**2/2", "q2_dot**2/2", "abs(q1_dot)", "abs(q2_dot)"]
model = la.discover(fitted, la.Library(candidates, ["q1", "q2"]), dissipation=friction)
print(model.format_table())

# %%
# The result has seven terms of L and dry friction in both joints, as the model that the builders of the robot
# derived. Their coefficients, in the same order, are 0.0673, 0.0333, 0.0235, 0.0333, 0.0134, 3.42 and 1.09,
# with dry friction of 0.146 and 0.123 N m.
#
# The fit averages the noise of the measured torques (see "Machines" on the page about the method). Otherwise
# all coefficients would be two per cent too large.
#
# The result is usable, not ok: some per cent of the torques remain unexplained, because belts stretch, gears
# stick, and currents are not torques. But simulations follow the data. In such a case, the coefficients are
# those with the smallest simulation error along the fitted trials, and their intervals allow for what remains
# unexplained.

print(model.fit.status)
for statement, words in model.fit.statements.items():
    print(f"{statement}: {words}")
for warning in model.fit.warnings:
    print("-", warning)

# %%
# What counts is the forecast. We simulate both models for 0.4 s along the trials that were held out, driven
# by the measured torques.

published = la.LagrangianModel.from_dict(
    {
        **model.to_dict(),
        "covariance": [],
        "terms": [
            {"expression": e, "coefficient": c, "standard_error": 0.0, "known": True}
            for e, c in {
                "q1_dot**2": 0.0673,
                "q1_dot**2*cos(q2)": 0.0333,
                "q1_dot*q2_dot": 0.0235,
                "q1_dot*q2_dot*cos(q2)": 0.0333,
                "q2_dot**2": 0.01335,
                "cos(q1)": 3.4248,
                "cos(q1+q2)": 1.0895,
            }.items()
        ],
        "dissipation": [
            {"expression": e, "coefficient": c, "standard_error": 0.0, "known": True}
            for e, c in {"sqrt(q1_dot**2 + 1/2500)": 0.146, "sqrt(q2_dot**2 + 9/2500)": 0.1225}.items()
        ],
    }
)
ours = model.validate(held_out, horizon=0.4, window=0.04)
theirs = published.validate(held_out, horizon=0.4, window=0.04)
print("rms error of forecasts over 0.4 s (rad)")
print("found:    ", ours.rms.round(3))
print("published:", theirs.rms.round(3))

# %%
# The second joint over the first seconds of one trial. Every coloured piece is a forecast that starts from
# the measured state and does not use the data afterwards.

figure, axis = plt.subplots(figsize=(8, 3.5))
measured = held_out.select("3")[0]
first = measured.t < 4.0
axis.plot(measured.t[first], measured.q[first, 1], color="0.6", linewidth=4, label="measured")
runs = [trace for trace in ours.traces if trace.trial == "3" and trace.origin < 3.6]
for number, trace in enumerate(runs):
    axis.plot(
        trace.t, trace.forecast[:, 1], color="C0", label="found, forecasts of 0.4 s" if number == 0 else None
    )
axis.set_xlabel("time (s)")
axis.set_ylabel("angle of the second joint (rad)")
axis.set_title("Forecasts of a held-out trial from its torques")
axis.legend(frameon=False)
figure.tight_layout()
plt.show()

# %%
# **What to learn.** Offer friction from the start, hold out some trials, and trust forecasts more than small
# residuals. If vibrations of the machine make fine splines misleading, the search notices that finer knots
# make the equations worse, and starts again on the coarsest grid that resolves the motion.
