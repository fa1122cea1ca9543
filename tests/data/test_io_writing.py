"""Writing: CSV files that read back exactly, and files that are never half written."""

import os
import stat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leastaction import io
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError

NAN = float("nan")
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
