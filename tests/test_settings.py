"""Thresholds that decide: one frozen object a package, every value documented and in use."""

import ast
import dataclasses
import inspect
import itertools
from pathlib import Path

import pytest

import leastaction
from leastaction.curve.settings import CURVE
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.settings import ESTIMATION
from leastaction.selection.settings import SELECTION

SETTINGS = {"CURVE": CURVE, "ESTIMATION": ESTIMATION, "SELECTION": SELECTION, "DIAGNOSIS": DIAGNOSIS}


def _documented(settings) -> set[str]:
    """Names of the fields that are followed by a text."""
    body = ast.parse(inspect.getsource(type(settings))).body[0].body
    return {
        field.target.id
        for field, text in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_are_frozen_documented_and_used(name):
    settings = SETTINGS[name]
    fields = {field.name for field in dataclasses.fields(settings)}
    assert _documented(settings) == fields
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(settings, next(iter(fields)), 0.0)
    source = "".join(path.read_text("utf-8") for path in Path(leastaction.__file__).parent.rglob("*.py"))
    assert not [field for field in fields if f"{name}.{field}" not in source]
