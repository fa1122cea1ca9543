"""The command line, ``leastaction``: the same program as ``python -m leastaction``.

SymPy and SciPy are imported inside the commands, so that ``--help`` answers at once.
Exit codes: 0 done (for ``discover``: a model was written, even if a doubtful one); 1 the data do not support
any model, or a motion cannot be followed to the end; 2 wrong use or bad input; 70 a fault of the program;
130 interrupted. A command that fails writes nothing.
"""

from __future__ import annotations

from leastaction.cli.program import main, program

__all__ = ["main", "program"]
