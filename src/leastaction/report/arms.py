"""The report on an identified arm: content of its template."""

from __future__ import annotations

import re
from importlib.metadata import version
from itertools import groupby
from typing import Any

import numpy as np

from leastaction.arms.base import BALL, TREE_SHARE
from leastaction.arms.compare import TorqueErrors
from leastaction.arms.model import ArmModel
from leastaction.data.trajectories import Trajectories
from leastaction.library.tree import INERTIAL
from leastaction.mechanics.arm_terms import EXTRA, FRICTION
from leastaction.model.mathml import number_parts
from leastaction.model.notation import interval_text
from leastaction.model.term import ModelTerm
from leastaction.report.figures_arm import FROM_LOG, ArmFigures
from leastaction.report.figures_model import whisker, whisker_axis
from leastaction.report.page import rendered
from leastaction.report.text import listed, percent, plain, plural, typeset

__all__ = ["render_arm"]

_POSITIVE = ("rotor", "viscous", "dry")
_FACTOR = re.compile(r"(?<=\d)\*(?=\w+\[)")  # of a parameter in a combination
_CLEARLY = 3.0  # standard errors below zero of what cannot be negative
_LARGE = 0.5  # of the torque, at which an error is large
_WORSE = 2.0  # times the error of the fitted log, above which a larger one of the held-out log is stated


def render_arm(model: ArmModel, log: Trajectories, held_out: Trajectories | None, command: str | None) -> str:
    """Return the page as text."""
    solid = model.bodies()
    held = () if held_out is None else solid.predict(held_out)
    figures = ArmFigures(model, solid, solid.predict(log), held)
    fitted_errors, held_errors = figures.errors
    context = {
        "name": "" if model.tree.name == "arm" else model.tree.name,
        "figures": figures,
        "parts": [colour for _, colour in figures.shown],
        "shown": f"Shown: {name}. " if (name := figures.shown[0][0].name) else "",
        "n_measured": len(figures.names) - len(model.facts.unmeasured),
        "headline": _headline(fitted_errors, held_errors),
        "statements": _statements(figures),
        "notes": [note.replace("chi-squared", "χ²") for note in solid.facts.notes],
        "facts": _facts(figures, log, held_out),
        "torque_title": _torque_title(figures),
        "spectrum_title": _spectrum_title(figures),
        "errors": _error_rows(figures),
        "friction": _friction_rows(figures),
        "links": _link_rows(figures),
        "groups": _base_groups(figures),
        "parameters": _parameter_rows(figures),
        "inertial": INERTIAL,
        "logs": [word for word, errors in (("fitted", fitted_errors), ("held out", held_errors)) if errors],
        **_words(figures),
        "joints": _joint_rows(figures),
        "whisker_axis": whisker_axis(),
        "command": command or "leastaction.arms.identify(log, tree)",
        "version": version("leastaction"),
    }
    return rendered("arm.html.j2", context)


def _words(figures: ArmFigures) -> dict[str, Any]:
    """Headings and notes that depend on what is known."""
    facts, kinds = figures.model.facts, {term.kind for term in figures.model.terms}
    joint_head = [("joint", ""), ("range", "n"), ("highest speed", "n"), ("noise", "n")]
    joint_head += [("equation error", "n")]
    joint_head += [("gain", "n")] if facts.gains else []
    joint_head += [("delay of the torque", "n")] if facts.delays else []
    friction_note = "Dots between the branches are reversals, where dry friction changes sign gradually."
    if "load" in kinds:
        friction_note += " Friction that grows with the load is drawn for the middle of the motion."
    bare = np.isnan(figures.model.tree.inertias).any(axis=1)
    prior = f"the tree, uncertain by {percent(TREE_SHARE)} of mass and size"
    if bare.any():
        ball = f"a ball of {BALL}, uncertain by 100 %"
        prior = ball if bare.all() else f"{prior}, or {ball} where it states none"
    return {
        "prior": prior,
        "joint_head": joint_head,
        "friction_title": _friction_title(figures),
        "friction_note": friction_note if "dry" in kinds else "",
    }


def _friction_title(figures: ArmFigures) -> str:
    """Largest share of friction in the torque of a joint."""
    terms = zip(figures.model.terms, figures.model.coefficients.tolist(), strict=True)
    dry = {term.place: abs(value) for term, value in terms if term.kind == "dry"}
    run = figures.shown[0][0]
    sizes = np.sqrt(np.mean(run.measured**2, axis=0))
    shares = {figures.names[i]: value / float(sizes[i]) for i, value in dry.items()}
    if not shares:
        return "No dry friction is significant"
    worst = max(shares, key=lambda name: shares[name])
    return f"Dry friction is at most {percent(shares[worst])} of the rms torque, in {worst}"


def _headline(fitted: TorqueErrors | None, held: TorqueErrors | None) -> str:
    errors = held or fitted
    if errors is None:
        return "Base parameters of the arm"
    verb = "The model predicts held-out torques" if held else "The model explains the fitted torques"
    return f"{verb} to {percent(float(errors.overall[1]))} below 10 Hz"


def _statements(figures: ArmFigures) -> list[tuple[str, str]]:
    """What the page shows, one sentence each."""
    model, (fitted, held) = figures.model, figures.errors
    out: list[tuple[str, str]] = []
    for name, errors in (("Held-out torques", held), ("Fitted torques", fitted)):
        if errors is not None:
            shares = [percent(share) for share in errors.overall.tolist()]
            worst = int(np.nanargmax(errors.by_joint[0]))
            text = f"off by {shares[0]} of their rms below 5 Hz, {shares[-1]} at all frequencies; "
            far = percent(float(errors.by_joint[0, worst]))
            out.append((name, f"{text}most in {figures.names[worst]}, by {far} below 5 Hz"))
    if held is not None and fitted is not None and held.overall[1] > _WORSE * fitted.overall[1]:
        ratio = plain(float(held.overall[1] / fitted.overall[1]), 2)
        text = f"held-out errors are {ratio} times those of the fitted log; fit a longer log, or one with "
        out.append(("Prediction", f"{text}the speeds and postures that you need"))
    kinds = {kind: [t.place for t in model.terms if t.kind == kind] for kind in FRICTION}
    n = len(figures.names)
    added = [model.tree.extra[t.place].text for t in model.terms if t.kind == "loss"]
    found = [f"{kind} in {_which(at, figures.names)}" for kind, at in kinds.items() if at]
    found += [f"added: {listed(added)}"] if added else []
    out.append(("Friction", "; ".join(found) or f"none in {plural(n, 'joint', 'joints')}"))
    z = np.abs(model.coefficients) < 1.96 * model.standard_errors
    text = f"{len(z)} are determined; the 95 % intervals of {int(z.sum())} include zero"
    out.append(("Base parameters", text))
    loose = [str(k + 1) for k, share in enumerate(figures.from_log[:, 0]) if share < FROM_LOG]
    if loose:
        what = "the masses of links {} come" if len(loose) > 1 else "the mass of link {} comes"
        out.append(("Prior", f"{what.format(listed(loose))} mostly from the prior, not from the log"))
    return out + _doubts(model)


def _doubts(model: ArmModel) -> list[tuple[str, str]]:
    """Signs of an effect that the model lacks."""
    out: list[tuple[str, str]] = []
    given = zip(model.terms, model.coefficients.tolist(), model.standard_errors.tolist(), strict=True)
    wrong = [t.text for t, value, error in given if t.kind in _POSITIVE and value < -_CLEARLY * error]
    if wrong:
        text = f"{listed(wrong)}: negative by more than three standard errors; an effect is missing in the "
        out.append(("Not physical", f"{text}model, or the tree is wrong"))
    price, n = model.consistent.price, len(model.coefficients)
    if price > _WORSE * n:
        text = (
            f"if links must be able to exist, χ² rises by {plain(price)}, far more than the {n} parameters; "
        )
        out.append(("Consistency", f"{text}the standard errors are too small"))
    return out


def _which(places: list[int], names: tuple[str, ...]) -> str:
    return "all joints" if len(places) == len(names) > 1 else listed([names[k] for k in places])


def _facts(figures: ArmFigures, log: Trajectories, held_out: Trajectories | None) -> list[dict[str, str]]:
    def said(data: Trajectories) -> str:
        return f"{plain(sum(run.duration for run in data))} s"

    n = len(figures.names)
    samples = plural(sum(run.t.size for run in figures.fitted), "sample", "samples")
    rows = [
        ("joints", str(n), listed(figures.names)),
        ("fitted", said(log), f"{samples} in {plural(len(log), 'run', 'runs')}"),
        ("held out", "none" if held_out is None else said(held_out), ""),
        ("base parameters", str(len(figures.model.coefficients)), "combinations that act on the torques"),
        (
            "knots",
            f"{plain(figures.model.facts.knots_per_second)} per second",
            "of the fitted curve",
        ),
    ]
    return [dict(zip(("name", "value", "note"), row, strict=True)) for row in rows]


def _torque_title(figures: ArmFigures) -> str:
    errors = figures.errors[1] or figures.errors[0]
    if errors is None:
        return "Torques, measured and predicted"
    shares, what = errors.by_joint[-1], "Held-out" if figures.errors[1] else "Fitted"
    low, high = int(np.nanargmin(shares)), int(np.nanargmax(shares))
    ends = [f"{percent(float(shares[k]))} ({figures.names[k]})" for k in dict.fromkeys((low, high))]
    return f"{what} torques are off by {' to '.join(ends)} of their rms, at all frequencies"


def _spectrum_title(figures: ArmFigures) -> str:
    """Above which frequency the error is large, in the first and in the last joint."""
    above: dict[str, float] = {}
    for i in figures.drawn:
        f, torque, error, _ = figures.densities(i)[0]
        large = np.flatnonzero(error > _LARGE * torque)
        above[figures.names[i]] = float(f[large[0]]) if large.size else np.inf
    name = min(above, key=lambda key: above[key])
    last = max(above, key=lambda key: above[key])
    if not np.isfinite(above[name]):
        return "The error stays below half of the torque at all frequencies"
    text = f"The error first exceeds half of the torque at {plain(above[name], 2)} Hz in {name}"
    if last == name:
        return text
    return f"{text}, " + (
        f"at {plain(above[last], 2)} Hz in {last}" if np.isfinite(above[last]) else f"and nowhere in {last}"
    )


def _error_rows(figures: ArmFigures) -> list[dict[str, Any]]:
    """Of each joint, and of all: rms torque and errors, of the fitted and the held-out log."""
    some = [errors for errors in figures.errors if errors is not None]
    if not some:
        return []
    rows: list[dict[str, Any]] = []
    for i, name in enumerate(figures.names):
        cells = [percent(float(errors.by_joint[k, i])) for errors in some for k in (0, 1, -1)]
        torque = f"{plain(float(some[0].torque_rms[-1, i]))} {figures.unit(i)[0]}"
        torque = "not measured" if name in figures.model.facts.unmeasured else torque
        rows.append({"name": name, "torque": torque, "cells": cells})
    cells = [percent(float(errors.overall[k])) for errors in some for k in (0, 1, -1)]
    return [*rows, {"name": "all", "torque": "", "cells": cells}]


def _friction_rows(figures: ArmFigures) -> dict[str, Any]:
    """Friction and constant torque by joint: kinds, and a cell for each."""
    model = figures.model
    given = zip(model.terms, model.coefficients.tolist(), model.standard_errors.tolist(), strict=True)
    values = {(t.kind, t.place): (t, value, error) for t, value, error in given if t.kind != "inertia"}
    kinds = [k for k in (*FRICTION, "offset") if any(kind == k for kind, _ in values)]
    rows: list[dict[str, Any]] = []
    for i, name in enumerate(figures.names):
        cells = [_with_error(*values[kind, i][1:]) if (kind, i) in values else "–" for kind in kinds]
        dry = values.get(("dry", i))
        way = plain(1e3 * dry[0].distance) if dry is not None and dry[0].distance else "–"
        rows.append({"name": name, "cells": cells, "distance": way})
    return {"kinds": ["constant torque" if k == "offset" else k for k in kinds], "rows": rows}


def _with_error(value: float, error: float) -> str:
    number = number_parts(value, error)
    if number.power and not number.apart:
        power = number.text.removeprefix(number.value)
        return f"({number.value} ± {number.error}){power}"
    return f"{number.text} ± {number.error_text}"


def _link_rows(figures: ArmFigures) -> list[dict[str, str]]:
    """Mass, centre of mass in mm, and rotor of each link that can exist."""
    solid, known = figures.solid, figures.from_log
    rotors = {term.place: value for term, value in solid.in_joints() if term.kind == "rotor"}
    rows: list[dict[str, str]] = []
    for k, (joint, row) in enumerate(zip(solid.tree.joints, solid.tree.inertias.tolist(), strict=True)):
        centre = ", ".join(f"{1e3 * x / row[0]:.0f}".replace("-", "−") for x in row[1:4])
        rows.append(
            {
                "number": str(k + 1),
                "link": joint.link,
                "joint": joint.name,
                "mass": plain(row[0]),
                "centre": centre,
                "rotor": plain(rotors[k]) if k in rotors else "–",
                "known": f"{100 * known[k, 0]:.0f} %",
                "centre_known": f"{100 * known[k, 1:4].mean():.0f} %",
            }
        )
    return rows


def _base_groups(figures: ArmFigures) -> list[dict[str, Any]]:
    """The base parameters in groups, with intervals and the share that comes from the log."""
    model, base = figures.model, figures.model.base
    spread = figures.prior[1]
    rows: list[tuple[str, dict[str, Any]]] = []
    given = zip(model.terms, model.coefficients.tolist(), model.standard_errors.tolist(), strict=True)
    for k, (kind, value, error) in enumerate((term.kind, value, error) for term, value, error in given):
        number, term = number_parts(value, error), ModelTerm("x", value, error)
        own = base.matrix[k] != 0.0
        share = np.nan
        if np.isfinite(spread[own]).all():
            before = float(np.sum((base.matrix[k, own] * spread[own]) ** 2))
            share = before / (before + error**2)
        row = {
            "text": _FACTOR.sub("\u202f", base.text(k)).replace("-", "−"),
            "value": number.text,
            "error": number.error_text,
            "whisker": whisker(term, f"base{k}"),
            "interval": " … ".join(map(typeset, interval_text(term).split(" … "))),
            "share": "" if np.isnan(share) else f"{100 * share:.0f} %",
        }
        group = "links" if kind == "inertia" else "friction" if kind in FRICTION else "joints"
        rows.append(("added terms" if kind in EXTRA else group, row))
    return [
        {"name": name, "rows": [row for _, row in some]}
        for name, some in groupby(rows, key=lambda pair: pair[0])
    ]


def _parameter_rows(figures: ArmFigures) -> list[dict[str, Any]]:
    """The ten parameters of each link with the tree as prior, and their shares from the log."""
    found, n = figures.posterior, len(figures.names)
    cells = [
        {"text": _with_error(value, error), "share": f"{100 * share:.0f}"}
        for value, error, share in zip(
            found.values[: 10 * n].tolist(),
            found.standard_errors[: 10 * n].tolist(),
            found.from_data[: 10 * n].tolist(),
            strict=True,
        )
    ]
    return [
        {"link": link, "cells": cells[10 * k : 10 * k + 10]}
        for k, link in enumerate(figures.model.tree.links)
    ]


def _joint_rows(figures: ArmFigures) -> list[dict[str, str]]:
    """Range, speed, noise and equation error of each joint."""
    facts = figures.model.facts
    q = np.concatenate([run.q for run in figures.fitted])
    speed = np.max([np.abs(run.qdot).max(axis=0) for run in figures.fitted], axis=0)
    rows: list[dict[str, str]] = []
    for i, name in enumerate(figures.names):
        torque, own = figures.unit(i)
        rows.append(
            {
                "name": name,
                "range": f"{plain(float(q[:, i].min()))} … {plain(float(q[:, i].max()))} {own}",
                "speed": f"{plain(float(speed[i]))} {own}/s",
                "noise": f"{plain(facts.noise_std[i], 2)} {own}",
                "error": "not measured"
                if name in facts.unmeasured
                else f"{plain(float(np.sqrt(facts.torque_density[i])), 2)} {torque}/√Hz",
                "gain": plain(facts.gains[i]) if facts.gains else "",
                "delay": f"{plain(1e3 * facts.delays[i], 2)} ms" if facts.delays else "",
            }
        )
    return rows
