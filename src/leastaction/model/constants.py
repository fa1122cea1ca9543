r"""Simple numbers inside the 95 % intervals of coefficients and shape parameters: proposed, never
substituted.

The list is short: p/q up to 4/4, whole numbers up to ten, π/4 … 4π, √2 and 1/√2. For an estimate x whose
logarithm is uniform within a factor of two, and n numbers of the list in (x/2, 2x), the expected number of
chance hits is

.. math:: n \log(b/a) / \log 4

for an interval (a, b). Quantities are sorted by this chance, and numbers are proposed while the sum of the
chances of all quantities so far stays below 5 % of the number of proposals. On average, at most one proposal
in twenty is a coincidence, and a law without simple numbers gets one with a probability of at most 5 %. Zero
is not on the list.

The quantities are, first, the shape parameters and coefficients in the units of the data, on the scale set by
the known term or the forces. Second, they are ratios of coefficients, which depend on neither, unless they
follow from proposed numbers. Each kind has half of the 5 %. A ratio has no unit if both terms scale alike
with the units of position and time. Its denominator is the known one of these terms, or the most precise.
Terms that do not scale, such as exp(−x), have no ratios.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from leastaction.library.jets import Jets, Points
from leastaction.model.checks import angles_in
from leastaction.model.notation import rounded
from leastaction.model.numbers import covariance_of, values_of
from leastaction.model.term import Z95
from leastaction.selection.settings import SELECTION
from leastaction.selection.significance import chi_square_cutoff

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["Offer", "SimpleConstants", "find_simple_constants"]

_WINDOW = math.log(4.0)
_SAME = 1e-9  # relative: degrees that do not depend on the state


def _numbers() -> dict[str, float]:
    fractions = {f"{p}/{q}": p / q for q in (2, 3, 4) for p in (1, 2, 3, 4) if math.gcd(p, q) == 1}
    turns = {"pi/4": 0.25, "pi/2": 0.5, "pi": 1.0, "2*pi": 2.0, "4*pi": 4.0}
    return {
        **{str(n): float(n) for n in range(1, 11)},
        **fractions,
        **{text: factor * math.pi for text, factor in turns.items()},
        "sqrt(2)": math.sqrt(2.0),
        "1/sqrt(2)": math.sqrt(0.5),
    }


_NUMBERS = _numbers()


@dataclass(frozen=True)
class Offer:
    """A simple number inside an interval.

    Attributes
    ----------
    subject : str
        Expression of the term, or the name of a shape parameter in braces.
    reference : str
        For a ratio: expression of the term in the denominator; otherwise empty.
    estimate, standard_error : float
    lower, upper : float
        95 % interval.
    number : float
    text : str
        The number as text, such as ``"1/2"`` or ``"-2*pi"``.
    chance : float
        Expected number of list members in an interval of this width by chance.

    Examples
    --------
    >>> print(Offer("y_dot**2", "", 0.50023, 0.00031, 0.4996, 0.5008, 0.5, "1/2", 0.004))
    y_dot**2 = 0.50023(31): 1/2
    """

    subject: str
    reference: str
    estimate: float
    standard_error: float
    lower: float
    upper: float
    number: float
    text: str
    chance: float

    @property
    def written(self) -> str:
        """Estimate with its error in the last digits."""
        return rounded(self.estimate, self.standard_error, uncertainty=True)

    def __str__(self) -> str:
        name = f"ratio of {self.subject} to {self.reference}" if self.reference else self.subject
        return f"{name} = {self.written}: {self.text}"


@dataclass(frozen=True)
class SimpleConstants:
    """Simple numbers inside intervals of a model, and a test of all of them together.

    Attributes
    ----------
    offers : tuple of Offer
    chi2 : float
        Squared distance of the estimates from the proposed numbers, with their covariance.
    freedom : int
        Its degrees of freedom: independent proposals.
    compatible : bool
        Whether `chi2` is below the threshold of the package's false-alarm rate.
    """

    offers: tuple[Offer, ...] = ()
    chi2: float = 0.0
    freedom: int = 0
    compatible: bool = True


@dataclass(frozen=True, eq=False)
class _Question:
    """A quantity, p·`row` over p·`below`; p·`row` itself if `below` is zero."""

    subject: str
    reference: str
    estimate: float
    standard_error: float
    lower: float
    upper: float
    row: np.ndarray
    below: np.ndarray


def find_simple_constants(model: LagrangianModel) -> SimpleConstants:
    """Simple numbers inside the intervals of a model's coefficients, shape parameters and ratios.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> terms = [ModelTerm("x_dot**2", 0.5003, 0.0004), ModelTerm("x**2", -2.37, 0.002)]
    >>> [str(offer) for offer in LagrangianModel("x", terms).simple_constants.offers]
    ['x_dot**2 = 0.50030(40): 1/2']
    """
    covariance = covariance_of(model)
    found = _accepted(_direct(model))
    simple = {term.written for term in (*model.terms, *model.dissipation) if term.known}
    simple |= {offer.subject for _, offer in found}
    ratios = _ratios(model, covariance)
    found += _accepted([q for q in ratios if not {q.subject, q.reference} <= simple])
    return _together(model, [offer for _, offer in found], [question for question, _ in found], covariance)


def _accepted(questions: list[_Question]) -> list[tuple[_Question, Offer]]:
    """The quantities with a simple number, limited by the expected number of coincidences."""
    ranked = sorted(((_expected(question), k) for k, question in enumerate(questions)))
    found: list[tuple[_Question, Offer]] = []
    n_kept, total = 0, 0.0
    for expected, k in ranked:
        offer = _offer(questions[k], expected)
        found += [(questions[k], offer)] if offer else []
        total += expected
        if total <= 0.5 * SELECTION.simple_numbers * len(found):  # the other kind has the other half
            n_kept = len(found)
    return found[:n_kept]


def _together(
    model: LagrangianModel, offers: list[Offer], asked: list[_Question], covariance: np.ndarray
) -> SimpleConstants:
    """The proposals, with the test of all of them together."""
    if not offers:
        return SimpleConstants()
    values = values_of(model)
    numbers = np.array([offer.number for offer in offers])
    below = np.array([question.below for question in asked])
    rows = np.array([question.row for question in asked]) - numbers[:, None] * below
    wanted = np.where(below.any(axis=1), 0.0, numbers)
    off = rows @ values - wanted
    spread = rows @ covariance @ rows.T
    sizes = np.sqrt(np.diag(spread))
    off, spread = off / sizes, spread / np.outer(sizes, sizes)
    freedom = int(np.linalg.matrix_rank(spread, tol=1e-9, hermitian=True))
    chi2 = float(off @ np.linalg.pinv(spread, rcond=1e-9, hermitian=True) @ off)
    return SimpleConstants(tuple(offers), chi2, freedom, chi2 <= chi_square_cutoff(freedom))


def _expected(question: _Question) -> float:
    """Expected number of list entries in an interval by chance."""
    if question.lower * question.upper <= 0.0:
        return math.inf
    size = abs(question.estimate)
    near = sum(0.5 * size < x < 2.0 * size for x in _NUMBERS.values())
    return near * abs(math.log(question.upper / question.lower)) / _WINDOW


def _offer(question: _Question, expected: float) -> Offer | None:
    """The number of the list in an interval, if there is one."""
    low, high = sorted((abs(question.lower), abs(question.upper)))
    size, sign = abs(question.estimate), math.copysign(1.0, question.estimate)
    inside = [(abs(x - size), text) for text, x in _NUMBERS.items() if low <= x <= high]
    if not inside or not math.isfinite(expected):
        return None
    text = min(inside)[1]
    q = question
    interval = q.estimate, q.standard_error, q.lower, q.upper
    shown = text if sign > 0 else f"-{text}"
    return Offer(q.subject, q.reference, *interval, sign * _NUMBERS[text], shown, expected)


def _direct(model: LagrangianModel) -> list[_Question]:
    """The coefficients and the shape parameters."""
    both = (*model.terms, *model.dissipation, *(shape.as_term() for shape in model.shapes))
    unit = np.eye(len(both))
    return [
        _Question(
            t.written, "", t.coefficient, t.standard_error, t.lower, t.upper, unit[k], np.zeros(len(both))
        )
        for k, t in enumerate(both)
        if t.standard_error > 0 and not t.known
    ]


def _ratios(model: LagrangianModel, covariance: np.ndarray) -> list[_Question]:
    """Ratios of terms that scale alike."""
    both = (*model.terms, *model.dissipation)
    unit = np.eye(len(covariance))
    values = values_of(model)
    usable = [t.known or t.standard_error > 0 for t in both]
    relative = np.sqrt(np.diag(covariance))[: len(both)] / np.abs(values[: len(both)])
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, scaling in enumerate(_scalings(model)):
        if scaling is not None and usable[k] and values[k] != 0.0:
            alike.setdefault(scaling, []).append(k)
    questions: list[_Question] = []
    for members in alike.values():
        first = min(members, key=lambda k: (not both[k].known, relative[k], k))
        for k in members:
            if k == first or both[k].known:
                continue
            ratio = float(values[k] / values[first])
            slope = unit[k] / values[k] - unit[first] / values[first]
            error = abs(ratio) * math.sqrt(max(float(slope @ covariance @ slope), 0.0))
            if error > 0.0:
                ends = ratio - Z95 * error, ratio + Z95 * error
                names = both[k].written, both[first].written
                questions.append(_Question(*names, ratio, error, *ends, unit[k], unit[first]))
    return questions


def _scalings(model: LagrangianModel) -> list[tuple[object, ...] | None]:
    """Powers with which each term scales with the units of position and time; None if it is not a power."""
    names = model.coordinates
    angles = angles_in(names, model.provenance)
    points = Points.draw(np.random.default_rng(0), len(names), 12)
    grown = np.array([[1.0 if name in angles else 1.5] for name in names])
    states = (
        points,
        Points(points.q * grown, points.qdot * grown, points.qddot, points.times),
        Points(points.q, points.qdot * 1.5, points.qddot, points.times),
    )
    jets = [Jets(names, state) for state in states]
    out: list[tuple[object, ...] | None] = []
    groups = ((model.expressions, "lagrangian"), (model.dissipation_expressions, "dissipation"))
    for expr, kind in ((expr, kind) for expressions, kind in groups for expr in expressions):
        values = np.array([jet.jet(expr)[0] for jet in jets])
        values = values[:, np.isfinite(values).all(axis=0) & (values != 0.0).all(axis=0)]
        degrees = np.log(np.abs(values[1:] / values[0])) / math.log(1.5)
        steady = degrees.size and bool(np.all(np.ptp(degrees, axis=1) < _SAME))
        out.append((kind, *(round(float(d), 6) for d in degrees[:, 0])) if steady else None)
    return out
