from __future__ import annotations

import ctypes
import subprocess
import zipfile

import numpy as np
import pytest

import leastaction as la
from helpers import COMPILER, MODELS, states, timed
from leastaction import systems
from leastaction.errors import InputError
from leastaction.exporters import fmu
from leastaction.exporters.fmu import (
    TARGETS,
    compile_library,
    longest_step,
    platform_name,
    source_files,
)
from leastaction.model.model import LagrangianModel, ModelTerm

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("fmpy.validation")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
VERSIONS = (2, 3)


class Slave:
    """An FMU of a model in initialisation mode, with one face for both versions."""

    def __init__(self, model, version, folder):
        path = folder / "found model.fmu"
        la.export(model, f"fmu{version}", path)
        self.said: list[str] = []
        self.version = version
        self.description = fmpy.read_model_description(path)
        unzipped = fmpy.extract(path, folder / "unzipped")
        self.fmu = fmpy.instantiate_fmu(
            unzipped, self.description, "CoSimulation", logger=lambda *a: self.said.append(a[-1].decode())
        )
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.begin()

    def begin(self):
        if self.version == 2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def set(self, names, values):
        write = self.fmu.setReal if self.version == 2 else self.fmu.setFloat64
        write([self.references[name] for name in names], [float(x) for x in values])

    def get(self, names):
        read = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        return np.array(read([self.references[name] for name in names]))

    def step(self, time, size):
        return self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)


def names(model, ending):
    return [f"{c}{ending}" for c in model.coordinates]


# FMI 2.0, whose C is alike, is stepped in CI.
@pytest.fixture(params=[pytest.param(2, marks=pytest.mark.thorough), 3])
def version(request):
    return request.param


@pytest.fixture
def slave(request, version, tmp_path):
    made = []

    def make(model):
        made.append(Slave(model, version, tmp_path))
        return made[-1]

    yield make
    for one in made:
        one.fmu.freeInstance()


@needs_compiler
@pytest.mark.parametrize("name", ["odd", "driven", "passive", "swapped"])
def test_accelerations_and_energy_agree(name, slave):
    model = MODELS[name]()
    one = slave(model)
    for q, v, f in states(model):
        given = [*names(model, ""), *names(model, "_dot"), *names(model, "_force")]
        one.set(given, [*q, *v, *f])
        np.testing.assert_allclose(one.get(given), [*q, *v, *f])
        qddot = one.get(names(model, "_dot_dot"))
        np.testing.assert_allclose(qddot, model.acceleration(q, v, f), rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(one.get(["energy"])[0], model.energy(q, v), rtol=1e-11, atol=1e-11)


@needs_compiler
def test_description_is_valid(version, tmp_path):
    for name in ("odd", "driven"):
        path = tmp_path / f"{name}.fmu"
        content = la.export(MODELS[name](), f"fmu{version}", path)
        assert path.read_bytes() == content
        assert fmpy.validation.validate_fmu(str(path)) == []
        description = fmpy.read_model_description(path)
        assert description.modelName == name
        assert fmpy.platform in fmpy.supported_platforms(path) or version == 3
        with zipfile.ZipFile(path) as archive:
            assert archive.testzip() is None
            assert [p for p in archive.namelist() if p.startswith("binaries/")] == [
                f"binaries/{platform_name(version)}/{name}{fmpy.sharedLibraryExtension}"
            ]


def held(model, q0, qdot0, t, forces):
    """Reference: the simulation, with the force of the begin of each interval held over it."""
    q, v = [np.array(q0)], [np.array(qdot0)]
    for k in range(len(t) - 1):
        push = forces[k]
        run = model.simulate(q[-1], v[-1], t[k : k + 2], lambda time, push=push: push, rtol=1e-11, atol=1e-11)
        q.append(run.q[-1])
        v.append(run.qdot[-1])
    return np.hstack([q, v])


@needs_compiler
def test_driven_motion_is_the_simulation(version, tmp_path):
    model = MODELS["driven"]()
    path = tmp_path / "double.fmu"
    la.export(model, f"fmu{version}", path)
    t = np.arange(151) * 0.02
    forces = np.column_stack([3.0 * np.sin(4.0 * t), np.cos(2.5 * t)])
    columns = [("time", float), ("theta1_force", float), ("theta2_force", float)]
    result = fmpy.simulate_fmu(
        str(path),
        stop_time=3.0,
        output_interval=0.02,
        start_values={"theta1": 0.8, "theta2": -0.4, "theta1_dot": 0.5},
        input=np.array([(a, *b) for a, b in zip(t, forces, strict=True)], dtype=columns),
        output=["theta1", "theta2", "theta1_dot", "theta2_dot"],
    )
    expected = held(model, [0.8, -0.4], [0.5, 0.0], t, forces)
    found = np.column_stack([result[name] for name in result.dtype.names])
    np.testing.assert_allclose(found[:, 0], t, atol=1e-12)
    np.testing.assert_allclose(found[:, 1:], expected, atol=2e-7)
    free = model.simulate([0.8, -0.4], [0.5, 0.0], t)
    assert np.abs(free.q - found[:, 1:3]).max() > 0.1


@needs_compiler
def test_a_law_that_holds_the_time_follows_the_clock_of_the_simulation(version, tmp_path):
    model, path = timed(), tmp_path / "rocked.fmu"
    la.export(model, f"fmu{version}", path)
    t = 1.5 + np.arange(101) * 0.02
    result = fmpy.simulate_fmu(
        str(path),
        start_time=1.5,
        stop_time=3.5,
        output_interval=0.02,
        start_values={"theta": 0.8, "x": -0.4, "theta_dot": 0.5},
        output=["theta", "x", "theta_dot", "x_dot", "theta_dot_dot", "energy"],
    )
    expected = model.simulate([0.8, -0.4], [0.5, 0.0], t, rtol=1e-11, atol=1e-11)
    found = np.column_stack([result[name] for name in result.dtype.names[1:]])
    np.testing.assert_allclose(found[:, :2], expected.q, atol=2e-7)
    np.testing.assert_allclose(found[:, 2:4], expected.qdot, atol=2e-7)
    qddot = model.acceleration(expected.q, expected.qdot, t=t)[:, 0]
    np.testing.assert_allclose(found[:, 4], qddot, atol=2e-6)
    np.testing.assert_allclose(found[:, 5], model.energy(expected.q, expected.qdot, t), atol=2e-6)


@needs_compiler
def test_passive_motion_conserves_energy_and_is_the_simulation(version, tmp_path):
    model = MODELS["passive"]()
    path = tmp_path / "cart.fmu"
    la.export(model, f"fmu{version}", path)
    result = fmpy.simulate_fmu(
        str(path), stop_time=5.0, output_interval=0.05, start_values={"x": 0.3, "theta": 1.2}
    )
    run = model.simulate([0.3, 1.2], [0.0, 0.0], np.linspace(0.0, 5.0, 101))
    np.testing.assert_allclose(np.column_stack([result["x"], result["theta"]]), run.q, atol=1e-8)
    np.testing.assert_allclose(np.column_stack([result["x_dot"], result["theta_dot"]]), run.qdot, atol=1e-8)
    assert np.ptp(result["energy"]) < 1e-9


@needs_compiler
def test_error_falls_with_the_fourth_power_of_max_step(slave):
    model = MODELS["passive"]()
    one = slave(model)
    run = model.simulate([0.3, 1.2], [0.0, 0.0], [0.0, 1.0], rtol=1e-12, atol=1e-12)
    errors = []
    for step in (0.01, 0.005):
        one.set(["x", "theta", "max_step"], [0.3, 1.2, step])
        one.fmu.exitInitializationMode()
        one.step(0.0, 1.0)
        errors.append(np.abs(one.get(["x_dot", "theta_dot"]) - run.qdot[-1]).max())
        one.fmu.reset()
        assert one.get(["x", "theta", "max_step"]).tolist() == [0.0, 0.0, 1e-3]
        one.begin()
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)


@needs_compiler
def test_coefficients_are_parameters(slave):
    model = MODELS["driven"]()
    one = slave(model)
    starts = {v.name: float(v.start) for v in one.description.modelVariables if v.causality == "parameter"}
    assert starts.pop("max_step") == 1e-3
    assert list(starts.values()) == [t.coefficient for t in (*model.terms, *model.dissipation)]
    changed = LagrangianModel(
        model.coordinates,
        [ModelTerm(t.expression, 1.1 * t.coefficient) for t in model.terms],
        [ModelTerm(t.expression, 0.5 * t.coefficient) for t in model.dissipation],
    )
    one.set(starts, [t.coefficient for t in (*changed.terms, *changed.dissipation)])
    q, v = [0.3, 0.8], [-0.5, 0.7]
    one.set(["theta1", "theta2", "theta1_dot", "theta2_dot"], [*q, *v])
    np.testing.assert_allclose(one.get(names(model, "_dot_dot")), changed.acceleration(q, v), rtol=1e-11)
    # They may be changed between two steps as well.
    one.fmu.exitInitializationMode()
    one.step(0.0, 0.1)
    one.set(["lagrangian_1"], [changed.terms[0].coefficient * 2])
    assert one.get(["lagrangian_1"])[0] == changed.terms[0].coefficient * 2


@needs_compiler
def test_a_stored_state_is_restored(slave):
    one = slave(MODELS["passive"]())
    outputs = ["x", "theta", "x_dot", "theta_dot", "time"]
    one.set(["x", "theta"], [0.3, 1.2])
    one.fmu.exitInitializationMode()
    one.step(0.0, 0.3)
    stored, before = (one.fmu.getFMUstate if one.version == 2 else one.fmu.getFMUState)(), one.get(outputs)
    one.step(0.3, 0.2)
    after = one.get(outputs)
    assert (after != before).all()
    assert after[-1] == 0.5
    (one.fmu.setFMUstate if one.version == 2 else one.fmu.setFMUState)(stored)
    np.testing.assert_array_equal(one.get(outputs), before)
    one.step(0.3, 0.2)
    np.testing.assert_array_equal(one.get(outputs), after)
    (one.fmu.freeFMUstate if one.version == 2 else one.fmu.freeFMUState)(stored)


@needs_compiler
def test_what_must_not_be_done_is_refused_with_a_reason(slave):
    one = slave(MODELS["passive"]())
    refused = fmpy.fmi1.FMICallException

    def refuses(says, call, *args):
        one.said.clear()
        with pytest.raises(refused):
            call(*args)
        assert says in " ".join(one.said)

    refuses("computed and cannot be set", one.set, ["energy"], [1.0])
    refuses("computed and cannot be set", one.set, ["x_dot_dot"], [1.0])
    refuses("must be positive", one.set, ["max_step"], [0.0])
    refuses("not a finite number", one.set, ["x"], [np.nan])
    refuses("after the initialisation only", one.step, 0.0, 0.1)
    one.fmu.exitInitializationMode()
    refuses("before the end of the initialisation only", one.set, ["x"], [1.0])
    refuses("out of turn", one.fmu.exitInitializationMode)
    refuses("step size must be positive", one.step, 0.0, -0.1)
    refuses("make max_step larger", one.step, 0.0, 1e9)
    one.references["nothing"] = 1000
    refuses("no variable of this value reference", one.get, ["nothing"])


@needs_compiler
def test_a_motion_that_cannot_be_followed_is_refused_and_left_where_it_was(slave):
    runaway = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**4", 0.5)])
    one = slave(runaway)
    one.set(["x"], [1.0])
    one.fmu.exitInitializationMode()
    one.step(0.0, 0.1)
    before = one.get(["x", "x_dot", "time"])
    with pytest.raises(fmpy.fmi1.FMICallException):
        one.step(0.1, 10.0)
    assert "cannot be followed" in one.said[-1]
    np.testing.assert_array_equal(one.get(["x", "x_dot", "time"]), before)


@needs_compiler
def test_another_token_is_refused(version, tmp_path):
    path = tmp_path / "a.fmu"
    la.export(MODELS["free"](), f"fmu{version}", path)
    description = fmpy.read_model_description(path)
    if version == 2:
        description.guid = "{other}"
    else:
        description.guid = description.instantiationToken = "{other}"
    unzipped = fmpy.extract(path, tmp_path / "a")
    said = []
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmpy.instantiate_fmu(unzipped, description, logger=lambda *a: said.append(a[-1].decode()))
    assert "do not belong together" in said[0]


def test_variables_make_way_for_coordinates(version):
    terms = [ModelTerm("energy_dot**2", 0.5), ModelTerm("x_force_dot**2", 1.0), ModelTerm("x_dot**2", 0.5)]
    model = LagrangianModel(["energy", "x_force", "x"], terms)
    from leastaction.exporters.fmu_description import variables

    listed = [v.name for v in variables(model, 1e-3)]
    assert len(set(listed)) == len(listed)
    assert listed[1:7] == ["energy", "x_force", "x", "energy_dot", "x_force_dot", "x_dot"]
    assert {"energy_", "x_force_"} <= set(listed)


def test_fast_systems_get_shorter_steps():
    spring = MODELS["free"]()
    fast = LagrangianModel(["x"], spring.terms, provenance={"knots_per_second": 1e6})
    assert longest_step(spring) == 1e-3
    assert longest_step(fast) == pytest.approx(1e-7)


@pytest.mark.parametrize("trials", [1, 2])
def test_a_model_that_was_just_found_gets_a_step(trials) -> None:
    data = systems.generate("single_pendulum", noise=0.01, trials=trials, duration=4.0, seed=0)
    model = la.discover(data, systems.compact_library("single_pendulum"))
    again = LagrangianModel.from_dict(model.to_dict())
    assert 0.0 < longest_step(model) <= longest_step(again)


@pytest.mark.parametrize("rate", [1.0, 30.0, 300.0, 2000.0])
def test_the_step_is_halved_until_the_motion_is_followed(rate):
    """An oscillator, whose motion is known: RK4 is off by (rate h)^5 / 120 radian a step."""
    spring = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -(rate**2) / 2)])
    step = longest_step(spring)
    assert step == 1e-3 * 2.0 ** round(np.log2(step / 1e-3))
    assert (rate * step) ** 5 / 120.0 * 100 < 1e-7 or step == 1e-3 / 2**10
    assert step == 1e-3 or (2.0 * rate * step) ** 5 / 120.0 * 100 > 1e-9  # no shorter than need be


def test_times_and_angles_have_units(version, tmp_path):
    model = MODELS["passive"]()
    model = LagrangianModel(model.coordinates, model.terms, provenance={"options": {"angles": ["theta"]}})
    path = tmp_path / "cart.fmu"
    if COMPILER is None:
        pytest.skip("no C compiler")
    la.export(model, f"fmu{version}", path)
    assert fmpy.validation.validate_fmu(str(path)) == []
    found = fmpy.read_model_description(path)
    units = {v.name: v.unit for v in found.modelVariables}
    assert units["theta"] == "rad"
    assert units["theta_dot"] == "rad/s"
    assert units["theta_dot_dot"] == "rad/s2"
    assert units["max_step"] == "s"
    assert units["x"] is None
    assert {unit.name for unit in found.unitDefinitions} == {"s", "rad", "rad/s", "rad/s2"}


@needs_compiler
def test_units_that_the_data_state_are_those_of_the_fmu(version, tmp_path):
    """Lengths, forces and torques of a cart; the input of a prescribed one is its acceleration."""
    given = {"position": {"x": "m", "theta": "rad"}, "force": {"x": "N", "theta": "N m"}}
    expected = {
        **{"time": "s", "x": "m", "x_dot": "m/s", "x_dot_dot": "m/s2", "x_force": "N", "max_step": "s"},
        **{"theta": "rad", "theta_dot": "rad/s", "theta_dot_dot": "rad/s2", "theta_force": "N.m"},
    }
    bases = {
        "N": {"kg": 1, "m": 1, "s": -2},
        "N.m": {"kg": 1, "m": 2, "s": -2},
        "m/s2": {"m": 1, "s": -2},
    }
    parts = MODELS["passive"]()
    for options, change in (({}, {}), ({"prescribed": ["x"]}, {"x_force": "m/s2"})):
        provenance = {"units": given, "options": options}
        made = LagrangianModel(parts.coordinates, parts.terms, provenance=provenance)
        path = tmp_path / "cart.fmu"
        la.export(LagrangianModel.from_dict(made.to_dict()), f"fmu{version}", path)
        assert fmpy.validation.validate_fmu(str(path)) == []
        found = fmpy.read_model_description(path, validate=True)
        units = {v.name: v.unit for v in found.modelVariables if v.unit}
        assert units == expected | change
        assert {unit.name for unit in found.unitDefinitions} == set(units.values())
        for unit in found.unitDefinitions:
            base = {name: getattr(unit.baseUnit, name) for name in ("kg", "m", "s", "rad")}
            assert unit.name not in bases or {k: n for k, n in base.items() if n} == bases[unit.name]


@pytest.mark.parametrize(
    "stated",
    [None, "m", [], {"position": "m"}, {"position": {"x": ["m"], "theta": "mm"}}, {"position": {"y": "m"}}],
)
def test_units_that_are_not_known_are_not_guessed(stated):
    """Without units, or with what somebody wrote into a model file, nothing but times has a unit."""
    from leastaction.exporters.fmu_description import variables

    parts = MODELS["passive"]()
    model = LagrangianModel(parts.coordinates, parts.terms, provenance={"units": stated})
    assert {v.name: v.unit for v in variables(model, 1e-3) if v.unit} == {"time": "s", "max_step": "s"}


def test_units_come_from_the_file_that_was_read(tmp_path):
    from leastaction.exporters.fmu_description import variables

    t, rng = np.arange(400) * 0.02, np.random.default_rng(0)
    x, f = 0.3 * np.cos(2.0 * t) + 0.1 * np.sin(3.0 * t), -0.5 * np.sin(3.0 * t)  # of 1 kg and 4 N/m
    x += 1e-4 * rng.standard_normal(t.size)
    path = tmp_path / "run.csv"
    for header, size, units in (
        ("x [m],f [N]", 1.0, {"x": "m", "x_dot": "m/s", "x_force": "N"}),
        ("x [mm],f", 1e3, {"x": "m", "x_dot": "m/s", "x_force": ""}),
        ("x,f", 1.0, {"x": "", "x_dot": "", "x_force": ""}),
    ):
        table = np.column_stack([t, size * x, f])
        np.savetxt(path, table, delimiter=",", header=f"t,{header}", comments="")
        model = la.discover(la.read_csv(path, ["x"], forces={"x": "f"}), ["x_dot**2", "x**2"])
        model = LagrangianModel.from_dict(model.to_dict())
        found = {v.name: v.unit for v in variables(model, 1e-3)}
        assert {name: found[name] for name in units} == units


@needs_compiler
@pytest.mark.parametrize("name", ["odd", "driven", "free"])
def test_sources_compile_without_a_warning(name, version, tmp_path):
    for path, text in source_files(MODELS[name](), version, "model", "{token}").items():
        (tmp_path / path).write_text(text, encoding="utf-8")
    options = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-O1", "-c"]
    units = sorted(p.name for p in tmp_path.glob("*.c"))
    subprocess.run([COMPILER, *options, *units], cwd=tmp_path, check=True, capture_output=True, timeout=60)


@needs_compiler
def test_library_exports_the_interface_only(version, tmp_path):
    path = tmp_path / "a.fmu"
    la.export(MODELS["free"](), f"fmu{version}", path)
    with zipfile.ZipFile(path) as archive:
        here = f"binaries/{platform_name(version)}/"
        (binary,) = [p for p in archive.namelist() if p.startswith(here)]
        library = ctypes.CDLL(archive.extract(binary, tmp_path))
    assert hasattr(library, f"fmi{version}DoStep")
    for name in ("motion_step", "leastaction_acceleration", "a_motion_step", "a_leastaction_acceleration"):
        assert not hasattr(library, name)


def test_no_compiler(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(fmu, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"no C compiler on the PATH .*install one"):
        la.export(MODELS["free"](), "fmu2", tmp_path / "a.fmu")
    assert not (tmp_path / "a.fmu").exists()


@needs_compiler
def test_compiler_that_fails():
    with pytest.raises(InputError, match=r"the C compiler .* failed: .*error"):
        compile_library({"a.c": "int a(void) { return nothing; }\n"})


@pytest.mark.parametrize("version", VERSIONS)
def test_with_zig_there_is_a_library_for_every_platform(version, monkeypatch, tmp_path):
    def compiled(sources, options, target=None):
        asked.append(target)
        return b"library", ".so"

    asked: list[str | None] = []
    monkeypatch.setattr(fmu, "compile_library", compiled)
    monkeypatch.setattr(fmu, "find_spec", lambda name: name)
    for compiler in ("/usr/bin/cc", None):  # without one, Zig compiles for this computer, too
        asked.clear()
        monkeypatch.setattr(fmu, "_compiler", lambda compiler=compiler: compiler)
        found = fmu._libraries({}, version)
        assert {*found} == {*TARGETS[version], *([platform_name(version)] if compiler else [])}
        assert len(asked) == len(found)
        assert (None in asked) == (compiler is not None)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("target", "suffix", "magic"),
    [
        ("x86_64-windows-gnu", ".dll", b"MZ"),
        ("x86_64-linux-gnu.2.17", ".so", b"\x7fELF"),
        ("aarch64-macos", ".dylib", b"\xcf\xfa\xed\xfe"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_sources_compile_for_other_platforms(version, target, suffix, magic):
    pytest.importorskip("ziglang", reason="no Zig: pip install 'leastaction[fmu]'")
    sources = source_files(MODELS["driven"](), version, "model", "token")
    options = ["-Wall", "-Wextra", "-Werror", f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX"]
    library, found = compile_library(sources, options, target)
    assert (found, library[: len(magic)]) == (suffix, magic)
    assert b"nstantiate" in library
