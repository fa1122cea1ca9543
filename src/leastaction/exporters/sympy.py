"""A model as a script for SymPy."""

from __future__ import annotations

from sympy.printing.pycode import SymPyPrinter

from leastaction.exporters.shared import unused
from leastaction.identifiers import TIME, names_in_terms
from leastaction.model.model import LagrangianModel

__all__ = ["write"]


def write(model: LagrangianModel) -> str:
    """Return the script that defines L and ψ over SymPy."""
    names = names_in_terms(model.coordinates)
    if not model.timed:
        names.remove(TIME)
    # A coordinate may have any name that the script uses.
    module, lagrangian, dissipation = (
        unused(name, names) for name in ("sympy", "lagrangian", "dissipation_function")
    )
    printer = _SymPyPrinter(module)
    psi = printer.doprint(model.dissipation_function) if model.dissipation else f"{module}.Integer(0)"
    return (
        "# Written by leastaction.\n"
        f"import sympy{'' if module == 'sympy' else f' as {module}'}\n\n"
        f'{", ".join(names)} = {module}.symbols("{" ".join(names)}", real=True)\n'
        f"{lagrangian} = {printer.doprint(model.lagrangian)}\n"
        f"{dissipation} = {psi}\n"
    )


class _SymPyPrinter(SymPyPrinter):
    def __init__(self, module: str) -> None:
        super().__init__({"fully_qualified_modules": True})
        self.module = module

    def _module_format(self, fqn, register=True):
        return f"{self.module}.{fqn.rpartition('.')[2]}"

    def _print_Float(self, expr):
        return repr(float(expr))

    def _print_Rational(self, expr):
        return f"{self.module}.Rational({expr.p}, {expr.q})"

    def _print_Pi(self, expr):
        return f"{self.module}.pi"

    def _print_Exp1(self, expr):
        return f"{self.module}.E"
