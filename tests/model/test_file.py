from __future__ import annotations

import copy
import json
import os
from dataclasses import replace

import numpy as np
import pytest

from leastaction.errors import InputError
from leastaction.findings import Finding, find
from leastaction.model.file import MAX_BYTES, MAX_TERMS, load
from leastaction.model.model import FitSummary, LagrangianModel, ModelTerm


def pendulum():
    return LagrangianModel(
        ["theta", "φ"],
        [ModelTerm("theta_dot**2 + φ_dot**2", 0.1 + 0.2, 0.01), ModelTerm("cos(theta)", 9.81, known=True)],
        [ModelTerm("abs(theta_dot)", 0.02, float("nan"))],
        covariance=[[1e-4, 1e-6], [1e-6, 3e-4]],
        noise_std=[0.001, np.nan],
        fit=FitSummary("doubtful", np.inf, [1e6, np.nan], ["the library\ncannot explain the data"]),
        provenance={
            "version": "0.1.0",
            "options": {"angles": ("theta",), "seed": np.int64(3)},
            "w": np.float64("nan"),
        },
    )


@pytest.fixture
def document():
    return pendulum().to_dict()


def test_round_trip(tmp_path):
    model = pendulum()
    model.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.to_dict() == model.to_dict()
    assert again.terms == model.terms
    assert again.coordinates == ("theta", "φ")
    assert np.isnan(again.dissipation[0].standard_error)
    assert np.isnan(again.noise_std[1])
    assert again.diagnostics is None
    np.testing.assert_array_equal(again.covariance, model.covariance)
    assert again.provenance == {"version": "0.1.0", "options": {"angles": ["theta"], "seed": 3}, "w": None}
    assert os.listdir(tmp_path) == ["model.json"]


# as version 0.1.0 wrote it
SCHEMA_1 = """{
 "schema": 1,
 "coordinates": ["x"],
 "terms": [
  {"expression": "x_dot**2", "coefficient": 0.5, "standard_error": 0.0, "known": true},
  {"expression": "x**2", "coefficient": -2.0, "standard_error": 0.01, "known": false}
 ],
 "dissipation": [],
 "noise_std": [0.01],
 "fit": {
  "status": "doubtful",
  "chi2_per_sample": 1.4,
  "physics_weight": [1200.0],
  "warnings": ["the library seems to lack x**4: with it, 2 free terms explain the motion; add it"]
 },
 "provenance": {"version": "0.1.0"},
 "covariance": [[0.0001]]
}
"""


def test_a_file_of_schema_1_is_read_and_written_as_schema_2(tmp_path):
    (tmp_path / "old.json").write_text(SCHEMA_1, encoding="utf-8")
    old = load(tmp_path / "old.json")
    sentence = json.loads(SCHEMA_1)["fit"]["warnings"][0]
    assert old.fit.warnings == (sentence,)
    assert old.fit.findings == (Finding("text", "warning", message=sentence),)
    old.save(tmp_path / "new.json")
    new = json.loads((tmp_path / "new.json").read_text(encoding="utf-8"))
    assert new["schema"] == 2
    assert new["fit"]["warnings"] == [sentence]
    assert [finding["code"] for finding in new["fit"]["findings"]] == ["text"]
    assert load(tmp_path / "new.json").fit == old.fit
    stale = json.loads(SCHEMA_1)
    stale["fit"]["findings"] = []  # that schema has none
    with pytest.raises(InputError, match="fit has the unknown entry 'findings'"):
        LagrangianModel.from_dict(stale)


def test_findings_are_kept_in_the_file_and_warnings_are_read_off_them(tmp_path):
    findings = (find("late-forces", delay=0.03, half_a_sample=False, gain=90.0), find("knots-not-settled"))
    fit = FitSummary("doubtful", 1.0, [1.0, 1.0], findings=findings)
    replace(pendulum(), fit=fit).save(tmp_path / "model.json")
    document = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))
    assert document["fit"]["warnings"] == [str(findings[0])]
    assert document["fit"]["findings"][0]["values"] == {"delay": 0.03, "half_a_sample": False, "gain": 90.0}
    document["fit"]["warnings"] = ["changed by hand"]
    again = LagrangianModel.from_dict(document).fit
    assert again.findings == findings
    assert again.warnings == (str(findings[0]),)
    assert again.notes == (str(findings[1]),)


def test_schema_of_the_file(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)

    def refuse(name):
        raise AssertionError(name)

    saved = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    expected = [
        "schema",
        "coordinates",
        "terms",
        "dissipation",
        "noise_std",
        "fit",
        "provenance",
        "covariance",
    ]
    assert list(saved) == expected
    assert saved["schema"] == 2
    term = {"expression": "cos(theta)", "coefficient": 9.81, "standard_error": 0.0, "known": True}
    assert saved["terms"][1] == term
    assert saved["dissipation"][0]["standard_error"] is None
    fit = {"status": "doubtful", "chi2_per_sample": None, "physics_weight": [1e6, None]}
    assert {k: saved["fit"][k] for k in fit} == fit


def test_covariance_is_optional(document):
    del document["covariance"]
    assert LagrangianModel.from_dict(document).covariance is None


def test_a_failing_save_leaves_the_old_file(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)
    before = path.read_bytes()
    bad = LagrangianModel("x", [ModelTerm("x_dot**2", 1.0)], provenance={"options": {"f": print}})
    with pytest.raises(InputError, match=r"provenance.options.f is of type builtin_function"):
        bad.save(path)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="is a directory"):
        pendulum().save(tmp_path)


@pytest.mark.parametrize("provenance", [{1: 2}, {"a": {"b": b"bytes"}}, {"a": [[[[]]] * 3]} | {"b": 1j}])
def test_provenance_must_be_json(provenance):
    with pytest.raises(InputError, match="provenance"):
        LagrangianModel("x", [ModelTerm("x_dot**2", 1.0)], provenance=provenance).to_dict()


def put(path, value):
    def change(document):
        *parents, last = path
        for key in parents:
            document = document[key]
        document[last] = value

    return change


def drop(*path):
    def change(document):
        *parents, last = path
        for key in parents:
            document = document[key]
        del document[last]

    return change


def nested(depth):
    value = 0
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put(["schema"], 3), "newer version of leastaction .* upgrade"),
        (put(["schema"], True), "schema is True; expected a whole number up to 2"),
        (put(["schema"], "1"), "schema is '1'"),
        (drop("schema"), "not a leastaction model"),
        (drop("terms"), "no entry 'terms'"),
        (put(["more"], 1), "unknown entry 'more'"),
        (put(["coordinates"], "theta"), "coordinates is 'theta'; expected a list"),
        (put(["coordinates"], []), "coordinates is empty"),
        (put(["coordinates"], [1, 2]), r"coordinates\[0\] is 1; expected text"),
        (put(["coordinates"], ["__class__", "b"]), "coordinate name '__class__'"),
        (put(["coordinates"], ["theta; import os", "b"]), "is not a name"),
        (put(["coordinates"], ["a" * 10**6, "b"]), "too long"),
        (put(["coordinates"], [f"a{i}" for i in range(1000)]), "at most 64"),
        (put(["coordinates"], ["theta", "φ", "x"]), "physics_weight has 2"),
        (put(["terms"], {}), "terms is {}; expected a list"),
        (put(["terms"], []), "terms is empty"),
        (put(["terms"], [3]), r"terms\[0\] is 3; expected an object"),
        (put(["terms"], [{}] * (MAX_TERMS + 1)), "at most 1000"),
        (drop("terms", 0, "known"), r"terms\[0\] has no entry 'known'"),
        (put(["terms", 0, "extra"], 1), r"terms\[0\] has the unknown entry 'extra'"),
        (put(["terms", 0, "known"], 0), r"terms\[0\].known is 0; expected true or false"),
        (put(["terms", 1, "coefficient"], "1.0"), r"terms\[1\].coefficient is '1.0'; expected a number"),
        (put(["terms", 1, "coefficient"], None), r"terms\[1\].coefficient is None"),
        (put(["terms", 1, "coefficient"], True), r"terms\[1\].coefficient is True"),
        (put(["terms", 1, "coefficient"], float("nan")), "finite"),
        (put(["terms", 1, "coefficient"], 10**400), "finite"),
        (put(["terms", 1, "standard_error"], 0.1), r"terms\[1\]: .*known coefficient"),
        (put(["terms", 0, "standard_error"], -0.1), "at least 0"),
        (put(["terms", 0, "expression"], ["x"]), r"terms\[0\].expression is \['x'\]; expected text"),
        (put(["terms", 0, "expression"], "__import__('os').system('x')"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "theta.__class__"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "theta[0]"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "open(theta)"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "lambda: theta"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "9**9**9**9"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "(" * 5000 + "theta" + ")" * 5000), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "cos(theta)"), "is the same as"),
        (put(["dissipation", 0, "expression"], "psi"), r"dissipation\[0\]: .*'psi'"),
        (put(["noise_std"], [0.1]), "noise_std has shape"),
        (put(["noise_std", 0], "a"), r"noise_std\[0\] is 'a'"),
        (put(["fit"], []), "fit is"),
        (put(["fit", "status"], "fine"), "'ok', 'usable' or 'doubtful'"),
        (put(["fit", "status"], ["ok"]), "'ok', 'usable' or 'doubtful'"),
        (put(["fit", "chi2_per_sample"], "1"), "fit.chi2_per_sample"),
        (put(["fit", "physics_weight"], [1.0]), "physics_weight has 1"),
        (put(["fit", "warnings"], "text"), "fit.warnings is 'text'; expected a list"),
        (put(["fit", "warnings"], [1]), r"fit.warnings\[0\] is 1; expected text"),
        (put(["fit", "findings"], "text"), "fit.findings is 'text'; expected a list"),
        (put(["fit", "findings"], ["text"]), r"fit.findings\[0\] is 'text'; expected an object with code"),
        (put(["fit", "findings", 0, "code"], "Not a code"), r"fit.findings\[0\]: the code is 'Not a code'"),
        (put(["fit", "findings", 0, "severity"], "fatal"), r"fit.findings\[0\]: the severity is 'fatal'"),
        (put(["fit", "findings", 0, "subject"], "x"), r"fit.findings\[0\].subject is 'x'; expected a list"),
        (put(["fit", "findings", 0, "subject"], [1]), r"fit.findings\[0\]: subject\[0\] is 1; expected text"),
        (
            put(["fit", "findings", 0, "values"], [1]),
            r"findings\[0\]: values is \[1\]; expected a mapping",
        ),
        (
            put(["fit", "findings", 0, "values", "a"], {}),
            r"findings\[0\]: values.a is {}; expected",
        ),
        (put(["fit", "findings", 0, "values", "a"], [[1]]), r"fit.findings\[0\]: values.a\[0\] is \[1\]"),
        (put(["fit", "findings", 0, "message"], None), r"fit.findings\[0\]: message is None; expected text"),
        (put(["fit", "findings", 0, "extra"], 1), r"fit.findings\[0\] has the unknown entry 'extra'"),
        (drop("fit", "findings"), "fit has no entry 'findings'"),
        (put(["provenance"], None), "provenance is None"),
        (put(["provenance", "deep"], nested(100)), "nested"),
        (put(["covariance"], [[1.0]]), "covariance has shape"),
        (put(["covariance"], [[1.0, 2.0], [1.0]]), r"covariance\[1\] has 1 entries"),
        (put(["covariance"], [[1.0, 0.5], [0.2, 1.0]]), "not symmetric"),
        (put(["covariance", 0, 0], None), r"covariance\[0\]\[0\] is None"),
    ],
)
def test_wrong_documents_are_refused_with_file_and_place(document, change, message, tmp_path):
    change(document)
    with pytest.raises(InputError, match=message) as caught:
        LagrangianModel.from_dict(copy.deepcopy(document), "model.json")
    assert str(caught.value).startswith("model.json: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"[]", "not a leastaction model"),
        (b"null", "not a leastaction model"),
        (b'{"schema": 1,}', "line 1, column"),
        (b'{"schema": 1, "schema": 2}', "'schema' occurs twice"),
        (b'{"schema": NaN}', "NaN is not a number"),
        (b'{"schema": -Infinity}', "-Infinity is not a number"),
        (b'{"schema": ' + b"1" * 10_000 + b"}", "too many digits"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[" * 500 + b"]" * 500, "nested too deeply"),
        (b"\xff\xfe{}", "not UTF-8"),
        (b" " * (MAX_BYTES + 1), "larger than 10 MB"),
    ],
    ids=range(12),
)
def test_wrong_files_are_refused(tmp_path, data, message):
    path = tmp_path / "model.json"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)
    data = path.read_bytes()
    for size in range(0, len(data) - 2, 7):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"model\.json"):
            load(path)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "none.json")
    with pytest.raises(InputError, match="path"):
        load(3)
