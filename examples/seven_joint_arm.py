"""
Seven joints from a torque log
==============================

Manufacturers publish the geometry of their robot arms, but rarely masses, inertias and friction. A log of
joint angles and torques contains this information. With the geometry known, the equations are linear in ten
parameters per link, and no terms of L are searched. `leastaction.arms` fits the curve, the parameters and the
friction together.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la
from leastaction import arms

# %%
# The geometry is a Denavit–Hartenberg table (here in Craig's modified convention) or a URDF, read by
# ``arms.read_urdf("robot.urdf")``.

quarter = np.pi / 2
tree = arms.KinematicTree.from_dh(
    [
        {"d": 0.34},
        {"alpha": -quarter},
        {"alpha": quarter, "d": 0.4},
        {"alpha": quarter},
        {"alpha": -quarter, "d": 0.4},
        {"alpha": -quarter},
        {"alpha": quarter, "d": 0.126},
    ],
    modified=True,
)

# %%
# The simulated arm has ellipsoidal links, lighter towards the hand, rotors, and friction. After a reversal,
# dry friction changes sign over 2 mrad, because gears deform before they slide. The fourth joint has no
# viscous friction, and the last one no dry friction.

rng = np.random.default_rng(7)


def ellipsoid(mass):
    """Draw the ten inertial parameters of a link about the origin of its joint."""
    centre, size = rng.normal(0.0, 0.05, 3), rng.uniform(0.04, 0.1, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    second = mass * (turn @ np.diag(size**2) @ turn.T + np.outer(centre, centre))
    inertia = np.trace(second) * np.eye(3) - second
    return [mass, *(mass * centre), *inertia[np.triu_indices(3)]]


links = np.array([ellipsoid(4.0 * 0.72**k) for k in range(7)])
size = np.array([1.0, 1.0, 0.6, 0.6, 0.3, 0.2, 0.15])
true = arms.ArmModel.of_tree(
    tree.with_inertias(links),
    {
        "rotor": 0.3 * size**2,
        "viscous": 0.5 * size * [1, 1, 1, 0, 1, 1, 1],
        "dry": 0.8 * size * [1, 1, 1, 1, 1, 1, 0],
    },
    distance=2e-3,
)

# %%
# A log of 16 s at 500 Hz: sums of sines, encoder steps of 24 µrad, and torques with 2 % noise.


def log(duration):
    """Simulate a log."""
    t = np.arange(0.0, duration, 0.002)
    q, qdot, qddot = np.zeros((3, t.size, 7))
    for k in range(1, 9):
        w = 2.0 * np.pi * 0.12 * k
        a, b = rng.normal(0.0, 0.5 / np.sqrt(k) / (1.0 + 0.15 * k), (2, 7))
        sine, cosine = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
        q += a * sine + b * cosine
        qdot += w * (a * cosine - b * sine)
        qddot -= w**2 * (a * sine + b * cosine)
    torques = true.torques(q, qdot, qddot, successive=True)
    torques += 0.02 * torques.std(axis=0) * rng.normal(size=torques.shape)
    step = 2.0 * np.pi / 2**18
    return la.Trajectory(t, step * np.rint(q / step), torques, tree.coordinates)


model = arms.identify(log(16.0), tree)
print(model)

# %%
# Each row is a combination of parameters that the torques determine. The masses of single links are not among
# them: they act on the joints only as parts of larger moments. ``bodies()`` returns physically consistent
# masses, centres and inertias that agree with the table; ``to_urdf`` writes them to a URDF.

solid = model.bodies()
print(solid.facts.notes[-1])
print("masses:", solid.tree.inertias[:, 0].round(2))

q = rng.uniform(-2.0, 2.0, (200, 7))
for name in ("mass_matrix", "gravity"):
    ours, theirs = getattr(solid, name)(q), getattr(true, name)(q)
    print(f"{name}: off by {np.linalg.norm(ours - theirs) / np.linalg.norm(theirs):.2%}")

# %%
# The decisive test is prediction: the torques of another log, from its angles alone.

other = log(6.0)
print(solid.validate(other))

motion = la.smooth(other)[0]
predicted = solid.torques(motion.q, motion.qdot, motion.qddot, successive=True)

figure, axes = plt.subplots(2, 4, figsize=(12, 5), layout="constrained")
for i, axis in enumerate(axes.ravel()[:7]):
    axis.plot(other.t, other.forces[:, i], color="0.75", lw=1.5, label="measured")
    axis.plot(other.t, predicted[:, i], lw=0.8, label="predicted")
    axis.set(title=tree.coordinates[i], xlabel="t (s)", ylabel="torque (N m)")
known = dict(zip([term.text for term in true.terms], true.coefficients, strict=True))
scores = [
    (value - known.get(term.text, 0.0)) / error  # there are no offsets
    for term, value, error in zip(model.terms, model.coefficients, model.standard_errors, strict=True)
]
last = axes.ravel()[7]
last.hist(scores, bins=np.arange(-4.0, 4.1, 0.5), color="0.6")
last.set(title="parameters", xlabel="error / standard error")
axes[0, 0].legend()
plt.show()

# %%
# Your own log is read from a file. Columns are recognised by the names that ROS, libfranka and the RTDE of
# Universal Robots give them, also in bags of ROS 2. Here the simulated log passes for a table of libfranka.

with TemporaryDirectory() as folder:
    path = Path(folder) / "log.csv"
    quantities = {"q": other.q, "tau_J": other.forces}
    names = [f"state.{key}[{i}]" for key in quantities for i in range(7)]
    rows = np.hstack([other.t[:, None], *quantities.values()])
    np.savetxt(path, rows, delimiter=",", header=",".join(["time", *names]), comments="")
    print(arms.log_columns(path, tree))
    print(solid.validate(arms.read_log(path, tree)))

# %%
# **What to learn.** With the geometry known, a log of some seconds predicts the torques of other motions to
# within the noise of the sensors. Trust the combinations in the table and their standard errors. Trust single
# masses only if the table lists them alone. Absent friction is not selected, and the errors of the parameters
# have the size of their standard errors.
