"""Every script of examples/ runs as it is, draws, and stays short. ``make gallery`` runs the slow part."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

resource = pytest.importorskip("resource", reason="processor time of a child is a matter of POSIX")

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))
SECONDS = 30.0  # of one core; double that ends the test on slow machines

# Counts figures where a person would look at them.
_RUN = """
import runpy, sys
import matplotlib.pyplot as plt
shown = []
plt.show = lambda: shown.extend(plt.get_fignums())
runpy.run_path(sys.argv[1], run_name="__main__")
sys.exit(0 if shown else "the script shows no figure")
"""


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_script_runs(script: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", _RUN, str(script)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    assert after.ru_utime - before.ru_utime < 2 * SECONDS
    assert not list(tmp_path.iterdir()), "a script must not leave files behind"


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_script_is_a_page(script: Path) -> None:
    """A title, public names only, a figure at the end, and what to learn from it."""
    text = script.read_text(encoding="utf-8")
    tree = ast.parse(text)
    title, rule = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert set(rule) == {"="}
    assert len(rule) >= len(title)
    modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    modules += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    assert not [m for m in modules if m.startswith("leastaction.") and m.split(".")[1].startswith("_")]
    attributes = [n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
    assert not [a for a in attributes if a.startswith("_")]
    tail = text[text.rindex("plt.show()") :]
    assert "# **What to learn.**" in tail
