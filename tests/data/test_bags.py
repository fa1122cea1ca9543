"""Joint states from ROS 2 bags; the bags are written by rosbags."""

import sys
import warnings

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from leastaction import DataError, InputError, io
from leastaction.cli import program
from leastaction.errors import DataWarning

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
