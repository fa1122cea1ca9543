"""Forward and backward search on the weak form of driven chains: what each finds, and how long it takes.

    python benchmarks/weak_searches.py [LINKS ...]

Each chain is recorded for 4 × 10 s at 100 Hz and searched among its own terms and as many others, dry
friction among them, at three widths of the test functions.  The table says how many terms of the law are
missing and how many others were taken, at the smallest equation error with which a support explains the rows.
"""

from __future__ import annotations

import sys
import time

from driven_chains import Chain

from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.library import make_term
from leastaction.selection.likelihood_search import term_penalty
from leastaction.selection.settings import SELECTION
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_proposals import weak_grams
from leastaction.selection.weak_search import beam_search, noise_ratio, support_score

ERRORS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
NOISE = 0.001


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
                            levels = beam_search(gram, error, penalty, n_rows, n_candidates)
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
