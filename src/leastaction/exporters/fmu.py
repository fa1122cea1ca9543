"""Export as an FMU for co-simulation: an archive of a description, C sources and compiled libraries.

The compiler on the PATH builds the library of this platform.  If the package ``ziglang`` is installed (extra
``fmu``), its ``cc`` builds the libraries of the others.
"""

from __future__ import annotations

import io
import platform
import re
import shutil
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.exporters import c
from leastaction.exporters.fmu_description import build_description, model_description, variables
from leastaction.exporters.shared import about, clock
from leastaction.mechanics.equations import Mechanics
from leastaction.model.model import LagrangianModel

__all__ = [
    "COMPILERS",
    "TARGETS",
    "compile_library",
    "longest_step",
    "platform_name",
    "source_files",
    "write",
]

COMPILERS = ("cc", "gcc", "clang")
TARGETS = {
    2: {"win64": "x86_64-windows-gnu", "linux64": "x86_64-linux-gnu.2.17", "darwin64": "x86_64-macos"},
    3: {
        "x86_64-windows": "x86_64-windows-gnu",
        "x86_64-linux": "x86_64-linux-gnu.2.17",
        "aarch64-linux": "aarch64-linux-gnu.2.17",
        "x86_64-darwin": "x86_64-macos",
        "aarch64-darwin": "aarch64-macos",
    },
}
"""Version of FMI -> its name of a platform -> Zig's name, with the oldest supported glibc."""

_SECONDS = 600  # limit of a compilation
_MAX_STEP = 1e-3  # seconds, unless the knots of the discovery or the halving test require less
_STEPS_PER_KNOT = 10
_HALVINGS = 10  # largest number
_STEPS_TRIED = 100
_STATES_TRIED = 16
_TOLERANCE = 1e-8  # change of the state after so many steps when they are halved, relative to the motion
_SHARED_NAMES = (
    "leastaction_acceleration",
    "leastaction_energy",
    "motion_reset",
    "motion_set",
    "motion_get",
    "motion_step",
)


def write(model: LagrangianModel, version: int, file: str | None = None) -> bytes:
    """Return the archive; the name of the model follows from its name, `file`.

    Raises
    ------
    InputError
        If there is no C compiler.
    """
    name = _identifier(file)
    step = longest_step(model)
    table = variables(model, step)
    # The token ties the description to the library: any change of either must change the token.
    parts = [
        model_description(name, version, table, ""),
        *(text for _, text in sorted(source_files(model, version, name, "", step).items())),
    ]
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_URL, ''.join(parts))}}}"
    sources = source_files(model, version, name, token, step)
    members: dict[str, bytes] = {
        "modelDescription.xml": model_description(name, version, table, token).encode(),
        **{
            f"binaries/{place}/{name}{suffix}": library
            for place, (library, suffix) in _libraries(sources, version).items()
        },
        **{f"sources/{path}": text.encode() for path, text in sources.items()},
    }
    if version == 3:
        members["sources/buildDescription.xml"] = build_description(name).encode()
    return _archive(members)


def _libraries(sources: Mapping[str, str], version: int) -> dict[str, tuple[bytes, str]]:
    """Name of a platform -> library and suffix: this platform and, with Zig, the others."""
    options, zig = [f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX"], find_spec("ziglang") is not None
    out: dict[str, tuple[bytes, str]] = {}
    if not zig or _compiler() is not None:
        out[platform_name(version)] = compile_library(sources, options)
    for place, target in TARGETS[version].items() if zig else ():
        if place not in out:
            out[place] = compile_library(sources, options, target)
    return out


def source_files(
    model: LagrangianModel, version: int, name: str, token: str, step: float = _MAX_STEP
) -> dict[str, str]:
    """File name -> text: common sources, and the equations with parameters."""
    ours = files("leastaction.exporters") / "sources"
    out = {
        path: (ours / path).read_text(encoding="utf-8")
        for path in (f"fmi{version}.c", "motion.c", "motion.h")
    }
    terms = (*model.terms, *model.dissipation)
    # A name with brackets is an element of an array in C, and no coordinate can have it.
    symbols = [sp.Symbol(f"p[{k}]", real=True) for k in range(len(terms))]
    n, n_dof = len(model.terms), model.n_dof
    mechanics = Mechanics(
        sp.Add(*(s * e for s, e in zip(symbols[:n], model.expressions, strict=True))),
        sp.Add(*(s * e for s, e in zip(symbols[n:], model.dissipation_expressions, strict=True))),
        model.coordinates,
    )
    numbers = ", ".join(repr(term.coefficient) for term in terms)
    comment = "\n".join(["/*", *(f" * {line}" for line in about(model)), " */"])
    out["model.h"] = (
        f"{comment}\n#ifndef MODEL_H\n#define MODEL_H\n\n"
        f'#define MODEL_PREFIX {name}_\n#define MODEL_TOKEN "{token}"\n'
        f"#define START_MAX_STEP {step!r}\n\n"
        f"enum {{ N_DOF = {n_dof}, N_COEFFICIENTS = {len(terms)} }};\n\n"
        f"#define START_COEFFICIENTS {{{numbers}}}\n\n"
        "/* Arguments of the equations. */\n"
        f"#define AT(q, qdot, t) q, qdot{clock(mechanics)}\n\n"
        "/* Names must not clash if a program loads several FMUs. */\n"
        + "".join(f"#define {function} {name}_{function}\n" for function in _SHARED_NAMES)
        + "\n"
        f"void leastaction_acceleration(const double p[], const double q[{n_dof}], "
        f"const double qdot[{n_dof}]{clock(mechanics, 'double t')},\n"
        f"                              const double forces[{n_dof}], double qddot[{n_dof}]);\n"
        f"double leastaction_energy(const double p[], const double q[{n_dof}], "
        f"const double qdot[{n_dof}]{clock(mechanics, 'double t')});\n"
        "\n#endif\n"
    )
    includes = '#include <math.h>\n#include <stddef.h>\n\n#include "model.h"\n'
    out["model.c"] = f"{comment}\n{includes}\n{c.definitions(mechanics, 'p')}"
    return out


def _identifier(file: str | None) -> str:
    """Name of the model: a C identifier made from the name of the file."""
    if file is None:
        return "leastaction_model"
    stem = re.sub(r"[^A-Za-z0-9_]", "_", file.removesuffix(".fmu"))[:60]
    return stem if stem[:1].isalpha() else f"model_{stem}"


def longest_step(model: LagrangianModel) -> float:
    """Internal step of the integration in seconds, halved until another halving has no effect.

    It starts at 1 ms, or a tenth of a knot interval of the discovery if that is shorter. The test integrates
    from states on the fitted curve, or near zero for a model from a file.
    """
    knots = model.provenance.get("knots_per_second")
    fastest = float(knots) if isinstance(knots, (int, float)) and knots > 0 else 0.0
    step = min(_MAX_STEP, 1.0 / (_STEPS_PER_KNOT * fastest)) if fastest else _MAX_STEP
    start, t = _states_to_try(model)
    with np.errstate(all="ignore"):
        for _ in range(_HALVINGS):
            coarse = _followed(model, start, t, step, _STEPS_TRIED)
            fine = _followed(model, start, t, step / 2.0, 2 * _STEPS_TRIED)
            there = np.isfinite(fine)
            size = np.abs(np.where(there, fine, 0.0)).max(axis=0) + np.abs(start).max(axis=0) + 1e-300
            lost = there & ~np.isfinite(coarse)
            if not lost.any() and np.nanmax(np.abs(coarse - fine) / size, initial=0.0) <= _TOLERANCE:
                break
            step /= 2.0
    return step


def _states_to_try(model: LagrangianModel) -> tuple[np.ndarray, np.ndarray]:
    """(n_states, 2 n_dof) coordinates and velocities, and their times."""
    if model.diagnostics is not None:
        trial, *others = model.diagnostics.trajectories
        t = np.linspace(trial.t[0], trial.t[-1], _STATES_TRIED)
        times = [t, *(other.t[:1] for other in others)]
        q, qdot = (model.diagnostics.curve(times, nu)[0] for nu in (0, 1))
        return np.hstack([q, qdot]), t
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (_STATES_TRIED, 2 * model.n_dof))
    return states, np.zeros(_STATES_TRIED)


def _followed(
    model: LagrangianModel, start: np.ndarray, t: np.ndarray, step: float, count: int
) -> np.ndarray:
    """The states after ``steps`` steps of the classical Runge–Kutta method, as in the C code."""
    n, x = model.n_dof, start.copy()

    def rates(x: np.ndarray, time: np.ndarray) -> np.ndarray:
        given = time if model.timed else None
        return np.hstack([x[:, n:], model.acceleration(x[:, :n], x[:, n:], t=given)])

    for k in range(count):
        now = t + k * step
        one = rates(x, now)
        two = rates(x + step / 2.0 * one, now + step / 2.0)
        three = rates(x + step / 2.0 * two, now + step / 2.0)
        four = rates(x + step * three, now + step)
        x = x + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return x


def _archive(members: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            # A fixed date, so that the output is reproducible.
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, data)
    return out.getvalue()


def platform_name(version: int) -> str:
    """FMI's name of this platform: ``linux64`` in version 2, ``x86_64-linux`` in version 3."""
    systems = {"linux": ("linux", "linux"), "darwin": ("darwin", "darwin"), "win32": ("win", "windows")}
    short, long = systems.get(sys.platform, (sys.platform, sys.platform))
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}.get(machine, machine)
    if version == 2 and machine in ("x86_64", "x86"):
        return f"{short}{64 if machine == 'x86_64' else 32}"
    # Version 2 has one name for both kinds of Mac.
    return "darwin64" if version == 2 and short == "darwin" else f"{machine}-{long}"


def _compiler() -> str | None:
    return next((found for name in COMPILERS if (found := shutil.which(name))), None)


def compile_library(
    sources: Mapping[str, str], options: Sequence[str] = (), target: str | None = None
) -> tuple[bytes, str]:
    """Return a shared library of the C files (file name -> text), and the suffix of its name.

    Parameters
    ----------
    target : str, optional
        Zig's name of a platform; by default this platform, with the compiler on the PATH.

    Raises
    ------
    InputError
        If there is no C compiler, or it fails.
    """
    compiler = _compiler() if target is None else "ziglang"
    if compiler is None:
        raise InputError(
            f"there is no C compiler on the PATH (tried {', '.join(COMPILERS)}), which an FMU needs; install "
            "one such as GCC or Clang, or pip install 'leastaction[fmu]', or export another format"
        )
    start = [compiler] if target is None else [sys.executable, "-m", "ziglang", "cc", "-target", target, "-s"]
    system = sys.platform if target is None else target
    windows, mac = system == "win32" or "windows" in system, system == "darwin" or "macos" in system
    suffix = ".dll" if windows else ".dylib" if mac else ".so"
    with TemporaryDirectory(prefix="leastaction-") as name:
        folder = Path(name)
        for path, text in sources.items():
            (folder / path).write_text(text, encoding="utf-8")
        units = sorted(path for path in sources if path.endswith(".c"))
        position = [] if windows else ["-fPIC", "-fvisibility=hidden"]
        if "linux" in system:  # elsewhere a missing function is an error anyway
            position.append("-Wl,--no-undefined")
        command = [*start, "-std=c99", "-O2", *position, *options, "-shared", "-o", f"library{suffix}"]
        try:
            done = subprocess.run(
                [*command, *units, "-lm"], cwd=folder, capture_output=True, timeout=_SECONDS, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            reason = f"not done after {_SECONDS} s" if isinstance(error, subprocess.TimeoutExpired) else error
            raise InputError(f"the C compiler {compiler} cannot be used: {reason}") from None
        if done.returncode != 0:
            said = done.stderr.decode(errors="replace").strip().splitlines() or [
                f"exit code {done.returncode}"
            ]
            first = next((line for line in said if "error" in line.lower()), said[0])
            raise InputError(f"the C compiler {compiler} failed: {first[:200]}; try another one, such as GCC")
        return (folder / f"library{suffix}").read_bytes(), suffix
