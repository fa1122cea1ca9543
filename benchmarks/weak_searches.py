"""Forward and backward search on the weak form of driven chains: what each finds, and how long it takes.

    python benchmarks/weak_searches.py [LINKS ...]

Each planar chain with viscous joints is recorded for 4 × 10 s at 100 Hz and searched among its own terms
and as many others, dry friction among them, at three widths of the test functions.  The table says how many
terms of the law are missing and how many others were taken, at the smallest equation error with which a
support explains the rows.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.library import make_term
from leastaction.selection.likelihood_search import term_penalty
from leastaction.selection.settings import SELECTION
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_form import weak_grams
from leastaction.selection.weak_search import beam_search, noise_ratio, support_score

ERRORS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
NOISE = 0.001


@dataclass(frozen=True)
class Chain:
    """A chain of links: mass coefficients m_ij (upper triangle with the factor 1 or ½ of L), and weights.

    T = ½ Σ_ij m_ij ω_i ω_j cos(φ_i − φ_j),  V = −Σ_i g_i cos φ_i,  friction ½ Σ_i c_i q̇_i²,

    with the angles φ and rates ω of the links; the coordinates q are these angles, or each is measured from
    the link before (``relative``).  Torques are sums of two sines.
    """

    n: int
    relative: bool

    @property
    def names(self) -> list[str]:
        return [f"q{k + 1}" for k in range(self.n)]

    @property
    def turn(self) -> np.ndarray:
        """φ = turn @ q."""
        return np.tril(np.ones((self.n, self.n))) if self.relative else np.eye(self.n)

    @property
    def mass(self) -> np.ndarray:
        """m_ij of links of 1 kg … 0.5 kg, each 0.5 m long."""
        masses = np.linspace(1.0, 0.5, self.n)
        beyond = masses[::-1].cumsum()[::-1]
        length = 0.5
        out = np.empty((self.n, self.n))
        for i in range(self.n):
            for j in range(self.n):
                outer = max(i, j)
                lever = beyond[outer] - 0.5 * masses[outer]
                out[i, j] = length**2 * (lever if i != j else lever - masses[i] / 6.0)
        return out

    @property
    def weight(self) -> np.ndarray:
        masses = np.linspace(1.0, 0.5, self.n)
        beyond = masses[::-1].cumsum()[::-1]
        return 9.81 * 0.5 * (beyond - 0.5 * masses)

    @property
    def friction(self) -> np.ndarray:
        return np.linspace(0.3, 0.1, self.n)

    def law(self) -> tuple[dict[str, float], dict[str, float]]:
        """Terms of L, n (n + 1) / 2 + n of them, and of the friction, with their coefficients."""
        names = self.names
        sums = [names[: k + 1] if self.relative else [names[k]] for k in range(self.n)]
        rates = ["+".join(f"{name}_dot" for name in each) for each in sums]
        terms = {f"({rate})**2": 0.5 * self.mass[i, i] for i, rate in enumerate(rates)}
        for i in range(self.n):
            for j in range(i + 1, self.n):
                between = "+".join(names[i + 1 : j + 1]) if self.relative else f"{names[i]}-{names[j]}"
                terms[f"({rates[i]})*({rates[j]})*cos({between})"] = self.mass[i, j]
        terms |= {f"cos({'+'.join(each)})": self.weight[i] for i, each in enumerate(sums)}
        return terms, {f"{name}_dot**2/2": c for name, c in zip(names, self.friction, strict=True)}

    def accelerations(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        turn = self.turn
        phi, omega = turn @ q, turn @ v
        difference = phi[:, None] - phi[None, :]
        push = -(self.mass * np.sin(difference)) @ omega**2 - self.weight * np.sin(phi)
        matrix = turn.T @ (self.mass * np.cos(difference)) @ turn
        return np.linalg.solve(matrix, turn.T @ push - self.friction * v + torque)

    def record(
        self, noise: float = 0.01, trials: int = 4, duration: float = 10.0, rate: float = 100.0, seed: int = 0
    ):
        """Trajectories with known torques; `noise` is relative to the spread of each coordinate."""
        rng = np.random.default_rng(seed)
        t = np.arange(0.0, duration, 1.0 / rate)
        size = 0.8 * (np.cumsum(self.weight[::-1])[::-1] if self.relative else self.weight)
        out = []
        for _ in range(trials):
            pace, phase = rng.uniform(2.0, 9.0, (2, self.n)), rng.uniform(0.0, 2 * np.pi, (2, self.n))

            def torque(s, pace=pace, phase=phase):
                return 0.5 * size * np.sin(np.multiply.outer(np.asarray(s), pace) + phase).sum(axis=-2)

            start = np.concatenate([rng.uniform(-1.0, 1.0, self.n), rng.uniform(-1.0, 1.0, self.n)])

            def motion(s, y, torque=torque):
                q, v = np.split(y, 2)
                return np.concatenate([v, self.accelerations(q, v, torque(s))])

            found = solve_ivp(
                motion,
                (0.0, t[-1]),
                start,
                method="DOP853",
                t_eval=t,
                rtol=1e-9,
                atol=1e-9,
            )
            q = found.y[: self.n].T
            q = q + noise * q.std(axis=0) * rng.standard_normal(q.shape)
            out.append(la.Trajectory(t, q, torque(t), self.names))
        return la.Trajectories(out)

    def candidates(self, others: int, seed: int = 0) -> la.Library:
        """The law's own terms and as many others of the generated families, none a sum of the rest."""
        terms, friction = self.law()
        names = self.names
        own = la.Library(list(terms), names)
        rng = np.random.default_rng(seed)
        size = "standard" if self.n < 5 else "chain"
        pool = list(la.Library.mechanical(names, names, size=size).terms)
        dry = [f"abs({name}_dot)" for name in names]
        both = la.Library([*own, *(pool[k] for k in rng.permutation(len(pool)))], names, angles=names)
        reduced = list(both.reduced(keep=own.terms).terms)
        chosen = reduced[: len(terms) + max(others - len(dry), 0)]
        return la.Library(chosen, names, angles=names, dissipation=[*friction, *dry])


def grams_of(chain: Chain):
    """Weak forms of a recording, and the places of the law among the candidates."""
    terms, friction = chain.law()
    library = chain.candidates(len(terms) + len(friction))
    setup = build_problem(chain.record(NOISE), Request(library))
    grid = Grid.lay(setup.problem, setup.scales.per_second)
    names = [*chain.names, *(f"{name}_dot" for name in chain.names)]
    law = {make_term(text, names, kind="lagrangian").expr for text in terms}
    law_of_friction = {make_term(text, names, kind="dissipation").expr for text in friction}
    members = {
        k
        for k, term in enumerate(setup.problem.terms)
        if term.expr in (law if term.kind == "lagrangian" else law_of_friction)
    }
    return weak_grams(grid, setup.scales.smooth, 0), members, len(setup.problem.terms)


def judge(levels, penalty: float, n_rows: float, noise: float):
    return min((s for level in levels for s in level), key=lambda s: support_score(s, penalty, n_rows, noise))


def main() -> None:
    links = [int(text) for text in sys.argv[1:]] or [3, 4, 5]
    print("links  angles    candidates  law  width     search     missing  others     ρ  CPU s")
    for n in links:
        for relative in (False, True):
            grams, law, n_candidates = grams_of(Chain(n, relative))
            start = f"{n:5d}  {'relative' if relative else 'absolute'}  {n_candidates:10d}  {len(law):3d}"
            for gram, width in zip(grams, ("1", "½", "2"), strict=True):
                n_rows = gram.n_rows / SELECTION.overlap
                penalty = term_penalty(int(n_rows), n_candidates)
                for search in ("forward", "backward"):
                    begin = time.process_time()
                    for error in ERRORS:
                        noise = 1.0
                        if search == "forward":
                            levels = beam_search(gram, error, penalty, n_rows)
                        else:
                            levels = backward_search(gram, error, penalty, n_rows)
                            noise = noise_ratio(levels[-1][0].ratio, n_candidates, n_rows)
                        best = judge(levels, penalty, n_rows, noise)
                        if best.ratio < SELECTION.rows_explained:
                            break
                    found = set(best.members)
                    print(
                        f"{start}  {width:5s}     {search:8s}  {len(law - found):8d}  {len(found - law):6d}  "
                        f"{best.ratio:5.2f}  {time.process_time() - begin:5.2f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
