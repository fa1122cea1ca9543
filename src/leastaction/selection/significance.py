r"""One false-alarm rate for every likelihood-ratio test of the package.

Where a hypothesis with d parameters more is wrong, −2 log of the likelihood ratio follows χ² with d degrees
of freedom (Wilks 1938, Ann. Math. Statist. 9:60). A question that is asked in m tests is answered wrongly
with probability α at most if each is made at the level (Šidák 1967, J. Am. Stat. Assoc. 62:626)

.. math:: 1 - (1 - \alpha)^{1/m},

which bounds the error for tests that depend on each other, too, if they are Gaussian. α is
``SELECTION.false_alarm``: the chance that one check of one correct recording raises a doubt.
"""

from __future__ import annotations

import math

from scipy.special import chdtri, ndtri

from leastaction.selection.settings import SELECTION

__all__ = ["chi_square_cutoff", "normal_cutoff"]


def chi_square_cutoff(parameters: int = 1, tests: int = 1) -> float:
    """Drop of −2 log likelihood that further parameters reach by chance at the false-alarm rate.

    Parameters
    ----------
    parameters : int
        That the larger hypothesis has more, d.
    tests : int
        Hypotheses that are tried, m.

    Examples
    --------
    >>> round(chi_square_cutoff(), 1), round(chi_square_cutoff(2), 1), round(chi_square_cutoff(1, 40), 1)
    (10.8, 13.8, 17.8)
    """
    return float(chdtri(parameters, _level(tests)))


def normal_cutoff(tests: int = 1) -> float:
    """Standard errors by which an estimate passes zero on one side by chance at the false-alarm rate.

    Examples
    --------
    >>> round(normal_cutoff(), 2)
    3.09
    """
    return float(-ndtri(_level(tests)))


def _level(tests: int) -> float:
    """The level of each test."""
    return -math.expm1(math.log1p(-SELECTION.false_alarm) / max(tests, 1))
