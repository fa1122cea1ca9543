"""A model as a C99 file."""

from __future__ import annotations

from leastaction.exporters.shared import CPrinter, about, assignments, clock, equations
from leastaction.mechanics.equations import Mechanics
from leastaction.model.model import LagrangianModel

__all__ = ["definitions", "write"]

_SOLVE = """
    /* Gaussian elimination with partial pivoting. */
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i][k]) > fabs(a[pivot][k])) pivot = i;
        if (a[pivot][k] == 0.0) {
            for (int i = 0; i < n; i++) qddot[i] = NAN;
            return;
        }
        for (int j = k; j < n; j++) {
            const double swap = a[k][j];
            a[k][j] = a[pivot][j];
            a[pivot][j] = swap;
        }
        const double swap = b[k];
        b[k] = b[pivot];
        b[pivot] = swap;
        for (int i = k + 1; i < n; i++) {
            const double factor = a[i][k] / a[k][k];
            for (int j = k + 1; j < n; j++) a[i][j] -= factor * a[k][j];
            b[i] -= factor * b[k];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        double sum = b[i];
        for (int j = i + 1; j < n; j++) sum -= a[i][j] * qddot[j];
        qddot[i] = sum / a[i][i];
    }
}
"""


def write(model: LagrangianModel) -> str:
    """Return the file."""
    lines = ["/*", *(f" * {line}" for line in about(model)), " * C99; link with -lm.", " */"]
    lines += ["#include <math.h>", "#include <stddef.h>", ""]
    return "\n".join(lines) + "\n" + definitions(model.mechanics)


def definitions(mechanics: Mechanics, parameters: str = "") -> str:
    """Return the functions of acceleration and energy; `parameters` names an array that they take first."""
    n, first_argument = mechanics.n_dof, f"const double {parameters}[], " if parameters else ""
    time = clock(mechanics, "double t")
    arguments = [*([parameters] if parameters else []), "q", "qdot", *(["t"] if time else [])]
    not_used = [f"    (void){name};" for name in arguments]
    first, values = assignments(equations(mechanics), mechanics, CPrinter().doprint)
    rows = ",\n        ".join(f"{{{', '.join(values[i * n : (i + 1) * n])}}}" for i in range(n))
    acceleration = [
        "/* Accelerations qddot; forces may be NULL. NaN where the mass matrix is singular. */",
        f"void leastaction_acceleration({first_argument}const double q[{n}], const double qdot[{n}]{time},",
        f"                              const double forces[{n}], double qddot[{n}])",
        "{",
        f"    enum {{ n = {n} }};",
        *(f"    const double {name} = {code};" for name, code in first),
        f"    double a[n][n] = {{\n        {rows}}};",
        f"    double b[n] = {{{', '.join(values[n * n :])}}};",
        *not_used,
        "    if (forces != NULL)",
        "        for (int i = 0; i < n; i++) b[i] += forces[i];",
    ]
    first, values = assignments([mechanics.energy_expression], mechanics, CPrinter().doprint)
    energy = [
        "",
        "/* Energy: the sum of qdot * dL/dqdot, minus L. */",
        f"double leastaction_energy({first_argument}const double q[{n}], const double qdot[{n}]{time})",
        "{",
        *(f"    const double {name} = {code};" for name, code in first),
        *not_used,
        f"    return {values[0]};",
        "}",
    ]
    return "\n".join(acceleration) + _SOLVE + "\n".join(energy) + "\n"
