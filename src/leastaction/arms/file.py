"""Models of arms as JSON files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np

from leastaction.arms.base import find_base
from leastaction.arms.model import ArmModel, FitFacts
from leastaction.data.formats.atomic import check_path, read_bytes, write_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.tree import Joint, KinematicTree
from leastaction.mechanics.arm_columns import ArmTerm

__all__ = ["from_dict", "load", "save", "to_dict"]

_SCHEMA = 1


def to_dict(model: ArmModel) -> dict[str, Any]:
    """The model as plain data."""
    tree = model.tree
    return {
        "schema": _SCHEMA,
        "kind": "arm",
        "tree": {
            "name": tree.name,
            "gravity": tree.gravity.tolist(),
            "joints": [_plain(joint) for joint in tree.joints],
        },
        "terms": [asdict(term) for term in model.base.terms],
        "members": list(model.base.members),
        "coefficients": model.coefficients.tolist(),
        "covariance": model.covariance.tolist(),
        "reference": model.reference.tolist(),
        "fit": asdict(model.facts),
    }


def from_dict(given: Mapping[str, Any]) -> ArmModel:
    """The model of `to_dict`.

    Raises
    ------
    InputError
        If the data do not have that form.
    """
    if given.get("schema") != _SCHEMA or given.get("kind") != "arm":
        raise InputError(
            f"the file holds {quoted(given.get('kind'))} of schema {quoted(given.get('schema'))}; expected "
            f"an arm of schema {_SCHEMA}, as `leastaction arm` writes it"
        )
    try:
        parts = given["tree"]
        joints = tuple(Joint(**{key: _array(value) for key, value in row.items()}) for row in parts["joints"])
        tree = KinematicTree(joints, np.array(parts["gravity"], float), str(parts["name"]))
        terms = tuple(ArmTerm(**row) for row in given["terms"])
        facts = cast(Any, {key: _tuple(value) for key, value in given["fit"].items()})
        coefficients, covariance, reference = (
            np.array(given[key], float) for key in ("coefficients", "covariance", "reference")
        )
        base = find_base(tree, terms).subset(given["members"])
        size = len(base.members)
        if coefficients.shape != (size,) or covariance.shape != (size, size):
            raise ValueError("the number of coefficients")
        return ArmModel(tree, base, coefficients, covariance, reference, FitFacts(**facts))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"the file holds no arm: {quoted(str(error))} is not as expected") from None


def save(model: ArmModel, path: str | Path) -> None:
    """Write a model to a JSON file."""
    write_bytes(path, (json.dumps(to_dict(model), indent=1) + "\n").encode())


def load(path: str | Path) -> ArmModel:
    """Read a model that `ArmModel.save` has written.

    Raises
    ------
    InputError
        If the file cannot be read or holds no arm.
    """
    try:
        given: Any = json.loads(read_bytes(check_path(path)))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path} is not JSON: {error}; give a file that ArmModel.save has written") from None
    if not isinstance(given, dict):
        raise InputError(f"{path} holds no arm; give a file that ArmModel.save has written")
    return from_dict(cast(dict[str, Any], given))


def _list(values: Any) -> Any:
    return values.tolist()


def _plain(joint: Joint) -> dict[str, Any]:
    given: dict[str, Any] = vars(joint)
    out = {key: _list(value) if hasattr(value, "tolist") else value for key, value in given.items()}
    if joint.limits is not None:  # JSON has no NaN
        out["limits"] = [None if np.isnan(x) else x for x in joint.limits.tolist()]
    return out


def _array(value: Any) -> Any:
    return np.array(value, float) if isinstance(value, list) else value


def _tuple(value: Any) -> Any:
    return tuple(cast(list[Any], value)) if isinstance(value, list) else value
