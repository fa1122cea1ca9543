"""Files of every format and what the readers make of them: Parquet, NPZ, MAT, Excel, CSV, ROS 2 bags."""

from __future__ import annotations

import datetime
import gzip
import os
import pickle
import stat
import sys
import tracemalloc
import warnings

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

import leastaction as la
from leastaction import DataError, InputError, io
from leastaction.cli import program
from leastaction.data.formats import text as text_module
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataWarning

NAN = float("nan")
T = np.arange(12) / 10
COLUMNS = {
    "t": np.tile(T[:6], 2),
    "a": np.sin(COLUMN := np.arange(12.0)),
    "b": np.where(COLUMN == 3, NAN, COLUMN),
    "u": COLUMN % 3,
    "trial": np.repeat([4, 2], 6),
}


@pytest.fixture(scope="module")
def expected():
    return io.from_frame(pd.DataFrame(COLUMNS), ["a", "b"], forces={"b": "u"})


def check(runs, expected):
    assert runs.names == expected.names == ("4", "2")
    assert runs.digest() == expected.digest()
    assert runs[0].forces[:, 0].tolist() == [0.0] * 6


def frames(columns):
    """The same table in several libraries; a missing sample as NaN, null and pandas.NA."""
    table = pd.DataFrame(columns)
    nullable = table.assign(b=table["b"].astype("Int64"), trial=table["trial"].astype(str))
    objects = table.assign(b=table["b"].astype(object).where(table["b"].notna(), None))
    lists = {name: [None if x != x else x for x in values.tolist()] for name, values in columns.items()}
    return {
        "pandas": table,
        "pandas nullable": nullable,
        "pandas object": objects,
        "pandas index": table.set_index(table.index[::-1]),
        "pandas float trials": table.assign(trial=table["trial"].astype(float)),
        "pandas categories": nullable.assign(trial=nullable["trial"].astype("category")),
        "polars": pl.DataFrame(lists),
        "polars lazy": pl.DataFrame(columns).lazy(),
        "polars float32": pl.DataFrame(lists).with_columns(pl.col("b").cast(pl.Float32)),
        "arrow": pa.table(lists),
    }


@pytest.mark.parametrize("kind", list(frames(COLUMNS)))
def test_data_frames(kind, expected):
    check(io.from_frame(frames(COLUMNS)[kind], ["a", "b"], forces={"b": "u"}), expected)


def without(**changes):
    columns = {name: list(values) for name, values in COLUMNS.items()} | changes
    return {name: values for name, values in columns.items() if values is not None}


@pytest.mark.parametrize("library", [pd.DataFrame, pl.DataFrame])
@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        (
            without(a=None),
            InputError,
            r"data frame has no column 'a' \(coordinate a\); its columns are t, b, u",
        ),
        (without(a=["1"] * 12), InputError, r"row 0 .*column 'a': '1' is not a number"),
        (without(a=[True] * 12), InputError, r"column 'a': True is not a number"),
        (without(a=[datetime.datetime(2024, 1, 1)] * 12), InputError, "times to seconds"),
        (
            without(t=[datetime.datetime(2024, 1, 1)] * 12),
            InputError,
            r"row 1 .*repeats .*fractions of a second",
        ),
        (without(t=[None, *T[1:]]), InputError, r"row 0 .*column 't': the time is missing"),
        (without(u=[0.0] * 11 + [None]), InputError, r"row 11 .*column 'u': the force is missing"),
        (without(a=[0.0] * 5 + [np.inf] * 7), InputError, r"row 5 .*infinite"),
        (without(trial=[None] * 12), InputError, r"row 0 .*name of the trial is missing"),
        (without(trial=[1] * 5 + [2] * 6 + [1]), InputError, r"row 6 .*|row 11 .*continues"),
        (without(trial=None), InputError, r"row 6 .*time 0.0 goes backwards"),
        (without(t=list(T), trial=[1] * 8 + [2] * 4), DataError, "trial '2': there are only 4"),
        ({name: [] for name in COLUMNS}, InputError, "has no data"),
    ],
)
def test_bad_data_frames(library, columns, error, message):
    with pytest.raises(error, match=message):
        io.from_frame(library(columns), ["a", "b"], forces={"b": "u"})


def test_frames_with_odd_columns():
    table = pd.DataFrame([[0.0] * 3] * 6, columns=["t", "a", "a"])
    with pytest.raises(InputError, match="two columns are called 'a'"):
        io.from_frame(table, ["a"])
    with pytest.raises(InputError, match="it has no named columns"):
        io.from_frame(pd.DataFrame([[0.0] * 3] * 6), ["a"])
    for bad in (None, {"t": [1]}, [1, 2], "run.csv", pl.Series([1.0])):
        with pytest.raises(InputError, match="is not a"):
            io.from_frame(bad, ["a"])


# --- Parquet ----------------------------------------------------------------------------------------


def test_parquet(tmp_path, expected):
    pd.DataFrame(COLUMNS | {"no number": ["x"] * 12}).to_parquet(tmp_path / "run.parquet")
    check(io.read(tmp_path / "run.parquet", ["a", "b"], forces=[None, "u"]), expected)
    single = pd.DataFrame(COLUMNS).drop(columns="trial").iloc[:6].rename(columns={"a": "angle.a"})
    single.to_parquet(tmp_path / "one.PARQUET")
    assert io.read(tmp_path / "one.PARQUET", {"a": "angle.a"}).names == ("one",)


def test_bad_parquet(tmp_path):
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table(COLUMNS), path)
    with pytest.raises(InputError, match=r"run.parquet has no column 'c'"):
        io.read_parquet(path, ["c"])
    data = path.read_bytes()
    for content, message in [
        (b"", "is empty"),
        (b"t,a\n0,1\n", "not a Parquet file"),
        (data[:-20], "damaged"),
        (data[:4] + bytes(200) + data[204:], "damaged"),
    ]:
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            io.read_parquet(path, ["a"])
    with pytest.raises(InputError, match="no such file"):
        io.read_parquet(tmp_path / "none.parquet", ["a"])


@pytest.mark.parametrize(
    ("module", "suffix", "extra"), [("pyarrow.parquet", "parquet", "parquet"), ("h5py", "mat", "mat73")]
)
def test_missing_extras_are_named(tmp_path, monkeypatch, module, suffix, extra):
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"PAR1" if suffix == "parquet" else b"MATLAB 7.3 MAT-file")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"pip install 'leastaction\[{extra}\]'"):
        io.read(path, ["a"])


# --- NPZ and MAT ------------------------------------------------------------------------------------


def write_npz(path, variables):
    np.savez_compressed(path, **variables)


def write_mat(path, variables):
    savemat(path, variables, oned_as="column")


def write_mat73(path, variables):
    """As MATLAB does: every array two-dimensional and transposed, a class beside it."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            array = np.atleast_2d(np.asarray(value))
            if array.dtype.kind in "OU":
                texts = [
                    file.create_dataset(f"#refs#/{name}{k}", data=[[ord(c)] for c in x])
                    for k, x in enumerate(value)
                ]
                for text in texts:
                    text.attrs["MATLAB_class"] = np.bytes_("char")
                item = file.create_dataset(name, data=[[text.ref for text in texts]], dtype=h5py.ref_dtype)
                item.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                item = file.create_dataset(name, data=array if np.ndim(value) < 2 else array.T)
                item.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\0\2IM")


WRITERS = {"npz": write_npz, "mat": write_mat, "mat73": write_mat73}


@pytest.fixture(params=list(WRITERS))
def save(request, tmp_path):
    """Return a function that writes variables to a file of one kind and returns its path."""

    def write(variables):
        path = tmp_path / f"run.{request.param[:3]}"
        WRITERS[request.param](path, variables)
        return path

    return write


@pytest.mark.parametrize("texts", [False, True])
def test_variables(save, expected, texts):
    trials = np.array([str(x) for x in COLUMNS["trial"]], dtype=object if texts else str)
    variables = COLUMNS | {
        "trial": trials.astype(str) if texts else COLUMNS["trial"],
        "other": np.zeros((2, 3)),
    }
    check(io.read(save(variables), ["a", "b"], forces={"b": "u"}), expected)


def test_rows_and_columns_are_vectors(save):
    path = save({"time": T[:, np.newaxis], "x": T[np.newaxis, :] ** 2})
    runs = io.read(path, ["x"], time="time")
    assert runs.names == ("run",)
    np.testing.assert_array_equal(runs[0].q[:, 0], T**2)


def test_matrix_q(save):
    q = np.column_stack([T, T**2])
    path = save({"t": T, "q": q, "u": T})
    runs = io.read(path, ["x", "y"], forces=["u"])
    np.testing.assert_array_equal(runs[0].q, q)
    np.testing.assert_array_equal(runs[0].forces[:, 0], T)
    with pytest.raises(InputError, match=r"variable 'q': it has shape \(12, 2\), but .* \(12, 3\)"):
        io.read(path, ["x", "y", "z"])
    path = save({"t": T, "q": q.T})
    with pytest.raises(InputError, match="looks transposed"):
        io.read(path, ["x", "y"])
    assert io.read(save({"t": T, "q": T}), ["x"])[0].n_dof == 1
    assert io.read(save({"t": T, "q": T}), ["q"])[0].n_dof == 1


def test_one_trial_name_for_all(save):
    assert io.read(save({"t": T, "x": T, "trial": np.array([7])}), ["x"]).names == ("7",)


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"t": T}, r"has no variable 'x' \(coordinate x\); its variables are t"),
        ({"t": T, "x": T[:-1]}, r"variable 'x': it has 11 values, but the time 't' has 12"),
        ({"t": T, "x": T, "trial": T[:-1]}, "variable 'trial': it has 11 values"),
        ({"t": T, "x": np.ones((3, 4))}, r"variable 'x': it has shape \([34], [34]\)"),
        ({"t": T[::-1], "x": T}, r"row 1 .*column 't': time 1.0 goes backwards"),
        ({"t": T, "x": np.full(12, np.inf)}, "row 0 .*infinite"),
        ({"t": T, "x": np.array(["a"] * 12)}, "variable 'x'"),
        ({"t": np.full(12, NAN), "x": T}, "time is missing"),
    ],
)
def test_bad_variables(save, variables, message):
    path = save(variables)
    with pytest.raises(InputError, match=message) as caught:
        io.read(path, ["x"])
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_complex_numbers_are_refused(tmp_path):
    for suffix, write in (("npz", write_npz), ("mat", write_mat)):
        write(tmp_path / f"run.{suffix}", {"t": T, "x": T + 1j})
        with pytest.raises(InputError, match="variable 'x' has type complex128"):
            io.read(tmp_path / f"run.{suffix}", ["x"])


def test_few_samples(save):
    with pytest.raises(DataError, match="only 4 sample"):
        io.read(save({"t": T[:4], "x": T[:4]}), ["x"])


def test_pickled_objects_are_not_loaded(tmp_path):
    np.savez(tmp_path / "run.npz", t=T, x=np.array([{}] * 12, dtype=object))
    with pytest.raises(InputError, match="variable 'x': it holds pickled objects"):
        io.read(tmp_path / "run.npz", ["x"])


def test_damaged_files(save):
    path = save({"t": T, "x": T})
    data = path.read_bytes()
    for content in (b"", b"junk" * 100, data[: len(data) // 2], data[:200]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=path.name) as caught:
            io.read(path, ["x"])
        assert "\n" not in str(caught.value)


def test_npy_file_is_no_npz(tmp_path):
    np.save(tmp_path / "run.npy", T)
    (tmp_path / "run.npy").rename(tmp_path / "run.npz")
    with pytest.raises(InputError, match="not an NPZ file"):
        io.read_npz(tmp_path / "run.npz", ["x"])


# --- writing ----------------------------------------------------------------------------------------

values = arrays(np.float64, (7, 2), elements=st.floats(allow_infinity=False, allow_nan=False))


@given(
    values,
    values,
    st.booleans(),
    st.sampled_from(["run", "NA", "a,b", 'say "x"', "zwei\nZeilen", "θ", "007"]),
)
def test_written_csv_reads_back_exactly(tmp_path_factory, q, forces, driven, name):
    q = q.copy()
    q[0, 0] = NAN
    t = np.cumsum(np.random.default_rng(1).uniform(size=7))
    runs = Trajectories(
        [
            Trajectory(t, q, forces if driven else None, ["x", "y"], name),
            Trajectory(t[:6] - 7.0, q[:6], None, ["x", "y"]),
        ]
    )
    path = io.write_csv(tmp_path_factory.mktemp("rt") / "run.csv", runs)
    names = {"x": "x_force", "y": "y_force"} if runs.driven else None
    again = io.read_csv(path, ["x", "y"], forces=names)
    assert again.digest() == runs.digest()
    assert again.names == runs.names == (name, "1")
    assert ("x_force" in path.read_text(encoding="utf-8")) == runs.driven


def test_write_csv_compressed_and_reproducible(tmp_path):
    run = Trajectory(np.arange(5), np.arange(5), coordinates=["x"], name="a")
    first = io.write_csv(tmp_path / "a.csv.gz", run).read_bytes()
    assert first == io.write_csv(tmp_path / "b.csv.gz", [run]).read_bytes()
    assert io.read(tmp_path / "a.csv.gz", ["x"]).names == ("a",)


def test_write_csv_refuses_names_that_would_not_read_back(tmp_path):
    run = Trajectory([0, 1], np.zeros((2, 2)), np.ones((2, 2)), ["x", "x_force"])
    with pytest.raises(InputError, match="called 'x_force'"):
        io.write_csv(tmp_path / "a.csv", run)
    with pytest.raises(InputError, match="called 'trial'"):
        io.write_csv(tmp_path / "a.csv", Trajectory([0, 1], [0, 1], coordinates=["trial"]))
    with pytest.raises(InputError, match="cannot stand"):
        io.write_csv(tmp_path / "a.csv", Trajectory([0, 1], [0, 1], name=" a"))
    assert not list(tmp_path.iterdir())


def test_write_replaces_keeps_mode_and_leaves_nothing_behind(tmp_path):
    path = tmp_path / "new" / "deep" / "a.txt"
    assert io.write_text(path, "eins\r\nθ") == path
    assert path.read_bytes() == "eins\r\nθ".encode()
    assert stat.S_IMODE(path.stat().st_mode) & 0o400
    path.chmod(0o640)
    io.write_bytes(path, b"zwei")
    assert path.read_bytes() == b"zwei"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert os.listdir(path.parent) == ["a.txt"]


def test_write_goes_through_links(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    io.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    io.write_text(path, "old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=r"a.txt cannot be written: No space left on device"):
        io.write_text(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_write_to_bad_places(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a directory"):
        io.write_text(tmp_path, "x")
    with pytest.raises(InputError, match="cannot be written"):
        io.write_text(tmp_path / "file" / "a.txt", "x")
    with pytest.raises(InputError, match="cannot be written"):
        io.write_text(tmp_path / ("a" * 300), "x")
    io.write_text(os.devnull, "x")


# --------------- long files in pieces: the same trajectories as from the whole, from a file instead of memory
def runs(trials: int = 5, rows: int = 40) -> la.Trajectories:
    rng = np.random.default_rng(0)
    items = []
    for k in range(trials):
        t = np.sort(rng.uniform(0.0, 4.0, rows + k))
        q = np.column_stack([3.0 * np.sin(t), rng.standard_normal(t.size)])
        forces = np.cos(q)
        q[k, 1] = np.nan
        items.append(la.Trajectory(t, q, forces, ["a", "b"], f"run {k}", velocities=2.0 * q))
    return la.Trajectories(items)


LAYOUT = {
    "forces": {"a": "a_force", "b": "b_force"},
    "velocities": {"a": "a_dot", "b": "b_dot"},
}


def same(one: la.Trajectories, other: la.Trajectories) -> None:
    assert one.digest() == other.digest()
    assert one.names == other.names
    assert one.wraps_removed == other.wraps_removed


@pytest.fixture(params=["csv", "csv.gz", "parquet"])
def long_file(request, tmp_path, monkeypatch):
    """The runs in a file whose pieces end anywhere."""
    data = runs()
    path = io.write_csv(tmp_path / f"runs.{request.param.replace('parquet', 'csv')}", data)
    monkeypatch.setattr(text_module, "_PIECE", 1000)
    if request.param == "parquet":
        import pandas as pd

        path = tmp_path / "runs.parquet"
        table = pa.Table.from_pandas(pd.read_csv(tmp_path / "runs.csv"))
        parquet.write_table(table, path, row_group_size=33)
    return path


def test_a_stream_is_the_same_as_the_file_read_whole(long_file):
    streamed = la.stream(long_file, ["a", "b"], **LAYOUT)
    same(streamed, la.read(long_file, ["a", "b"], **LAYOUT))
    turned = la.stream(long_file, ["a", "b"], angles=["a"], **LAYOUT)
    same(turned, la.read(long_file, ["a", "b"], angles=["a"], **LAYOUT))


def test_the_samples_are_in_a_file_and_stay_as_they_are(long_file):
    streamed = la.stream(long_file, ["a", "b"], **LAYOUT)
    held = streamed[2].q
    while isinstance(held, np.ndarray):
        assert not held.flags.writeable
        held = held.base
    assert type(held).__name__ in ("mmap", "memoryview")
    assert la.Trajectories(list(pickle.loads(pickle.dumps(streamed)))).digest() == streamed.digest()
    last = streamed[4].rows(slice(5, None))
    del streamed
    assert np.isfinite(last.q[:, 0]).all()


def test_several_files_are_trials_of_one_system(tmp_path):
    data = runs(3)
    first = io.write_csv(tmp_path / "first.csv", data[:2])
    second = io.write_csv(tmp_path / "second.csv", data[2:])
    same(la.stream([first, second], ["a", "b"]), la.read([first, second], ["a", "b"]))


def test_a_file_without_trials_is_one(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 50)
    rows = "".join(f"\n{k},{np.sin(k)}" for k in range(30))
    (tmp_path / "one.csv").write_text("# made by hand\nt,x" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


def test_a_cell_may_hold_line_ends_and_a_piece_does_not_cut_it(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 40)
    rows = "".join(f'\n{k},{k / 7},"a note\nof two lines"' for k in range(12))
    (tmp_path / "one.csv").write_text("t,x,note" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a,0,1"] * 5, r"line 3, column 't': time 0.0 repeats"),
        ([f"{'aabab'[k // 6]},{k},1" for k in range(30)], "continues after another trial .it started at"),
        (
            [f"{'ab'[k // 6]},{k},{'x' if k == 11 else 1}" for k in range(12)],
            r"line 13, column 'x': 'x'",
        ),
        ([f"a,{k},{k}" for k in range(8)] + ["b,8"], r"line 10: there are 2 cells"),
        ([], "no data lines"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, monkeypatch, lines, message):
    monkeypatch.setattr(text_module, "_PIECE", 20)
    (tmp_path / "run.csv").write_text("\n".join(["trial,t,x", *lines]) + "\n")
    with pytest.raises(InputError, match=message):
        la.stream(tmp_path / "run.csv", ["x"])


def test_files_that_cannot_be_streamed(tmp_path):
    with pytest.raises(InputError, match="cannot be read in pieces"):
        la.stream(tmp_path / "run.npz", ["x"])
    with pytest.raises(InputError, match="no such file"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv").write_text("trial,t,x" + "".join(f"\na,{k},1" for k in range(3)))
    with pytest.raises(DataError, match="only 3 sample"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(b"t,x\n" + b"0,1\n" * 50)[:-12])
    with pytest.raises(InputError, match="cannot be read to its end"):
        la.stream(tmp_path / "run.csv.gz", ["x"])
    (tmp_path / "latin.csv").write_bytes(b"t,x\n0,\xe9\n")
    with pytest.raises(InputError, match="line 2, column 'x': 'é' is not a number"):
        la.stream(tmp_path / "latin.csv", ["x"])


def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 20_000)
    peaks = []
    for trials in (5, 40):
        path = io.write_csv(tmp_path / f"{trials}.csv", runs(trials, 400))
        la.stream(path, ["a", "b"], **LAYOUT)  # what is imported on the way
        tracemalloc.start()
        la.stream(path, ["a", "b"], **LAYOUT)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


@pytest.mark.thorough
def test_a_law_is_found_on_a_stream(tmp_path, monkeypatch):
    data = la.systems.generate("single_pendulum", noise=0.05, trials=4, duration=10.0, seed=0)
    path = io.write_csv(tmp_path / "pendulum.csv", data)
    monkeypatch.setattr("leastaction.estimation.streamed._LONG", 1)
    monkeypatch.setattr("leastaction.api.ENOUGH_SAMPLES", data.n_samples // 2)
    options = {"library": la.systems.compact_library("single_pendulum")}
    streamed = la.stream(path, ["theta"], forces={"theta": "theta_force"})
    one, other = la.discover(data, **options), la.discover(streamed, **options)
    assert [t.expression for t in one.terms] == [t.expression for t in other.terms]
    assert [t.coefficient for t in one.terms] == [t.coefficient for t in other.terms]


TYPES = get_typestore(Stores.ROS2_HUMBLE)
STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
START = 1_700_000_000_000_000_000  # ns since 1970
TEN_MS = 10_000_000


def state(stamp, names, position, effort=()):
    make = TYPES.types
    time = make["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
    header = make["std_msgs/msg/Header"](time, "base")
    arrays = (np.asarray(values, dtype=float) for values in (position, [], effort))
    return make[STATE](header, list(names), *arrays)


def plain(k):
    """Sample k of a bag in which nothing is odd."""
    return state(START + k * TEN_MS, ["a", "b"], [k / 10, -k], [1.0, 2.0 + k])


@pytest.fixture
def bag(tmp_path):
    """Return a function that writes messages, by topic, into a bag, and returns the file."""

    def write(messages, name="run", plugin=StoragePlugin.MCAP, compression=False):
        folder = tmp_path / name
        writer = Writer(folder, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        topics = messages if isinstance(messages, dict) else {"/joint_states": messages}
        with writer:
            for topic, items in topics.items():
                kind = items[0].__msgtype__ if items else STATE
                connection = writer.add_connection(topic, kind, typestore=TYPES)
                for k, message in enumerate(items):
                    data = TYPES.serialize_cdr(message, message.__msgtype__)
                    # Recorded 3 ms late, more or less.
                    writer.write(connection, START + k * TEN_MS + 3_000_000 + (k % 3) * 500_000, data)
        return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))

    return write


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("compression", [False, True])
@pytest.mark.parametrize("directory", [False, True])
def test_file_and_directory_of_either_kind(bag, plugin, compression, directory):
    if compression and plugin is not StoragePlugin.MCAP:
        pytest.skip("SQLite bags are compressed as whole files, which need their directory")
    path = bag([plain(k) for k in range(20)], plugin=plugin, compression=compression)
    path = path.parent if directory else path
    runs = io.read(path, {"theta": "b", "phi": "a"}, forces={"theta": "effort"})
    assert runs.names == ("run",)
    np.testing.assert_allclose(runs[0].t, np.arange(20) / 100, atol=1e-12)
    np.testing.assert_array_equal(runs[0].q, np.column_stack([-np.arange(20.0), np.arange(20) / 10]))
    np.testing.assert_array_equal(runs[0].forces, np.column_stack([2.0 + np.arange(20), np.zeros(20)]))


def test_ways_to_name_joints_and_efforts(bag):
    path = bag([plain(k) for k in range(8)])
    all_of_them = dict(coordinates={"a": "a", "b": "b"}, forces={"a": "a.effort", "b": "b.effort"})
    expected = io.read_mcap(path, **all_of_them).digest()
    assert io.read_mcap(path, joints=["a", "b"], forces="effort").digest() == expected
    assert io.read_mcap(path, coordinates=["a", "b"], forces=["effort", "b.effort"]).digest() == expected
    assert io.read(path, ["a", "b"], forces=["effort", "effort"]).digest() == expected
    swapped = io.read_mcap(path, coordinates=["x"], joints="b", forces={"x": "a.effort"})
    np.testing.assert_array_equal(swapped[0].forces[:, 0], np.ones(8))
    assert io.read_mcap(path, joints=["a"])[0].forces is None
    # Of two bags the second one is a trial of its own, which also starts at zero.
    later = bag([plain(k + 100) for k in range(9)], "later")
    runs = io.read_mcap([path, later], joints=["a"])
    assert runs.names == ("run", "later")
    assert runs[1].t[0] == 0.0
    with pytest.raises(InputError, match="leave out joints"):
        io.read_mcap(path, joints=["a"], coordinates={"x": "a"})
    with pytest.raises(InputError, match="1 joints for 2 coordinates"):
        io.read_mcap(path, joints=["a"], coordinates=["x", "y"])
    with pytest.raises(InputError, match="name the joints"):
        io.read_mcap(path)


def test_time_of_recording(bag):
    path = bag([plain(k) for k in range(9)])
    runs = io.read_mcap(path, joints=["a"], time="log")
    np.testing.assert_allclose(runs[0].t, np.arange(9) / 100 + 0.0005 * (np.arange(9) % 3), atol=1e-12)
    unstamped = bag([state(0, ["a"], [k]) for k in range(9)], "unstamped")
    with pytest.warns(DataWarning, match="no stamps; times are those of recording"):
        fallen_back = io.read_mcap(unstamped, joints=["a"])
    np.testing.assert_array_equal(fallen_back[0].t, runs[0].t)
    # A simulated clock starts at zero.
    simulated = bag([state(k * TEN_MS, ["a"], [k]) for k in range(9)], "simulated")
    np.testing.assert_allclose(io.read_mcap(simulated, joints=["a"])[0].t, np.arange(9) / 100)
    some = bag(
        [state(0 if k == 4 else plain(k).header.stamp.sec * 10**9, ["a"], [k]) for k in range(9)], "some"
    )
    with pytest.raises(InputError, match="message 4: the header has no stamp, but others have"):
        io.read_mcap(some, joints=["a"])


def test_sequence_of_joints_and_joints_that_are_lacking(bag):
    messages = []
    for k in range(12):
        names, values, effort = ["a", "b", "gripper"], [k, -k, 7.0], [1.0 + k, 5.0, 0.0]
        kept = [0, 2] if k == 5 else [2] if k == 6 else [2, 1, 0] if k % 2 else [0, 1, 2]
        pick = [[sequence[i] for i in kept] for sequence in (names, values, effort)]
        messages.append(state(START + k * TEN_MS, *pick))
    path = bag(messages)
    runs = io.read_mcap(path, joints=["a", "b"])
    k = np.array([0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11.0])  # message 6 has neither
    np.testing.assert_allclose(runs[0].t, k / 100)
    np.testing.assert_array_equal(runs[0].q, np.column_stack([k, np.where(k == 5, np.nan, -k)]))
    with pytest.warns(DataWarning, match=r"1 of 12 values of a\.effort are missing and were interpolated"):
        driven = io.read_mcap(path, joints=["a"], forces="effort")
    np.testing.assert_allclose(driven[0].forces[:, 0], 1.0 + k)


def test_controllers_with_joints_of_their_own(bag):
    """Two controllers report in turn, with the same stamps or with stamps between."""
    for shift in (0, TEN_MS // 2):
        messages = []
        for k in range(10):
            messages.append(state(START + k * TEN_MS, ["a"], [k], [k]))
            messages.append(state(START + k * TEN_MS + shift, ["b"], [-k], [3.0]))
        path = bag(messages, f"run{shift}")
        q = io.read_mcap(path, joints=["a", "b"])[0].q
        assert q.shape == ((10, 2) if shift == 0 else (20, 2))
        for column, sign in ((0, 1), (1, -1)):
            np.testing.assert_array_equal(q[np.isfinite(q[:, column]), column], sign * np.arange(10.0))


def test_repeated_and_late_messages(bag):
    repeated = [plain(k) for k in (0, 1, 1, 2, 3, 5, 4, 6, 7)]
    path = bag(repeated)
    runs = io.read_mcap(path, joints=["a"])
    np.testing.assert_allclose(runs[0].t, np.arange(8) / 100)
    np.testing.assert_array_equal(runs[0].q[:, 0], np.arange(8) / 10)
    repeated[2] = state(START + TEN_MS, ["a"], [9.0])
    with pytest.warns(DataWarning, match=r"1 message\(s\) repeat a time with other values"):
        runs = io.read_mcap(bag(repeated, "conflict"), joints=["a"])
    np.testing.assert_array_equal(runs[0].q[:, 0], np.arange(8) / 10)
    reset = [*(plain(k) for k in range(500, 510)), *(plain(k) for k in range(8))]
    with pytest.raises(InputError, match=r"message 10: the stamp is 5.09 s before .* clock was set back"):
        io.read_mcap(bag(reset, "reset"), joints=["a"])


def test_topics(bag):
    states = [plain(k) for k in range(8)]
    text = [TYPES.types[STRING]("hello")]
    path = bag({"/left/joint_states": states, "/right/joint_states": states[:6], "/log": text})
    with pytest.raises(InputError, match=r"in the topics '?/left/joint_states'?, .*name one"):
        io.read(path, ["a"])
    assert io.read_mcap(path, joints=["a"], topic="/right/joint_states")[0].n_times == 6
    qualified = io.read(path, {"a": "/left/joint_states:a"}, forces={"a": "/left/joint_states:b.effort"})
    assert qualified[0].n_times == 8
    np.testing.assert_array_equal(qualified[0].forces[:, 0], 2.0 + np.arange(8))
    with pytest.raises(InputError, match="take those of one topic"):
        io.read(path, {"a": "/left/joint_states:a", "b": "/right/joint_states:b"})
    with pytest.raises(InputError, match="no topic '/middle'; with joint states it has"):
        io.read_mcap(path, joints=["a"], topic="/middle")
    with pytest.raises(InputError, match="topic '/log' is of type std_msgs/msg/String"):
        io.read_mcap(path, joints=["a"], topic="/log")
    with pytest.raises(InputError, match=r"has no topic of type .*; its topics are"):
        io.read(bag({"/log": text}, "text"), ["a"])
    with pytest.raises(InputError, match="there is no message"):
        io.read(bag({"/joint_states": []}, "empty"), ["a"])


def test_what_cannot_be_used_is_named(bag, monkeypatch):
    path = bag([plain(k) for k in range(8)])
    with pytest.raises(
        InputError, match=r"no column 'c' .*; its columns are t, log, a, b, 'a\.effort', 'b\.effort'"
    ):
        io.read(path, ["c"])
    with pytest.raises(
        InputError, match=r"on a is the column 'b', which is not an effort; write 'b\.effort'"
    ):
        io.read(path, ["a"], forces=["b"])
    no_effort = bag([state(START + k * TEN_MS, ["a"], [k]) for k in range(8)], "none")
    with pytest.raises(InputError, match=r"there is no effort in column 'a\.effort'"):
        io.read_mcap(no_effort, joints=["a"], forces="effort")
    odd = bag([plain(0), state(START + 1, ["a", "b"], [1.0])], "odd")
    with pytest.raises(InputError, match=r"message 1: there are 1 values of position for 2 joint\(s\)"):
        io.read_mcap(odd, joints=["a"])
    twice = bag([state(START, ["a", "a"], [1.0, 2.0])], "twice")
    with pytest.raises(InputError, match="message 0: a joint is named twice"):
        io.read_mcap(twice, joints=["a"])
    with pytest.raises(DataError, match="only 3"):
        io.read_mcap(bag([plain(k) for k in range(3)], "short"), joints=["a"])
    velocities_only = bag([state(START + k * TEN_MS, ["a"], []) for k in range(8)], "speed")
    with pytest.raises((InputError, DataError), match=r"speed\.mcap"):
        io.read_mcap(velocities_only, joints=["a"])
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ImportError, match=r"pip install 'leastaction\[ros\]'"):
        io.read(path, ["a"])


def one_line(path):
    with pytest.raises((InputError, DataError)) as caught:
        io.read(path, ["a"])
    text = str(caught.value)
    assert path.name in text
    assert "\n" not in text
    assert len(text) < 600
    return text


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_damaged_bags_give_one_readable_line(bag, tmp_path, plugin):
    path = bag([plain(k) for k in range(200)], plugin=plugin)
    data = path.read_bytes()
    for part in (1, 8, 50, len(data) // 2, len(data) - 1):
        cut = tmp_path / f"cut{path.suffix}"
        cut.write_bytes(data[:part])
        try:
            io.read(cut, ["a"])
        except (InputError, DataError):
            assert "cut" in one_line(cut)
        else:
            # SQLite does not look at its last byte.
            assert (plugin, part) == (StoragePlugin.SQLITE3, len(data) - 1)
    for content in (b"", b"t,a\n0,1\n", bytes(5000)):
        other = tmp_path / f"other{path.suffix}"
        other.write_bytes(content)
        one_line(other)
    assert "no such file" in one_line(tmp_path / f"none{path.suffix}")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    one_line(tmp_path / "broken")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8))
def test_flipped_bytes_never_escape(bag, tmp_path, flips):
    path = tmp_path / "good.mcap"
    if not path.exists():
        path.write_bytes(bag([plain(k) for k in range(30)]).read_bytes())
    data = bytearray(path.read_bytes())
    for place, value in flips:
        data[int(place * len(data))] = value
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        try:
            io.read(bad, ["a"])
        except (InputError, DataError):
            one_line(bad)


def test_command_line(bag, tmp_path):
    t = np.arange(800) * TEN_MS
    messages = [state(int(k), ["joint"], [np.cos(2e-9 * k)]) for k in t]
    path = bag(messages)
    command = ["discover", str(path), "--coordinates", "x=joint", "--known", "x_dot**2=1", "--output"]
    (tmp_path / "library.txt").write_text("x_dot**2\nx**2\nx**4")
    command += [str(tmp_path / "found"), "--library", str(tmp_path / "library.txt")]
    done = CliRunner().invoke(program, command)
    assert not done.exit_code, done.stderr
    assert "x**2" in done.stdout
    assert "x**4" not in done.stdout
    unstamped = bag([state(0, ["joint"], [0.1 * k]) for k in range(9)], "unstamped")
    done = CliRunner().invoke(
        program,
        ["validate", str(tmp_path / "found" / "model.json"), str(unstamped), "--coordinates", "x=joint"],
    )
    assert "the headers have no stamps" in done.stderr.partition("warning: ")[2]
