"""C sources to a shared library, by the compiler found on the PATH."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from leastaction.errors import InputError

__all__ = ["COMPILERS", "compile_library", "platform_name"]

COMPILERS = ("cc", "gcc", "clang")
_SECONDS = 600


def platform_name(version: int) -> str:
    """Name that FMI gives this platform: ``linux64`` in version 2, ``x86_64-linux`` in version 3."""
    systems = {"linux": ("linux", "linux"), "darwin": ("darwin", "darwin"), "win32": ("win", "windows")}
    short, long = systems.get(sys.platform, (sys.platform, sys.platform))
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}.get(machine, machine)
    if version == 2 and machine in ("x86_64", "x86"):
        return f"{short}{64 if machine == 'x86_64' else 32}"
    # Version 2 has one name for both kinds of Mac.
    return "darwin64" if version == 2 and short == "darwin" else f"{machine}-{long}"


def compile_library(sources: Mapping[str, str], options: Sequence[str] = ()) -> tuple[bytes, str]:
    """Return a shared library of the C files (file name -> text), and the suffix of its name.

    Raises
    ------
    InputError
        If there is no C compiler, or it fails.
    """
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise InputError(
            f"there is no C compiler on the PATH (looked for {', '.join(COMPILERS)}), and an FMU holds "
            "compiled code; install one such as GCC or Clang, or export another format"
        )
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    with TemporaryDirectory(prefix="leastaction-") as name:
        folder = Path(name)
        for path, text in sources.items():
            (folder / path).write_text(text, encoding="utf-8")
        units = sorted(path for path in sources if path.endswith(".c"))
        position = [] if sys.platform == "win32" else ["-fPIC", "-fvisibility=hidden"]
        if sys.platform == "linux":  # elsewhere a missing function is an error anyway
            position.append("-Wl,--no-undefined")
        command = [compiler, "-std=c99", "-O2", *position, *options, "-shared", "-o", f"library{suffix}"]
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
