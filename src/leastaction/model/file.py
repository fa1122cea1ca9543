"""Reading and writing of model files: JSON, checked against a schema.

Schema 2, where ``null`` stands for "not available"::

    {"schema": 2,
     "coordinates": ["theta1", ...],
     "terms": [{"expression": "theta1_dot**2", "coefficient": 0.5,
                "standard_error": number or null, "known": false}, ...],
     "dissipation": [the same],
     "noise_std": [number or null for each coordinate],
     "fit": {"status": "ok", "usable" or "doubtful", "chi2_per_sample": number or null,
             "physics_weight": [number or null for each coordinate, or nothing],
             "error_spectrum": [[frequency, number for each coordinate], ...],       optional
             "findings": [{"code": text, "severity": "warning" or "note", "subject": [text, ...],
                           "values": {text: number, text, null or a list of these},
                           "message": text, "remedy": text}, ...],
             "warnings": [text, ...], "statements": {text: text}},
     "provenance": {anything that is JSON: version, options, hash of the data},
     "shapes": [{"name": text, "value": number, "standard_error": number or null,
                 "profile": [[number, rise of −2 log likelihood], ...]}, ...],     profile: optional
     "groups": {"names": [text, ...],   of groups of trials; the terms above are those of the first
                "differences": [{"expression": text, "kind": "lagrangian" or "dissipation", "group": text,
                                 "difference": number, "standard_error": number or null}, ...],
                "trials": [text, ...],      the group of each; optional
                "covariance": [[...], ...]},       of the free coefficients, then of the differences; optional
     "calibration": {"functions": [text, ...], "noise_std": [number, ...],     of measured columns
                     "numbers": [{"name": text, "value": number, "standard_error": number or null}, ...],
                     "covariance": [[...], ...]},       of the free coefficients, then of these; optional
     "covariance": [[...], ...]}        of the free coefficients, terms before dissipation, then shapes

``shapes``, ``groups``, ``calibration`` and ``covariance`` may be left out; a term may have a ``"template"``,
its expression with shape parameters in braces.

``fit.warnings`` repeats the warnings as sentences, and ``fit.statements`` summarises the verdicts on
structure, equations and forecast, for scripts that need no more. Neither is read.  Schema 1 had warnings
alone, whose sentences become findings with the code ``text``.

Numbers are finite; expressions are read by `leastaction.library.parse_expression`, never evaluated.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from leastaction.data.formats.atomic import check_path, read_bytes
from leastaction.errors import InputError
from leastaction.findings import Finding
from leastaction.identifiers import quoted
from leastaction.kinds import is_array, is_collection, is_list, is_mapping, is_scalar
from leastaction.model.calibration import Calibration
from leastaction.model.groups import Groups
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter, as_float

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["MAX_BYTES", "MAX_TERMS", "SCHEMA", "encode", "fields", "load", "parse", "plain_json", "to_text"]

SCHEMA = 2
MAX_BYTES = 10_000_000
MAX_TERMS = 1000
_MAX_COORDINATES = 64
_MAX_DEPTH = 20
_REQUIRED = ("schema", "coordinates", "terms", "dissipation", "noise_std", "fit", "provenance")


def encode(model: LagrangianModel) -> dict[str, Any]:
    """Return the model as plain dictionaries, lists, text and finite numbers."""
    spectrum = model.fit.error_spectrum
    document = {
        "schema": SCHEMA,
        "coordinates": list(model.coordinates),
        "terms": [_encode_term(term) for term in model.terms],
        "dissipation": [_encode_term(term) for term in model.dissipation],
        "noise_std": [_number_or_none(x) for x in model.noise_std],
        "fit": {
            "status": model.fit.status,
            "chi2_per_sample": _number_or_none(model.fit.chi2_per_sample),
            "physics_weight": [_number_or_none(w) for w in model.fit.physics_weight],
            "findings": [finding.to_dict() for finding in model.fit.findings],
            **({"error_spectrum": [[*row] for row in spectrum]} if spectrum else {}),
            "warnings": [str(f) for f in model.fit.findings if f.severity == "warning"],
            "statements": model.fit.statements,
        },
        "provenance": plain_json(model.provenance, "provenance"),
    }
    if model.shapes:
        document["shapes"] = [_encode_shape(shape) for shape in model.shapes]
    if model.groups is not None:
        document["groups"] = model.groups.to_dict()
    if model.calibration is not None:
        document["calibration"] = model.calibration.to_dict()
    if model.covariance is not None:
        document["covariance"] = model.covariance.tolist()
    return document


def _encode_term(term: ModelTerm) -> dict[str, Any]:
    return {
        "expression": term.expression,
        "coefficient": term.coefficient,
        "standard_error": _number_or_none(term.standard_error),
        "known": term.known,
        **({"template": term.template} if term.template else {}),
    }


def _encode_shape(shape: ShapeParameter) -> dict[str, Any]:
    return {
        "name": shape.name,
        "value": shape.value,
        "standard_error": _number_or_none(shape.standard_error),
        **({"profile": [list(pair) for pair in shape.profile]} if shape.profile else {}),
    }


def _number_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def plain_json(value: Any, place: str, depth: int = 0) -> Any:
    """Return a copy with JSON types; NumPy types become plain, and non-finite numbers None.

    Raises
    ------
    InputError
        If a value cannot be written as JSON.
    """
    if depth > _MAX_DEPTH:
        raise InputError(f"{place} is nested more than {_MAX_DEPTH} levels deep; make it flatter")
    if is_scalar(value):
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, str):
        return str(value)
    if isinstance(value, float):
        return _number_or_none(value)
    if isinstance(value, os.PathLike):
        return f"{value}"
    if is_array(value):
        return plain_json(value.tolist(), place, depth)
    if is_mapping(value):
        for key in value:
            if not isinstance(key, str):
                raise InputError(f"{place} has the key {quoted(key)}; expected text")
        return {str(k): plain_json(v, f"{place}.{k[:40]}", depth + 1) for k, v in value.items()}
    if is_collection(value):
        items = value if is_list(value) else sorted(value, key=str)
        return [plain_json(item, f"{place}[{i}]", depth + 1) for i, item in enumerate(items)]
    raise InputError(
        f"{place} is of type {type(value).__name__}, which JSON cannot hold; use text, numbers, lists and "
        "dictionaries"
    )


def to_text(document: Mapping[str, Any]) -> str:
    """Return a document as standard JSON text."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def load(path: str | os.PathLike[str]) -> LagrangianModel:
    """Read a model written by `LagrangianModel.save`. Everything in the file is checked.

    Raises
    ------
    InputError
        If the file is not a model of this or an older version; the text names the file and the place.
    """
    from leastaction.model.model import LagrangianModel  # circular import

    file = check_path(path)
    return LagrangianModel.from_dict(parse(read_bytes(file, MAX_BYTES + 1), str(file)), os.fspath(path))


def parse(data: bytes, file: str) -> Any:
    """Read the content of a file as strict JSON, without a check against the schema.

    Raises
    ------
    InputError
        If it is larger than 10 MB, or not JSON; the text names the file.
    """
    if len(data) > MAX_BYTES:
        raise InputError(f"{file} is larger than {MAX_BYTES // 10**6} MB; a file with a model is far smaller")
    try:
        text = data.decode("utf-8-sig")
        document = json.loads(text, object_pairs_hook=_object, parse_constant=_refuse_constant)
        _check_depth(document)
        return document
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InputError(
            f"{file}: {where}: not valid JSON ({error.msg}); the file may be cut short, write it again"
        ) from None
    except UnicodeDecodeError as error:
        raise InputError(f"{file} is not UTF-8 text (byte {error.start}); expected a model in JSON") from None
    except RecursionError:
        raise InputError(f"{file} is nested too deeply; expected a model in JSON") from None
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except ValueError:
        # Python refuses integers with thousands of digits.
        raise InputError(f"{file} contains a number with too many digits; expected a model in JSON") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"the entry {quoted(twice)} occurs twice in one object; keep one of them")
    return out


def _check_depth(document: Any) -> None:
    """Refuse a document that is nested too deeply to be quoted in a message."""
    level: list[Any] = [document]
    for _ in range(_MAX_DEPTH + 10):
        level = [x for item in level for x in _inside(item)]
        if not level:
            return
    raise RecursionError


def _inside(item: Any) -> Sequence[Any]:
    if is_mapping(item):
        return list(item.values())
    return item if is_list(item) else ()


def _refuse_constant(name: str) -> None:
    raise InputError(f"{name} is not a number in JSON; use null for a value that is not available")


def fields(document: Any) -> dict[str, Any]:
    """Check a document against the schema and return the arguments of LagrangianModel.

    Raises
    ------
    InputError
        With the place in the document, what was expected and the cure.
    """
    if not is_mapping(document) or "schema" not in document:
        raise InputError("this is not a leastaction model: expected an object with the entry 'schema'")
    _check_schema(document["schema"])
    _check_entries(document, "the model", _REQUIRED, ("covariance", "shapes", "groups", "calibration"))
    coordinates = _list(document["coordinates"], "coordinates", _MAX_COORDINATES)
    for i, name in enumerate(coordinates):
        _text(name, f"coordinates[{i}]")
    provenance = document["provenance"]
    if not is_mapping(provenance):
        raise InputError(f"provenance is {quoted(provenance)}; expected an object")
    return {
        "coordinates": tuple(coordinates),
        "terms": _terms(document["terms"], "terms"),
        "dissipation": _terms(document["dissipation"], "dissipation"),
        "covariance": _matrix(document.get("covariance")),
        "noise_std": _numbers(document["noise_std"], "noise_std"),
        "fit": _fit(document["fit"], document["schema"]),
        "provenance": plain_json(provenance, "provenance"),
        "shapes": _shapes(document.get("shapes", [])),
        "calibration": None
        if document.get("calibration") is None
        else Calibration.from_dict(document["calibration"], tuple(coordinates)),
        "groups": None
        if document.get("groups") is None
        else Groups.from_dict(document["groups"], 2 * MAX_TERMS),
    }


def _shapes(value: Any) -> tuple[ShapeParameter, ...]:
    out: list[ShapeParameter] = []
    for i, item in enumerate(_list(value, "shapes", MAX_TERMS)):
        place = f"shapes[{i}]"
        _check_entries(item, place, ("name", "value", "standard_error"), ("profile",))
        error = _number(item["standard_error"], f"{place}.standard_error", nullable=True, least=0.0)
        try:
            value = _number(item["value"], f"{place}.value")
            out.append(ShapeParameter(item["name"], value, error, item.get("profile", ())))
        except InputError as problem:
            raise InputError(f"{place}: {problem}") from None
    return tuple(out)


def _check_schema(schema: Any) -> None:
    if isinstance(schema, bool) or not isinstance(schema, int) or schema < 1:
        raise InputError(f"schema is {quoted(schema)}; expected a whole number up to {SCHEMA}")
    if schema > SCHEMA:
        raise InputError(
            f"schema {quoted(schema)} was made by a newer version of leastaction (this one reads {SCHEMA}); "
            "upgrade leastaction"
        )


def _check_entries(value: Any, place: str, required: Sequence[str], optional: Sequence[str] = ()) -> None:
    if not is_mapping(value):
        raise InputError(f"{place} is {quoted(value)}; expected an object with {', '.join(required)}")
    for name in required:
        if name not in value:
            raise InputError(f"{place} has no entry {name!r}; the file may be cut short")
    for name in value:
        if name not in required and name not in optional:
            raise InputError(f"{place} has the unknown entry {quoted(name)}; expected {', '.join(required)}")


def _list(value: Any, place: str, limit: int) -> list[Any]:
    if not is_list(value):
        raise InputError(f"{place} is {quoted(value)}; expected a list")
    if len(value) > limit:
        raise InputError(f"{place} has {len(value)} entries; expected at most {limit}")
    return list(value)


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{place} is {quoted(value)}; expected text")
    return value


def _numbers(value: Any, place: str) -> tuple[float, ...]:
    items = _list(value, place, _MAX_COORDINATES)
    return tuple(_number(x, f"{place}[{i}]", nullable=True) for i, x in enumerate(items))


def _number(value: Any, place: str, nullable: bool = False, least: float = -math.inf) -> float:
    if value is None and nullable:
        return math.nan
    # null is the only code for "not available"; a number that overflows to infinity is an error.
    return as_float(value, place, least=least)


def _terms(value: Any, place: str) -> tuple[ModelTerm, ...]:
    return tuple(_term(item, f"{place}[{i}]") for i, item in enumerate(_list(value, place, MAX_TERMS)))


def _term(value: Any, place: str) -> ModelTerm:
    _check_entries(value, place, ("expression", "coefficient", "standard_error", "known"), ("template",))
    known = value["known"]
    if not isinstance(known, bool):
        raise InputError(f"{place}.known is {quoted(known)}; expected true or false")
    expression = _text(value["expression"], f"{place}.expression")
    coefficient = _number(value["coefficient"], f"{place}.coefficient")
    error = _number(value["standard_error"], f"{place}.standard_error", nullable=True, least=0.0)
    try:
        return ModelTerm(expression, coefficient, error, known, _text(value.get("template", ""), place))
    except InputError as problem:
        raise InputError(f"{place}: {problem}") from None


def _fit(value: Any, schema: int) -> FitSummary:
    required = ("status", "chi2_per_sample", "physics_weight", "warnings")
    _check_entries(
        value, "fit", required if schema == 1 else (*required, "findings"), ("statements", "error_spectrum")
    )
    warnings = [
        _text(w, f"fit.warnings[{i}]")
        for i, w in enumerate(_list(value["warnings"], "fit.warnings", MAX_TERMS))
    ]
    found = _list(value.get("findings", []), "fit.findings", MAX_TERMS)
    return FitSummary(
        value["status"],
        _number(value["chi2_per_sample"], "fit.chi2_per_sample", nullable=True),
        _numbers(value["physics_weight"], "fit.physics_weight"),
        warnings if schema == 1 else None,
        [Finding.from_dict(item, f"fit.findings[{i}]") for i, item in enumerate(found)],
        _list(value.get("error_spectrum", []), "fit.error_spectrum", MAX_TERMS),
    )


def _matrix(value: Any) -> np.ndarray | None:
    if value is None:
        return None
    lines = enumerate(_list(value, "covariance", 2 * MAX_TERMS))
    rows = [_list(row, f"covariance[{i}]", 2 * MAX_TERMS) for i, row in lines]
    for i, row in enumerate(rows):
        if len(row) != len(rows):
            raise InputError(
                f"covariance[{i}] has {len(row)} entries; expected {len(rows)}, the number of rows"
            )
    numbers = [[_number(x, f"covariance[{i}][{j}]") for j, x in enumerate(row)] for i, row in enumerate(rows)]
    return np.array(numbers, dtype=float).reshape(len(rows), len(rows))
