"""
The Silverbox benchmark
=======================

An electronic circuit behaves as a mass on a spring that hardens. Its input contains all frequencies up to
200 Hz, its resonance is at 68 Hz, and the sampling rate is 610 Hz, nine samples a period. Numerical
derivatives fail at such a rate. We find the law from a third of the recording. Then we simulate the rest from
its input alone.

The recording is a benchmark of nonlinear system identification (Wigren and Schoukens, 2013; MIT licence).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import leastaction as la

here = Path(__file__).parent if "__file__" in globals() else Path()  # the gallery runs it in its folder
data = la.read_csv(here / "data" / "silverbox.csv.gz", coordinates=["y"], time="t", forces={"y": "u"})
fitted, held_out = data.hold_out("67%")
print(fitted)
print(held_out)

# %%
# The candidates are a constant mass, a polynomial potential, and viscous and dry friction. The force is
# known, so no coefficient has to be given. Input and output are voltages: the unit of the mass is s², and the
# stiffness has no unit.

library = la.Library(["y_dot**2", *(f"y**{power}" for power in range(1, 7))], ["y"])
model = la.discover(fitted, library, dissipation=["y_dot**2/2", "abs(y_dot)"])
print(model.format_table())

# %%
# The circuit was built as a mass, a damper, a spring and a cubic spring: ``y_dot**2``, ``y_dot**2/2``,
# ``y**2`` and ``y**4``. It also has a small offset (``y``) and a small asymmetry (``y**3``). The powers five
# and six and dry friction were not needed.
#
# With so few samples a period, it matters how the force changes between them. The program compares constant,
# linear and band-limited forces. The notes name the choice:

for note in model.diagnostics.notes:
    print("-", note)

# %%
# Small motions about rest, with standard errors. Because of its offset, the circuit rests at some −5 mV.

for rest in model.equilibria():
    mode = model.linearise(rest.q).modes[0]
    print(f"{rest.stability} at {rest.q[0]:.4f} V: {mode.frequency} Hz, damping ratio {mode.damping_ratio}")

# %%
# Now the simulation of 16 s that the fit has not seen, about 1100 periods. The first 0.4 s of output
# determine the initial state. After that, only the input is used.

forecast = model.validate(held_out, horizon=held_out.duration - 0.5, window=0.4)
trace = forecast.traces[0]
print(f"rms error {1e3 * forecast.rms[0]:.2f} mV in {trace.t[-1] - trace.t[0]:.1f} s")

# %%
# The spectra of the output and of the error. The error is below one per cent of the output at the resonance.

window = np.hanning(trace.t.size)
frequency = np.fft.rfftfreq(trace.t.size, np.median(np.diff(trace.t)))


def spectrum(signal: np.ndarray) -> np.ndarray:
    """Amplitudes in dB, averaged over 40 neighbouring frequencies."""
    power = np.abs(np.fft.rfft(window * signal)) ** 2
    return 10 * np.log10(np.convolve(power, np.full(40, 1 / 40), mode="same"))


figure, axis = plt.subplots(figsize=(8, 3.8), layout="constrained")
axis.plot(frequency, spectrum(trace.measured[:, 0]), label="measured output")
axis.plot(frequency, spectrum(trace.forecast[:, 0] - trace.measured[:, 0]), label="error of the simulation")
axis.set_xlabel("frequency (Hz)")
axis.set_ylabel("amplitude (dB)")
axis.set_title("16 s simulated from the input alone")
axis.legend(frameon=False)
plt.show()

# %%
# **What to learn.** Broadband forces need neither a filter nor faster sampling. Judge a law by a simulation
# from the input alone. Predictions of the next sample would look good for a wrong law, too.

assert forecast.rms[0] < 0.45e-3
