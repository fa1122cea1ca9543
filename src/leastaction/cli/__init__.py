"""The command line, ``leastaction``: the same program as ``python -m leastaction``.

SymPy and SciPy are imported inside the commands, so that ``--help`` answers at once.
The exit codes are those of `failures.EXIT_CODES`. A command that fails writes nothing.
"""

from __future__ import annotations

from leastaction.cli.program import main, program

__all__ = ["main", "program"]
