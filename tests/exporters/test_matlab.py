r"""The exported function file, run by Octave if there is one, and by a small interpreter.

There is no MATLAB or Octave where the tests run. What the interpreter checks is the grammar of the file and
its numbers, by the rules of MATLAB (``^`` binds from the left, arrays start at 1, ``\`` solves). It reads a
whitelist; anything else is an error.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

from helpers import MODELS, states, timed
from leastaction.errors import InputError
from leastaction.exporters.write import export
from leastaction.model.model import LagrangianModel, ModelTerm

# ------------------------------------------ the little of MATLAB that an exported file uses, on NumPy columns
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|(?P<text>'[^']*')|(?P<op>[-+*/\\^()\[\],;:@.]))"
)
_DEFINITION = re.compile(
    r"function (?:\[(?P<many>[\w, ]+)\]|(?P<one>\w+)) = (?P<name>\w+)\((?P<args>[\w, ]*)\)"
)
_ASSIGNMENT = re.compile(r"(?:\[(?P<many>[\w, ]+)\]|(?P<one>\w+(?:\.\w+)?)) = (?P<value>.+);")


def _real(function: Callable, low: float) -> Callable:
    def call(x):
        if np.min(x) < low:
            raise ValueError("produced complex result")
        return function(x)

    return call


def _realpow(x, y):
    if x < 0 and y != int(y):
        raise ValueError("realpow: produced complex result")
    return x**y


BUILT_IN: dict[str, Callable] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "abs": np.abs,
    "sign": np.sign,
    "realsqrt": _real(np.sqrt, 0.0),
    "reallog": _real(np.log, 0.0),
    "realpow": _realpow,
    "zeros": lambda n, m: np.zeros((int(n), int(m))),
    "isa": lambda x, kind: callable(x) and kind == "function_handle",
}


class Program:
    """The functions of one file; `call` runs one."""

    def __init__(self, source: str) -> None:
        self.functions: dict[str, tuple[list[str], list[str], list[str]]] = {}
        lines = [line.strip() for line in source.splitlines()]
        lines = [line for line in lines if line and not line.startswith("%")]
        body: list[str] | None = None
        depth = 0
        for line in lines:
            found = _DEFINITION.fullmatch(line)
            if found:
                assert depth == 0, f"function inside a function: {line}"
                body, depth = [], 1
                outputs = _names(found["many"] or found["one"])
                assert found["name"] not in self.functions
                self.functions[found["name"]] = (outputs, _names(found["args"]), body)
                continue
            assert body is not None, f"outside of a function: {line}"
            depth += line.startswith("if ") - (line == "end")
            if depth:
                body.append(line)
        assert depth == 0, "an end is missing"
        self.main = next(iter(self.functions))

    def call(self, name: str, *args):
        outputs, parameters, body = self.functions[name]
        assert len(args) <= len(parameters), f"too many arguments for {name}"
        scope = dict(zip(parameters, args, strict=False))
        self._run(body, scope, len(args))
        values = tuple(scope[output] for output in outputs)
        return values[0] if len(values) == 1 else values

    def _run(self, body: list[str], scope: dict, nargin: int) -> None:
        place = 0
        while place < len(body):
            if body[place].startswith("if "):
                stop, parts = _branches(body, place)
                for condition, lines in parts:
                    if condition is None or self._true(condition, scope, nargin):
                        self._run(lines, scope, nargin)
                        break
                place = stop + 1
                continue
            found = _ASSIGNMENT.fullmatch(body[place])
            assert found, f"not a statement of the subset: {body[place]}"
            value = Expression(found["value"], scope, self).value()
            if found["many"]:
                scope.update(zip(_names(found["many"]), value, strict=True))
            elif "." in found["one"]:
                whole, part = found["one"].split(".")
                scope.setdefault(whole, {})[part] = value
            else:
                # The first of several results, as in MATLAB.
                scope[found["one"]] = value[0] if isinstance(value, tuple) else value
            place += 1

    def _true(self, condition: str, scope: dict, nargin: int) -> bool:
        found = re.fullmatch(r"nargin ([<>]) (\d)", condition)
        if found:
            return nargin < int(found[2]) if found[1] == "<" else nargin > int(found[2])
        return bool(Expression(condition, scope, self).value())


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _branches(body: list[str], start: int):
    """Place of the end, and (condition, lines) of if, elseif, else."""
    parts, depth = [(body[start][3:], [])], 0
    for place in range(start + 1, len(body)):
        line = body[place]
        if depth == 0 and line == "end":
            return place, parts
        if depth == 0 and line.startswith("elseif "):
            parts.append((line[7:], []))
        elif depth == 0 and line == "else":
            parts.append((None, []))
        else:
            depth += line.startswith("if ") - (line == "end")
            parts[-1][1].append(line)
    raise AssertionError("an end is missing")


class Expression:
    """Recursive descent; numbers are floats or columns of shape (n, m)."""

    def __init__(self, text: str, scope: dict, program: Program) -> None:
        self.scope, self.program, self.tokens, place = scope, program, [], 0
        while place < len(text.rstrip()):
            found = _TOKEN.match(text, place)
            assert found, f"not in the subset: {text[place:]}"
            self.tokens.append((found.lastgroup, found[found.lastgroup]))
            place = found.end()
        self.tokens.append(("end", ""))
        self.place = 0

    def value(self):
        result = self.sum()
        assert self.tokens[self.place][0] == "end", f"left over: {self.tokens[self.place :]}"
        return result

    def take(self, *operators: str) -> str | None:
        kind, text = self.tokens[self.place]
        if kind == "op" and text in operators:
            self.place += 1
            return text
        return None

    def need(self, operator: str) -> None:
        assert self.take(operator), f"{operator} expected before {self.tokens[self.place :]}"

    def sum(self):
        result = self.product()
        while operator := self.take("+", "-"):
            right = self.product()
            result = result + right if operator == "+" else result - right
        return result

    def product(self):
        result = self.signed()
        while operator := self.take("*", "/", "\\"):
            right = self.signed()
            if operator == "\\":
                result = np.linalg.solve(np.atleast_2d(result), np.atleast_2d(right))
            else:
                # Elementwise and matrix operations agree only where one side is a scalar.
                assert np.ndim(result) == 0 or np.ndim(right) == 0
                result = result * right if operator == "*" else result / right
        return result

    def signed(self):
        if operator := self.take("-", "+"):
            inner = self.signed()
            return -inner if operator == "-" else inner
        return self.power()

    def power(self):
        result = self.postfix()
        while self.take("^"):  # from the left, and the exponent may have a sign
            sign = -1.0 if self.take("-") else 1.0
            result = np.float64(result) ** (sign * self.postfix())
        return result

    def postfix(self):
        kind, text = self.tokens[self.place]
        self.place += 1
        if kind == "number":
            return np.float64(text)
        if kind == "text":
            return text[1:-1]
        if kind == "op" and text == "(":
            result = self.sum()
            self.need(")")
            return result
        if kind == "op" and text == "[":
            return self.matrix()
        if kind == "op" and text == "@":
            self.place += 1
            name = self.tokens[self.place - 1][1]
            assert name in self.program.functions
            return lambda *args: self.program.call(name, *args)
        assert kind == "name", f"not expected: {text}"
        return self.named(text)

    def named(self, name: str):
        if not self.take("("):
            return self.scope[name]
        if name in self.scope and self.take(":"):
            self.need(")")
            return np.reshape(self.scope[name], (-1, 1), order="F")
        args = [self.sum()]
        if self.take(":"):
            last = self.sum()
            self.need(")")
            flat = np.ravel(self.scope[name], order="F")
            return flat[int(args[0]) - 1 : int(last)].reshape(-1, 1)
        while self.take(","):
            args.append(self.sum())
        self.need(")")
        if name in self.scope and not callable(self.scope[name]):
            (index,) = args
            assert 1 <= index <= np.size(self.scope[name])
            return np.ravel(self.scope[name], order="F")[int(index) - 1]
        if name in self.scope:
            return self.scope[name](*args)
        if name in self.program.functions:
            return self.program.call(name, *args)
        return BUILT_IN[name](*args)

    def matrix(self):
        rows = [[self.sum()]]
        while not self.take("]"):
            if self.take(","):
                rows[-1].append(self.sum())
            else:
                self.need(";")
                rows.append([self.sum()])
        return np.vstack([np.hstack([np.atleast_2d(x) for x in row]) for row in rows])


# --------------------------------------------------------------------------------- the exported function file
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")


@pytest.fixture(params=MODELS, scope="module")
def model(request):
    return MODELS[request.param]()


def handles(model):
    program = Program(export(model, "matlab"))
    assert program.main == "leastaction_model"
    return program.call(program.main)


def column(x):
    return np.reshape(np.asarray(x, dtype=float), (-1, 1))


def test_numbers_agree(model):
    made = handles(model)
    assert list(made) == ["acceleration", "state_derivative", "energy", "mass_matrix"]
    close = {"rtol": 1e-11, "atol": 1e-11}
    for q, v, f in states(model):
        qddot = made["acceleration"](column(q), column(v), column(f))
        np.testing.assert_allclose(qddot, column(model.acceleration(q, v, f)), **close)
        np.testing.assert_allclose(
            made["acceleration"](column(q), column(v)), column(model.acceleration(q, v)), **close
        )
        np.testing.assert_allclose(made["energy"](column(q), column(v)), model.energy(q, v), **close)
        np.testing.assert_allclose(
            made["mass_matrix"](column(q), column(v)), model.mass_matrix(q, v), **close
        )
        np.testing.assert_allclose(made["mass_matrix"](column(q)), model.mass_matrix(q), **close)


def test_a_law_that_holds_the_time_takes_it_behind_the_state():
    model = timed()
    made = handles(model)
    for k, (q, v, f) in enumerate(states(model)):
        close, t = {"rtol": 1e-11, "atol": 1e-11}, 0.7 * k - 1.0
        free, driven = (column(model.acceleration(q, v, force, t)) for force in (None, f))
        given = column(q), column(v), t
        np.testing.assert_allclose(made["acceleration"](*given), free, **close)
        np.testing.assert_allclose(made["acceleration"](*given, column(f)), driven, **close)
        np.testing.assert_allclose(made["energy"](*given), model.energy(q, v, t), **close)
        np.testing.assert_allclose(made["mass_matrix"](*given), model.mass_matrix(q, v, t), **close)
        state = column([*q, *v])
        np.testing.assert_allclose(made["state_derivative"](t, state)[2:], free, **close)
        np.testing.assert_allclose(made["state_derivative"](t, state, column(f))[2:], driven, **close)


def test_state_derivative(model):
    made = handles(model)
    for q, v, f in states(model):
        state = column([*q, *v])
        free, driven = ([*v, *model.acceleration(q, v, force)] for force in (None, f))
        close = {"rtol": 1e-11, "atol": 1e-11}
        np.testing.assert_allclose(made["state_derivative"](0.0, state), column(free), **close)
        np.testing.assert_allclose(made["state_derivative"](0.0, state, column(f)), column(driven), **close)
        held = made["state_derivative"](0.5, state, lambda t, f=f: column(f) * t * 2.0)
        np.testing.assert_allclose(held, column(driven), **close)


def test_the_interpreter_knows_the_rules_of_matlab():
    """What it is trusted with: precedence, and refusal of everything else."""

    def value(text):
        return Program(f"function y = f(x)\ny = {text};\nend\n").call("f", column([2.0, 5.0]))

    assert value("-2^2") == -4.0
    assert value("2^3^2") == 64.0
    assert value("2^-1") == 0.5
    assert value("8/4/2") == 1.0
    assert value("x(2) - x(1)*2 - 1") == 0.0
    assert value("[2, 0; 0, 5] \\ x").tolist() == [[1.0], [1.0]]
    for text in ("realsqrt(-1)", "reallog(-1)", "realpow(-2, 0.5)"):
        with pytest.raises(ValueError, match="complex"):
            value(text)
    for text in ("x(3)", "system(1)", "x'", "1 +", "2 ** 3", "x.^2", "(1"):
        with pytest.raises((AssertionError, KeyError)):
            value(text)


def test_name_of_the_file_is_that_of_the_function(tmp_path):
    export(MODELS["free"](), "matlab", tmp_path / "my_spring.m")
    assert Program((tmp_path / "my_spring.m").read_text(encoding="ascii")).main == "my_spring"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("spring.c", "does not end in .m"),
        ("spring", "does not end in .m"),
        ("3springs.m", "is not a name of a MATLAB function"),
        ("my-spring.m", "is not a name of a MATLAB function"),
        ("while.m", "not a keyword"),
        ("θ.m", "is not a name"),
    ],
)
def test_names_that_matlab_cannot_call(name, says, tmp_path):
    with pytest.raises(InputError, match=says):
        export(MODELS["free"](), "matlab", tmp_path / name)
    assert not (tmp_path / name).exists()


def test_outside_of_its_domain_it_stops_and_is_not_complex():
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("log(x)*sqrt(x)", 1.0)])
    with pytest.raises(ValueError, match="complex"):
        handles(model)["acceleration"](column([-1.0]), column([0.0]))


@pytest.mark.skipif(OCTAVE is None, reason="no Octave")
def test_octave_agrees(tmp_path):
    for number, make in enumerate(MODELS.values()):
        model = make()
        export(model, "matlab", tmp_path / f"found{number}.m")
        q, v, f = states(model)[0]
        vectors = ", ".join("[" + "; ".join(map(repr, x.tolist())) + "]" for x in (q, v, f))
        script = f"m = found{number}(); printf('%.17g ', m.acceleration({vectors}));"
        done = subprocess.run(
            [OCTAVE, "--eval", script], cwd=tmp_path, capture_output=True, timeout=60, check=True
        )
        found = [float(x) for x in done.stdout.split()]
        np.testing.assert_allclose(found, model.acceleration(q, v, f), rtol=1e-11)
