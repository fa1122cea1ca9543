"""A model as a Python module that imports only `math`."""

from __future__ import annotations

from leastaction.exporters.shared import PythonPrinter, about, assignments, clock, equations
from leastaction.model.model import LagrangianModel

__all__ = ["write"]

_SOLVE = '''

def _solve(a, b):
    """Gaussian elimination with partial pivoting; NaN if the matrix is singular."""
    n = len(b)
    for k in range(n):
        p = max(range(k, n), key=lambda i: abs(a[i][k]))
        if a[p][k] == 0:
            return [math.nan] * n
        a[k], a[p], b[k], b[p] = a[p], a[k], b[p], b[k]
        for i in range(k + 1, n):
            factor = a[i][k] / a[k][k]
            for j in range(k + 1, n):
                a[i][j] -= factor * a[k][j]
            b[i] -= factor * b[k]
    for i in reversed(range(n)):
        b[i] = (b[i] - sum(a[i][j] * b[j] for j in range(i + 1, n))) / a[i][i]
    return b
'''


def write(model: LagrangianModel) -> str:
    """Return the module."""
    n, mechanics = model.n_dof, model.mechanics
    code, t = PythonPrinter().doprint, clock(mechanics)
    lines = [*(f"# {line}" for line in about(model)), "import math", "", f"N_DOF = {n}", "", ""]
    first, values = assignments(equations(mechanics), mechanics, code)
    rows = ", ".join(f"[{', '.join(values[i * n : (i + 1) * n])}]" for i in range(n))
    lines += [
        f"def acceleration(q, qdot{t}, forces=None):",
        f'    """Accelerations, a list; q, qdot and forces are sequences of length {n}."""',
        *(f"    {name} = {value}" for name, value in first),
        f"    mass = [{rows}]",
        f"    right = [{', '.join(values[n * n :])}]",
        "    if forces is not None:",
        "        right = [r + f for r, f in zip(right, forces)]",
        "    return _solve(mass, right)",
        "",
        "",
    ]
    first, values = assignments([mechanics.energy_expression], mechanics, code)
    lines += [
        f"def energy(q, qdot{t}):",
        '    """Energy, the sum of qdot * dL/dqdot, less L."""',
        *(f"    {name} = {value}" for name, value in first),
        f"    return {values[0]}",
    ]
    return "\n".join(lines) + "\n" + _SOLVE
