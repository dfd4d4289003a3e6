import os
import pickle
import tempfile
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.recording.torch_archive import Refused, read_authors_experiment, read_inert

from ..apparatus.examples import examples
from ..apparatus.refusals import rejected
from ..apparatus.torch_archives import archive, dictionary, good_arrays, tensor, text


def test_a_valid_archive_is_read(tmp_path: Path):
    arrays = good_arrays()
    trajectory = read_authors_experiment(archive(tmp_path / "data.pt", arrays))
    assert np.array_equal(trajectory.time, arrays["T"])
    assert np.array_equal(trajectory.state, arrays["X"])
    assert np.array_equal(trajectory.command, arrays["U"])
    assert np.array_equal(trajectory.command_time, arrays["T"])
    assert np.array_equal(trajectory.acceleration, arrays["dX"][:, 3:])
    assert trajectory.delay == 0
    assert not trajectory.delay_known
    assert trajectory.propellers[0] == "motor_a_1"
    assert set(trajectory.hashes) == {"data.pt"}
    assert trajectory.source == str(tmp_path / "data.pt")


def test_a_folder_stands_for_its_file(tmp_path: Path):
    archive(tmp_path / "data.pt")
    assert len(read_authors_experiment(tmp_path)) == 50


def test_wrapped_yaw_is_unwrapped_and_other_yaw_unchanged(tmp_path: Path):
    arrays = good_arrays()
    yaw = np.linspace(3, 9, 50)
    arrays["X"][:, 2] = np.arctan2(np.sin(yaw), np.cos(yaw))
    state = read_authors_experiment(archive(tmp_path / "data.pt", arrays)).state
    assert state[:, 2] == pytest.approx(yaw, abs=1e-12)


def test_strides_and_offsets_are_respected(tmp_path: Path):
    arrays = good_arrays()
    n = 50
    stored = {**arrays, "X": np.concatenate([[np.nan] * 7, arrays["X"].T.ravel()])}
    moved = {"X": tensor("1", 7 + 6 * n, (n, 6), (1, n), offset=7)}
    path = archive(tmp_path / "data.pt", stored, tensors=moved)
    assert np.array_equal(read_authors_experiment(path).state, arrays["X"])


def test_big_endian_storages_are_read(tmp_path: Path):
    arrays = good_arrays()
    members = {
        f"data/data/{index}": array.astype(">f8").tobytes()
        for index, array in enumerate(arrays.values())
    }
    path = archive(tmp_path / "data.pt", arrays, members={**members, "data/byteorder": b"big"})
    assert np.array_equal(read_authors_experiment(path).state, arrays["X"])


def test_several_experiments_are_selected_by_name(tmp_path: Path):
    path = archive(tmp_path / "data.pt", names=("first", "second"))
    with pytest.raises(InputError, match=r"contains 2 experiments.*\(first, second\)"):
        read_authors_experiment(path)
    assert len(read_authors_experiment(path, name="second")) == 50
    with pytest.raises(InputError, match="no experiment 'third'"):
        read_authors_experiment(path, name="third")


def changed(key: str, change) -> dict[str, np.ndarray]:
    arrays = good_arrays()
    arrays[key] = change(arrays[key])
    return arrays


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"without": "exps"}, "has no 'exps'"),
        ({"without": "dX"}, "has no 'dX'"),
        ({"arrays": changed("X", lambda x: x[:, :5])}, r"'X' has the shape \(50, 5\)"),
        ({"arrays": changed("U", lambda u: u[:-1])}, r"'U' has the shape \(49, 6\)"),
        ({"arrays": changed("T", lambda t: t[:, None])}, r"'T' has the shape \(50, 1\)"),
        ({"arrays": {key: a[:1] for key, a in good_arrays().items()}}, "time: must have 2 entries"),
        ({"arrays": {key: a[:0] for key, a in good_arrays().items()}}, "is empty"),
        ({"arrays": changed("X", lambda x: np.nan * x)}, "state: must be finite numbers"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), kind="Float")}}, "torch.FloatStorage"),
        ({"tensors": {"X": tensor("1", 299, (50, 6))}}, "wrong length"),
        ({"tensors": {"X": tensor("9", 300, (50, 6))}}, "is missing"),
        ({"tensors": {"X": tensor("../0", 300, (50, 6))}}, "wrong name"),
        ({"tensors": {"X": tensor("1", -1, (50, 6))}}, "wrong name or size"),
        ({"tensors": {"X": tensor("1", 2**62, (50, 6))}}, "wrong length"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), (6, 2))}}, "beyond its storage"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), (2**60, 1))}}, "beyond its storage"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), (-6, 1))}}, "wrong offset, shape or stride"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), offset=1)}}, "beyond its storage"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), offset=-1)}}, "wrong offset"),
        ({"tensors": {"X": tensor("1", 300, (2**40, 6), (0, 1))}}, "has the shape"),
        ({"tensors": {"X": tensor("1", 300, (50, 6), (6,))}}, "wrong offset, shape or stride"),
        ({"tensors": {"X": tensor("1", 300, (1,) * 100)}}, "wrong offset, shape or stride"),
        ({"tensors": {"X": tensor("1", 300, (1, 1), (2**66, 1))}}, "wrong offset, shape or stride"),
        ({"tensors": {"X": tensor("1", 300, (1, 1), (2**62, 1))}}, "has the shape"),
        ({"tensors": {"X": text("no tensor")}}, "something other than a tensor"),
        ({"names": ()}, "contains 0 experiments"),
        ({"members": {"data/byteorder": b"middle"}}, "byte order is unknown"),
        ({"members": {"other/data.pkl": b"}."}}, "one data.pkl"),
        ({"data_pickle": b"}."}, "has no 'exps'"),
        ({"data_pickle": b"K\x01."}, "has no 'exps'"),
        ({"data_pickle": b""}, "is damaged"),
        ({"data_pickle": pickle.dumps(print)}, "not an experiment of the authors: it"),
        ({"data_pickle": b"cos\nsystem\n" + text("true") + b"\x85R."}, "os.system"),
    ],
)
def test_errors_are_one_clear_line(tmp_path: Path, options: dict, says: str):
    path = archive(tmp_path / "data.pt", **options)
    with rejected(path, match=says):
        read_authors_experiment(path)


def test_tensors_of_different_experiments_are_rejected(tmp_path: Path):
    parts = {
        key: tensor(str(i), a.size, a.shape) for i, (key, a) in enumerate(good_arrays().items())
    }
    content = {key: dictionary({f"flight of {key}": part}) for key, part in parts.items()}
    content["exps"] = text("names")
    path = archive(tmp_path / "data.pt", data_pickle=dictionary(content) + b".")
    with pytest.raises(InputError, match="not of the same experiments"):
        read_authors_experiment(path)


def test_a_zip_bomb_is_not_unpacked(tmp_path: Path):
    path = archive(
        tmp_path / "data.pt",
        members={"data/data/1": bytes(200_000_000)},
        tensors={"X": tensor("1", 25_000_000, (50, 6))},
        compression=zipfile.ZIP_DEFLATED,
    )
    assert path.stat().st_size < 1_000_000
    with pytest.raises(InputError, match="compressed"):
        read_authors_experiment(path)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\0" * 500, pickle.dumps({"T": 1})])
def test_a_file_that_is_not_an_archive_is_rejected(tmp_path: Path, content: bytes):
    path = tmp_path / "data.pt"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a readable torch file"):
        read_authors_experiment(path)


def test_a_missing_file_is_reported(tmp_path: Path):
    for path in (tmp_path / "data.pt", tmp_path):
        with pytest.raises(InputError, match="no such file"):
            read_authors_experiment(path)


@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("2023_10_18-11_28_12_sysid_h1_old", 20083),
        ("2023_11_22-11_57_44_sysid_h1_old", 23417),
        ("2024_03_05-16_12_50_sysid_h1_blue", 14549),
    ],
)
def test_the_authors_files_are_read(experiments: Path, name: str, n: int):
    path = experiments / name / "data.pt"
    trajectory = read_authors_experiment(path)
    with zipfile.ZipFile(path) as members:
        t, x, u, dx = (np.frombuffer(members.read(f"data/data/{i}")) for i in range(4))
    assert len(trajectory) == n
    assert np.array_equal(trajectory.time, t)
    assert np.array_equal(trajectory.state, x.reshape(n, 6))
    assert np.array_equal(trajectory.command, u.reshape(n, 6))
    assert np.array_equal(trajectory.acceleration, dx.reshape(n, 6)[:, 3:])
    # The held input of each sample is the authors' own row.
    assert np.array_equal(trajectory.input, trajectory.command)


executed: list[str] = []


def run(argument: str) -> str:
    executed.append(argument)
    return argument


class Calls:
    """Pickles as a call of a given function."""

    def __init__(self, function, *arguments) -> None:
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [2, 4])
def test_plain_dictionaries_are_read(protocol: int):
    content = {"a": {"b": 1, "c": "text"}, "d": (1, 2, 3, 4), "e": None, "f": (True, 70000)}
    assert read_inert(pickle.dumps(content, protocol)) == content


#: Written if a shell ever runs; the folder is ours alone.
REACHED = Path(tempfile.mkdtemp()) / "reached"
HOSTILE = {
    "a shell": Calls(os.system, f"echo > {REACHED}"),
    "eval": Calls(eval, "1"),
    "our own function": Calls(run, "reached"),
    "getattr": Calls(getattr, "", "upper"),
    "a list": [1],
    "a set": {1},
    "a float": 1.5,
    "a class": Calls,
    "within a dictionary": {"T": {"x": Calls(run, "reached")}},
    "as a key": {Calls(run, "reached"): 1},
}


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("name", HOSTILE)
def test_other_pickles_are_rejected_and_not_executed(name: str, protocol: int):
    data = pickle.dumps(HOSTILE[name], protocol)
    with pytest.raises(Refused):
        read_inert(data)
    assert executed == []
    assert not REACHED.exists()


def test_the_hostile_pickles_would_execute_in_plain_pickle():
    pickle.loads(pickle.dumps(HOSTILE["our own function"]))
    assert executed == ["reached"]
    executed.clear()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"cos\nsystem\n(X\x02\x00\x00\x00lstR.", "os.system"),
        (b"cposix\nsystem\n.", "posix.system"),
        (b"cbuiltins\neval\n.", "builtins.eval"),
        (b"cnumpy\nload\n.", "numpy.load"),
        (b"ctorch\nload\n.", "torch.load"),
        (b"ctorch\n\xc3\x89vilStorage\n.", "it names"),
        (b"cairpuck.recording.torch_archive\nread_inert\n.", "it names"),
        (b"cnumpy\nndarray\n)R.", "damaged"),
        (b"ctorch\nDoubleStorage\n)R.", "damaged"),
        (b"X\x01\x00\x00\x00a)R.", "damaged"),
        (b"(i__main__\nrun\n.", "INST"),
        (b"\x8c\x02os\x8c\x06system\x93.", "STACK_GLOBAL"),
        (b"\x82\x01.", "EXT1"),
        (b"\x84\x01\x00\x00\x00.", "EXT4"),
        (b"cnumpy\nndarray\n)\x81.", "NEWOBJ"),
        (b"Pstorage\n.", "PERSID"),
        (b"K\x01Q.", "damaged"),
        (b"}(K\x01K\x02u.", "a key is not text"),
        (b"}(X\x01\x00\x00\x00au.", "damaged"),
        (b"K\x01(K\x02K\x03u.", "damaged"),
        (b"cnumpy\ndtype\nX\x01\x00\x00\x00aK\x01s.", "damaged"),
        (b"c_codecs\nencode\n(X\x01\x00\x00\x00aX\x04\x00\x00\x00zlibtR.", "unknown encoding"),
        (b"", "damaged"),
        (b".", "damaged"),
        (b"}", "damaged"),
        (b"h\x07.", "damaged"),
        (b"u.", "damaged"),
        (b"X\xff\xff\xff\x7fa", "damaged"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f", "BINBYTES8"),
        (b"\x95\xff\xff\xff\xff\xff\xff\xff\x7f}", "damaged"),
        (b"\xff\xfe", "damaged"),
        (b"(" * 5000 + b".", "damaged"),
        (b"\x80\x02" + b"}0" * 60000 + b".", "longer"),
    ],
)
def test_rejected_pickles_state_the_reason(data: bytes, says: str):
    with pytest.raises(Refused, match=says) as caught:
        read_inert(data)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "target", [b"cnumpy\ndtype\n", b"c_codecs\nencode\n", b"cnumpy\ndtype\n)R", b"}"]
)
def test_attributes_cannot_be_set(target: bytes):
    """BUILD sets attributes of the object on the stack; it must not reach our functions."""
    fill = dictionary({"__doc__": text("hostile"), "__defaults__": b"(K\x01t"})
    for state in (fill, b"N" + fill + b"\x86"):
        try:
            found = read_inert(target + state + b"b.")
        except Refused:
            continue
        assert getattr(found, "__doc__", None) != "hostile"
        assert getattr(found, "__defaults__", None) is None


@pytest.mark.parametrize(
    "data",
    [
        # A memo index, which Python's reader in C would reserve memory for.
        b"}r\xff\xff\xff\xff.",
        # Sixty thousand levels, each holding the one below twice; then used as a key or a shape.
        b")" + b"q\x00h\x00\x86" * 15000 + b".",
        b"}(" + b")" + b"q\x00h\x00\x86" * 15000 + b"K\x01u.",
        b"ctorch._utils\n_rebuild_tensor_v2\n(NK\x00)" + b"q\x00h\x00\x86" * 15000 + b")NNtR.",
        # Calls that would copy a long text again and again, and the memo keep them all.
        b"c_codecs\nencode\nq\x01" + text("a" * 40000) + b"q\x00" + text("latin1")
        + b"q\x02\x86R" + b"h\x01h\x00h\x02\x86R\x86" * 6000 + b".",
        b"c_codecs\nencode\nq\x01" + text("a" * 1900) + b"q\x00" + text("latin1")
        + b"q\x02\x86R" + b"h\x01h\x00h\x02\x86R\x86" * 10000 + b".",
        # Many arguments, repeatedly.
        b"cnumpy\ndtype\nq\x01(" + b"N" * 40000 + b"tq\x02" + b"h\x01h\x02R0" * 1 + b".",
        b"cnumpy\ndtype\nq\x01(" + b"N" * 30000 + b"tq\x02" + b"h\x01h\x02R" * 13000 + b".",
        b"(" * 99000,
        b"}" * 99000 + b".",
    ],
    ids=range(10),
)  # fmt: skip
def test_no_pickle_consumes_memory_or_time(tmp_path: Path, data: bytes):
    path = archive(tmp_path / "data.pt", data_pickle=data)
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(InputError, match="is not an experiment of the authors") as caught:
        read_authors_experiment(path)
    assert time.process_time() - start < 10
    assert tracemalloc.get_traced_memory()[1] < 60e6
    tracemalloc.stop()
    assert "\n" not in str(caught.value)


@examples(300)
@given(st.binary(max_size=60))
def test_junk_is_rejected_or_plain_data(junk: bytes):
    try:
        read_inert(junk)
    except Refused as refusal:
        assert str(refusal).isprintable()


@examples(300)
@given(data=st.data())
def test_modified_pickles_are_rejected_or_plain_data(data: st.DataObject):
    content = bytearray(pickle.dumps({"T": {"x": (1, 2)}, "X": {"y": "text"}}, 2))
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        read_inert(bytes(content))
    except Refused as refusal:
        assert str(refusal).isprintable()
