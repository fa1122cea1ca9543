"""Every reported fit is the fit of its own structure: nothing of the search is left in its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from set_ups import SET_UPS, fresh, searched


@pytest.mark.parametrize("name", SET_UPS)
def test_a_report_equals_a_fresh_fit_of_its_structure(name):
    search = searched(name)
    fit = search.found
    again = fresh(search)
    assert fit.converged
    assert again.converged
    moved = np.abs(again.estimates - fit.estimates) / fit.standard_errors
    assert moved.max() < 0.05, dict(zip(fit.structure, moved, strict=True))
    np.testing.assert_allclose(fit.coefficients[list(fit.problem.excluded)], 0.0)
    known = fit.problem.is_known
    np.testing.assert_array_equal(fit.coefficients[known], fit.problem.known[known])
