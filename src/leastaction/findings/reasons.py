"""Why a structure of the trade-off curve was not chosen: code → words, as they follow "because"."""

from __future__ import annotations

import math

__all__ = ["REASONS", "because"]

REASONS = {
    "chosen": "",
    "fits-worse": "it fits the data worse",
    "not-worth-its-terms": "its further terms improve the fit by less than their price",
    "irrelevant": "its further terms remove less than {share} of the equation error each",
    "no-fit": "its own fit does not converge",
    "fit-is-worse": "its own fit does not bear out what the quadratic model promises",
    "fit-is-better": "the search ended before it: by its own fit it is the better one",
    "not-fitted": "only the quadratic model prefers it, and its own fit was not made",
}
"""The codes are those of `leastaction.selection.alternatives.Alternative`."""


def because(reason: str, relevance: float | None = None) -> str:
    """Words for a reason; empty for a code that nobody knows.

    Parameters
    ----------
    reason : str
        One of `REASONS`.
    relevance : float, optional
        Share of the equation error that a term had to remove to stay.

    Examples
    --------
    >>> because("fits-worse")
    'it fits the data worse'
    >>> because("irrelevant", 0.05)
    'its further terms remove less than 5 % of the equation error each'
    """
    share = "the relevant share"
    if relevance is not None and math.isfinite(relevance):
        share = f"{100.0 * relevance:g} %"
    return REASONS.get(reason, "").format(share=share)
