"""Numbers of docs/choose.md, examples of docs/limits.md, the picture of README.md, figures of docs/method.md.

python benchmarks/pages.py choose limits picture method
PYTHONPATH=tests python benchmarks/pages.py app    # the screens of docs/app.md
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.model.notation import rounded
from leastaction.model.term import ModelTerm
from leastaction.report.axes import Axes
from leastaction.report.figures_model import path_axes
from leastaction.report.series import Series
from leastaction.report.svg import Colour, path, stroke, text
from leastaction.simulation.forecast import ForecastResult

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs/_static/pendulum.svg"
FIGURES = {name: ROOT / f"docs/_static/method-{name}.svg" for name in ("fit", "selection")}

DOUBLE = systems.get("double_pendulum")
LIBRARY = la.Library.mechanical(DOUBLE.coordinates, angles=DOUBLE.angles)


def row(label: str, *, degree: int = 5, **recording) -> None:
    data = systems.generate(DOUBLE, seed=1, **recording)
    model = la.discover(data, LIBRARY, degree=degree)
    found = {term.expression: term.coefficient for term in model.terms}
    exact = la.metrics.exact_support(found, DOUBLE.lagrangian)
    if exact:
        error = max(100 * term.standard_error / abs(term.coefficient) for term in model.terms)
        print(f"| {label} | {model.fit.status} | {error:.2f} % |")
    else:
        print(f"| {label} | {model.fit.status} | wrong terms |")


def choose() -> None:
    """Sampling rate, length, number of runs, degree."""
    for rate in (5.0, 10.0, 20.0, 50.0, 100.0, 200.0):
        row(f"{rate:g} Hz", noise=0.05, trials=3, duration=10.0, rate=rate)
    for duration in (2.0, 5.0, 10.0, 20.0):
        row(f"1 × {duration:g} s", noise=0.05, trials=1, duration=duration)
    for trials in (2, 4, 8):
        row(f"{trials} × 2.5 s", noise=0.05, trials=trials, duration=2.5)
    for degree in (3, 4, 5, 7):
        row(f"degree {degree}", degree=degree, noise=0.01, trials=3, duration=10.0)


def show(title: str, model: la.LagrangianModel) -> None:
    terms = ", ".join(term.expression for term in (*model.terms, *model.dissipation))
    print(f"{title}: {model.fit.status}\n    {terms}")
    for sentence in (*model.fit.warnings, *(model.diagnostics.notes if model.diagnostics else ())):
        print(f"    - {sentence}")


def changed(data: la.Trajectories, q=lambda q: q, forces=lambda f: f) -> la.Trajectories:
    """The same recordings with other columns."""
    pushed = [None if t.forces is None else forces(t.forces) for t in data]
    return la.Trajectories(
        [la.Trajectory(t.t, q(t.q), f, t.coordinates) for t, f in zip(data, pushed, strict=True)]
    )


def limits() -> None:
    """Set-ups that are wrong on purpose, and what comes back."""
    data = systems.generate(DOUBLE, noise=0.05, trials=3, duration=10.0, seed=3)
    show("coupling term missing", la.discover(data, [t for t in DOUBLE.library if "theta1-theta2" not in t]))
    show("sign of the torques wrong", la.discover(changed(data, forces=np.negative), DOUBLE.library))
    show("angles swapped", la.discover(changed(data, q=lambda q: q[:, ::-1]), DOUBLE.library))

    for strength in (0.4, 0.04):
        friction = {"x_dot**2/2": strength, "theta_dot**2/2": strength / 4}
        cart = systems.get("cart_spring_pendulum").with_dissipation(friction)
        data = systems.generate(cart, noise=0.02, trials=3, duration=10.0, seed=3)
        show(f"friction {strength} not modelled", la.discover(data, cart.library, known=cart.known))
        candidates = [*friction, "abs(x_dot)"]
        show(f"friction {strength} modelled", la.discover(data, cart.library, cart.known, candidates))

    t = np.arange(0.0, 10.0, 0.01)
    noise = 0.002 * np.random.default_rng(0).standard_normal(t.size)
    small = la.Trajectory(t, 0.02 * np.cos(3.13 * t) + noise, coordinates=["theta"])
    library = ["theta_dot**2", "cos(theta)", "cos(theta)**2", "theta_dot**2*cos(theta)"]
    show("swing of 0.02 rad", la.discover(small, library, known={"theta_dot**2": 0.5}))


# ------------------------------------------------------------ the picture: what the example of README.md does
# The colours of report/style.css on light paper. A picture in a README cannot know whether the page about it
# is dark, so it brings its own ground.
STYLE = """svg{--paper:#fcfcfa;--ink:#1d2125;--muted:#59616a;--grid:#dfe1de;--measured:#878d95;--fit:#0a5c9e;
--forecast:#cc5200;--shade:#e1eaf3;font:13px system-ui,-apple-system,"Segoe UI",Roboto,
"Liberation Sans",Arial,sans-serif}
.tick{font-size:12px;fill:var(--muted)}.label,.row{fill:var(--ink)}
.head{font-size:15px;font-weight:600;fill:var(--ink)}
.law{font-size:17px;fill:var(--fit)}"""
WIDTH, HEIGHT = 700.0, 460.0
EVERY = 4  # of the samples one is drawn
# Of a pendulum with mass m and length l in the field g, and friction −c dθ/dt: reading, unit, true value.
READINGS = {
    "theta_dot**2": ("½ m l²", "kg m²", 0.5),
    "cos(theta)": ("m g l", "N m", 9.81),
    "theta_dot**2/2": ("friction c", "N m s", 0.2),
}


def example() -> tuple[str, str]:
    """The Python block of README.md, and the text block after it, which is what it prints."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"^```python\n(.*?)^```\n+.*?^```text\n(.*?)^```", page, re.M | re.S)
    assert found is not None
    return found[1], found[2]


def picture() -> None:
    """Run the example of README.md and draw what it has found."""
    names: dict = {}
    exec(compile(example()[0], "README.md", "exec"), names)
    PICTURE.write_text(draw(names["runs"], names["model"], names["forecast"]), encoding="utf-8")
    print(f"{PICTURE}: {PICTURE.stat().st_size} bytes")


def draw(runs: la.Trajectories, model: la.LagrangianModel, forecast: ForecastResult) -> str:
    """Three panels: the first run with its fitted curve, the law, the forecast of the last run."""
    series, fitted, new = Series(model), runs[0], runs[-1]
    trace = forecast.traces[0]
    recorded, ahead = Axes((424.0, 196.0)), Axes((676.0, 188.0))
    recorded.dots(fitted.t[::EVERY], fitted.q[::EVERY, 0], "measured", 3.4)
    fine = np.linspace(fitted.t[0], fitted.t[-1], 601)
    recorded.line(fine, series.curve_of(0, fine)[:, 0], "fit", 1.8)
    ahead.band(x=(float(new.t[0]), trace.origin))
    ahead.dots(new.t[::EVERY], new.q[::EVERY, 0], "measured", 3.4)
    ahead.line(trace.t, trace.forecast[:, 0], "forecast", 2.0)
    for axes, run in ((recorded, fitted), (ahead, new)):
        axes.limit(x=(float(run.t[0]), float(run.t[-1])))
        axes.label("t (s)", "angle θ", y_unit="rad")
    panels = [
        (12, 34, recorded.svg("a", "A recording", "Noisy samples of an angle, and the curve fitted to them")),
        (12, 266, ahead.svg("b", "A forecast", "It follows the samples of a recording that was not fitted")),
    ]
    body = "".join(
        str(panel).replace(
            "<svg ", f'<svg x="{x}" y="{y}" width="{axes.width:g}" height="{axes.height:g}" ', 1
        )
        for (x, y, panel), axes in zip(panels, (recorded, ahead), strict=True)
    )
    errors = f"rms error {forecast.rms[0]:.3f} rad, noise {model.noise_std[0]:.3f} rad"
    words = (
        text("1  Noisy measurements (simulated pendulum)", 14, 25, "head")
        + text("dots: measured, line: fitted", 424, 49, "tick", "end")
        + text("2  The law found", 450, 25, "head")
        + text("3  A forecast of a recording that was not used", 14, 256, "head")
        + text(f"from the shaded half second and the known torque; {errors}", 676, 281, "tick", "end")
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" width="{WIDTH:g}" '
        f'height="{HEIGHT:g}" role="img">\n'
        f"<!-- python benchmarks/pages.py picture: runs the example of README.md -->\n"
        f"<style>{STYLE}</style>\n"
        f'<rect x="0.5" y="0.5" width="{WIDTH - 1:g}" height="{HEIGHT - 1:g}" rx="8" fill="var(--paper)" '
        f'stroke="var(--grid)"/>\n{body}\n{words}\n{draw_law(model)}\n</svg>\n'
    )


def measured(term: ModelTerm) -> str:
    """A coefficient and its standard error."""
    error = rounded(term.standard_error, digits=2)
    return f"{rounded(term.coefficient, term.standard_error)} ± {error}"


def draw_law(model: la.LagrangianModel) -> str:
    """The formulas, and a whisker for each coefficient on one axis of deviations from the true value."""
    left, right, zero, per_cent = 450.0, 688.0, 569.0, 32.0
    found = {term.expression: term for term in (*model.terms, *model.dissipation)}
    value = {name: rounded(t.coefficient, t.standard_error) for name, t in found.items()}
    parts = [
        text(f"L = {value['theta_dot**2']} θ̇² + {value['cos(theta)']} cos θ", left, 54, "law"),
        text(f"friction torque −{value['theta_dot**2/2']} θ̇", left, 78, "law"),
        path(f"M{zero:g} 94V202", stroke("muted", 1.0, dashes="4 3")),
    ]
    for k, (name, (reading, unit, true)) in enumerate(READINGS.items()):
        y, term = 108.0 + 36.0 * k, found[name]
        low, at, high = (
            zero + per_cent * 100 * (bound / true - 1) for bound in (term.lower, term.coefficient, term.upper)
        )
        parts += [
            f'<rect x="{left:g}" y="{y - 14:g}" width="{right - left:g}" height="18" fill="var(--paper)"/>',
            text(reading, left, y, "row"),
            text(f"{measured(term)} {unit}", right, y, "row", "end"),
            path(f"M{low:.1f} {y + 12:g}H{high:.1f}", stroke("fit", 2.5)),
            f'<circle cx="{at:.1f}" cy="{y + 12:g}" r="4.5" fill="var(--fit)"/>',
        ]
    ticks = ((-3, "−3 %"), (0, "true value"), (3, "+3 %"))
    parts += [text(words, zero + per_cent * x, 216, "tick", "middle") for x, words in ticks]
    parts.append(text("bars: 95 % intervals", zero, 233, "tick", "middle"))
    return "".join(parts)


# ------------------------------------------------------------------------------ the figures of docs/method.md
def method() -> None:
    """Draw both figures, and print the numbers that their captions state."""
    for name, (axes, key, said) in {"fit": draw_fit(), "selection": draw_selection()}.items():
        body = str(axes.svg(name, said, said)).replace(
            "<svg ", f'<svg x="10" y="42" width="{axes.width:g}" height="{axes.height:g}" ', 1
        )
        width, height = axes.width + 20, axes.height + 52
        words = "".join(
            path(f"M{x:g} 21h22", stroke(colour, 3.0)) + text(label, x + 28, 26, "row")
            for x, colour, label in key
        )
        FIGURES[name].write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
            f'height="{height:g}" role="img">\n<!-- python benchmarks/pages.py method -->\n'
            f'<style>{STYLE}</style>\n<rect x="0.5" y="0.5" width="{width - 1:g}" height="{height - 1:g}" '
            f'rx="8" fill="var(--paper)" stroke="var(--grid)"/>\n{words}{body}</svg>\n',
            encoding="utf-8",
        )
        print(f"{FIGURES[name]}: {FIGURES[name].stat().st_size} bytes; {said}")


Drawn = tuple[Axes, list[tuple[float, Colour, str]], str]


def draw_fit() -> Drawn:
    """The acceleration from a smoothing spline, from the joint fit, and the truth."""
    recording = dict(trials=2, duration=20.0, rate=20.0, seed=1)
    pendulum = systems.get("single_pendulum")
    data = systems.generate(pendulum, noise=0.1, **recording)
    truth = systems.simulate_truth(pendulum, **recording)[0]
    model = la.discover(data, systems.compact_library("single_pendulum"))
    assert model.diagnostics is not None
    t = truth.t
    curves = {
        "truth": truth.qddot[:, 0],
        "smoothed": la.smooth(data)[0].qddot[:, 0],
        "joint": model.diagnostics.curve(nu=2)[0][:, 0],
    }
    spread = curves["truth"].std()
    off = {name: 100 * np.sqrt(np.mean((y - curves["truth"]) ** 2)) / spread for name, y in curves.items()}
    axes = Axes((660.0, 260.0))
    axes.line(t, curves["truth"], "measured", 5.0)
    axes.line(t, curves["smoothed"], "forecast", 1.8)
    axes.line(t, curves["joint"], "fit", 1.8)
    shown = t <= 8.0
    reach = 1.35 * float(np.abs(curves["truth"][shown]).max())
    axes.limit(x=(0.0, 8.0), y=(-reach, reach))
    axes.label("t (s)", "angular acceleration", y_unit="rad/s²")
    key: list[tuple[float, Colour, str]] = [
        (16.0, "measured", "truth"),
        (110.0, "forecast", f"smoothing spline (rms error {off['smoothed']:.0f} %)"),
        (400.0, "fit", f"joint fit (rms error {off['joint']:.1f} %)"),
    ]
    said = f"error {off['smoothed']:.1f} % with a smoothing spline, {off['joint']:.1f} % jointly"
    return axes, key, said


def draw_selection() -> Drawn:
    """BIC of the best structure of each size, and of other structures of the chosen size."""
    model = la.discover(systems.generate(DOUBLE, noise=0.05, trials=3, duration=10.0, seed=1), LIBRARY)
    assert model.diagnostics is not None
    best, others = {}, []
    for point in model.diagnostics.path:
        if point.n_terms in best:
            others.append(point)
        best.setdefault(point.n_terms, point)
    axes = path_axes((660.0, 300.0))
    sizes, bic = np.array(list(best)), np.array([point.bic for point in best.values()])
    axes.line(sizes, bic, "fit", 1.5)
    axes.dots(sizes, bic, "fit", 7.0)
    axes.dots(np.array([p.n_terms for p in others]), np.array([p.bic for p in others]), "measured", 8.0)
    chosen = np.array([point.chosen for point in best.values()])
    axes.dots(sizes[chosen], bic[chosen], "forecast", 12.0, above=True)
    axes.limit(x=(sizes[0] - 0.5, sizes[-1] + 0.5))
    axes.label("number of free terms", "ΔBIC from the chosen structure")
    key: list[tuple[float, Colour, str]] = [
        (16.0, "forecast", "chosen"),
        (120.0, "fit", "best structure of each size"),
        (340.0, "measured", "other structures of the chosen size"),
    ]
    said = (
        f"ΔBIC {bic[1]:.0f} with one more term, {min(p.bic for p in others):.0f} for the next structure of "
        f"the same size, of {len(LIBRARY)} candidates"
    )
    return axes, key, said


# --------------------------------------------------------------------------------- the screens of docs/app.md
SCREENS = {name: ROOT / f"docs/_static/app-{name}.png" for name in ("data", "candidates", "result")}


def app() -> None:
    """Photograph the app on the measured double pendulum; needs the extra ``test`` and Chromium."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    import page_helpers  # of tests/

    def shoot(page, name: str, text: str) -> None:
        page.get_by_text(text).first.wait_for(timeout=600_000)
        page.wait_for_timeout(1500)
        page.evaluate("window.scrollTo(0, 0)")
        page.screenshot(path=SCREENS[name])
        with Image.open(SCREENS[name]) as image:
            image.convert("RGB").quantize(128).save(SCREENS[name], optimize=True)
        print(f"{SCREENS[name]}: {SCREENS[name].stat().st_size} bytes")

    with (
        TemporaryDirectory() as folder,
        page_helpers.running_app(Path(folder)) as address,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 820})
        page.goto(address)
        page.get_by_role("button", name="Double pendulum").first.click()
        shoot(page, "data", "What was measured")
        page.get_by_role("button", name="Continue to the candidates").first.click()
        shoot(page, "candidates", "Which terms may the Lagrangian contain?")
        page.get_by_role("button", name="Find the Lagrangian").first.click()
        shoot(page, "result", "How many terms?")
        browser.close()


if __name__ == "__main__":
    for name in sys.argv[1:] or ("choose", "limits"):
        {"choose": choose, "limits": limits, "picture": picture, "method": method, "app": app}[name]()
