"""The runner of the tests under several kernels: which it leaves out, and why."""

from __future__ import annotations

import os

import pytest

import kernels


@pytest.mark.parametrize(
    ("kernel", "usual", "now", "says"),
    [
        ("Haswell", {"SkylakeX"}, {"Haswell"}, ""),
        ("Haswell", {"Haswell"}, {"Haswell"}, "without being asked"),
        ("Zen", {"SkylakeX"}, {"Haswell"}, "uses Haswell instead"),
        ("SkylakeX", {"Haswell"}, set(), "uses nothing instead"),
        ("Haswell", {None}, {None}, "does not use OpenBLAS"),
        ("Haswell", {None, "Haswell"}, {None, "Haswell"}, "does not use OpenBLAS"),
        ("Haswell", set(), set(), "does not use OpenBLAS"),
    ],
)
def test_why_a_kernel_is_left_out(kernel, usual, now, says):
    reason = kernels.reason_to_skip(kernel, usual, now)
    assert (says in reason) if says else not reason


def test_a_kernel_that_nobody_has_is_skipped_and_runs_no_test(capfd):
    assert kernels.main(["Abacus", "--", "--no-such-option"]) == 0
    assert "kernel Abacus: skipped" in capfd.readouterr().out


def test_the_kernel_asked_for_is_the_one_in_use():
    usual = kernels.kernels_in_use(os.environ)
    if None in usual or not usual:
        pytest.skip("no OpenBLAS")
    (name,) = usual
    assert kernels.kernels_in_use({**os.environ, "OPENBLAS_CORETYPE": str(name)}) == usual


def test_what_is_listed_exists():
    listed = [kernels.ROOT / "tests" / name for name in kernels.FOLDERS]
    listed += [kernels.ROOT / "tests" / f"test_{name}.py" for name in kernels.MODULES]
    assert [path for path in listed if not path.exists()] == []
