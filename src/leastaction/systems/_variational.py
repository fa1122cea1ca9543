"""Forward sensitivities of a motion with respect to its state and to the coefficients of its terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.systems._system import MechanicalSystem

# Largest RK4 step for the variational equations, in seconds.
_STEP = 0.005


class Variational:
    """The equations of motion and their exact derivatives, compiled.

    With R(q, q̇, q̈) = Σ λₖ E[φₖ] + ∂ψ/∂q̇ − f = 0 and M = ∂R/∂q̈, the acceleration has the derivatives
    ∂q̈/∂q = −M⁻¹ ∂R/∂q, ∂q̈/∂q̇ = −M⁻¹ ∂R/∂q̇ and ∂q̈/∂λₖ = −M⁻¹ ∂R/∂λₖ.

    Parameters
    ----------
    system : MechanicalSystem
    terms : sequence of str
        Terms of the system's Lagrangian or dissipation, whose coefficients are the parameters.
    """

    def __init__(self, system: MechanicalSystem, terms: Sequence[str]) -> None:
        self.n_dof, self.n_terms = system.n_dof, len(terms)
        q, v = system.symbols
        a = sp.symbols(f"a0:{self.n_dof}", real=True)
        columns = []
        for term in terms:
            if term in system.lagrangian:
                columns.append(euler_lagrange(system.parse(term), q, v, a))
            elif term in system.dissipation:
                columns.append([sp.diff(system.parse(term), s) for s in v])
            else:
                raise InputError(f"{term!r} is not a term of {system.name}; expected some of {system.free}")
        residual = euler_lagrange(system.lagrangian_expression, q, v, a)
        residual = [r + sp.diff(system.dissipation_expression, s) for r, s in zip(residual, v, strict=True)]
        entries = []
        for i, r in enumerate(residual):
            entries += [*(sp.diff(r, s) for s in (*q, *v)), *(column[i] for column in columns)]
        self._right = sp.lambdify([*q, *v, *a], entries, "numpy", cse=True)
        self._system = system

    def derivatives(self, q, qdot, forces) -> tuple[np.ndarray, np.ndarray]:
        """Return q̈, shape (..., n_dof), and its derivatives, shape (..., n_dof, 2 n_dof + n_terms).

        The derivatives are by q, q̇ and the coefficients, in this order.
        """
        mass, right = self._system.mass_and_force(q, qdot)
        acceleration = np.linalg.solve(mass, (right if forces is None else right + forces)[..., None])[..., 0]
        arguments = (x[..., i] for x in (q, qdot, acceleration) for i in range(self.n_dof))
        table = np.empty((*q.shape, 2 * self.n_dof + self.n_terms))
        flat = table.reshape(*q.shape[:-1], -1)
        for k, value in enumerate(self._right(*arguments)):
            flat[..., k] = value
        return acceleration, -np.linalg.solve(mass, table)

    def transitions(self, t, q, qdot, forces=None) -> np.ndarray:
        """Return ∂(state at t[j+1]) / ∂(state at t[j], coefficients) for every interval.

        Parameters
        ----------
        t : ndarray, shape (n_times,)
        q, qdot : ndarray, shape (n_times, n_dof)
            The exact motion. All intervals are integrated side by side by RK4, each from its own exact start.
        forces : callable, optional
            Times of shape (m,) -> (m, n_dof).

        Returns
        -------
        ndarray, shape (n_times - 1, 2 n_dof, 2 n_dof + n_terms)
        """
        n, size = self.n_dof, 2 * self.n_dof + self.n_terms
        time, h_all = t[:-1], np.diff(t)
        substeps = max(1, int(np.ceil(h_all.max() / _STEP - 1e-9)))
        h = h_all / substeps
        y = np.concatenate([q, qdot], axis=1)[:-1]
        start = np.zeros((len(y), 2 * n, size))
        start[:] = np.eye(2 * n, size)
        state = np.concatenate([y[..., None], start], axis=2)

        def rates(time, state):
            q, qdot = state[:, :n, 0], state[:, n:, 0]
            acceleration, jacobian = self.derivatives(q, qdot, None if forces is None else forces(time))
            change = jacobian[..., : 2 * n] @ state[..., 1:]
            change[..., 2 * n :] += jacobian[..., 2 * n :]
            out = np.empty_like(state)
            out[:, :n] = state[:, n:]
            out[:, n:, 0], out[:, n:, 1:] = acceleration, change
            return out

        for _ in range(substeps):
            step = h[:, None, None]
            k1 = rates(time, state)
            k2 = rates(time + h / 2, state + step / 2 * k1)
            k3 = rates(time + h / 2, state + step / 2 * k2)
            k4 = rates(time + h, state + step * k3)
            state = state + step / 6 * (k1 + 2 * (k2 + k3) + k4)
            time = time + h
        return state[..., 1:]


def euler_lagrange(expression: sp.Expr, q, v, a) -> list[sp.Expr]:
    """Return d/dt ∂φ/∂q̇ᵢ − ∂φ/∂qᵢ by the chain rule, in plain symbols for q, q̇, q̈."""
    out = []
    for qi, vi in zip(q, v, strict=True):
        momentum = sp.diff(expression, vi)
        change = sum(sp.diff(momentum, q[j]) * v[j] + sp.diff(momentum, v[j]) * a[j] for j in range(len(q)))
        out.append(change - sp.diff(expression, qi))
    return out
