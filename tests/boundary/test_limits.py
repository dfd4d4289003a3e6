"""Hostile files: small ones that unpack to gigabytes, that grow without end, that lie.

Each must be refused in one printable line, with little memory and in little time.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sqlite3
import struct
import time
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import (
    CELLS,
    COLUMNS,
    DEPTH,
    KEYS,
    MIB,
    ROW_LENGTH,
    TEXT_BYTES,
    VALUES,
    csv_rows,
)
from airpuck.boundary.parsing import load_json, load_toml, load_yaml
from airpuck.boundary.terminal import escaped
from airpuck.data.trajectory_file import read_trajectory
from airpuck.recording.mcap_file import read_mcap
from airpuck.recording.message import definitions
from airpuck.recording.read import read_recording
from airpuck.recording.sqlite_file import read_sqlite
from airpuck.recording.torch_archive import read_authors_experiment
from tests.recording.bags import COMMAND_TYPE, foreign_topics, write_mcap
from tests.recording.test_bag import rosbags_folder
from tests.recording.test_torch_archive import archive

GIB = 2**30


@contextlib.contextmanager
def little_memory(size: int = GIB) -> Iterator[None]:
    """Let this process take only so much more memory."""
    status = Path("/proc/self/status").read_text()
    used = 1024 * int(status.split("VmData:")[1].split()[0])
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (used + size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def refusal(read, *arguments, says: str, error: type[ValueError] = InputError) -> str:
    """Return the line in which something is refused within the means of a small machine."""
    start = time.process_time()
    with pytest.raises(error, match=says) as caught, little_memory():
        read(*arguments)
    message = str(caught.value)
    assert message.isprintable()
    assert "memory" not in message
    assert time.process_time() - start < 10
    if error is InputError:
        assert str(arguments[0]) in message
    return message


def written(folder: Path, text: str | bytes, name: str = "a.toml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


# Zip archives.


def zeros_deflated(size: int) -> bytes:
    """Raw deflate of many zeros, made of one block again and again."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(bytes(16 * MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    return block * (size // (16 * MIB)) + zlib.compressobj(9, zlib.DEFLATED, -15).flush()


def zip_member(name: str, data: bytes, *, says: int, method: int = 8, flags: int = 0) -> bytes:
    """A zip file with one member that may say anything about itself, packed by hand."""
    common = struct.pack("<HHHHHIIIHH", 20, flags, method, 0, 0, 0, len(data), says, len(name), 0)
    local = b"PK\3\4" + common + name.encode() + data
    entry = b"PK\1\2" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, 0)
    listed = entry + name.encode()
    return (
        local + listed + b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(listed), len(local), 0)
    )


@pytest.mark.parametrize("says", [4 * GIB - 1, 1000], ids=["honest", "lying"])
def test_a_bomb_in_a_trajectory(tmp_path: Path, says: int):
    path = written(tmp_path, zip_member("about.npy", zeros_deflated(6 * GIB), says=says), "a.npz")
    assert path.stat().st_size < 8 * MIB
    refusal(read_trajectory, path, says="limit of 4 MiB" if says > GIB else "not a trajectory")


def test_a_bomb_in_the_authors_file(tmp_path: Path):
    path = tmp_path / "data.pt"
    path.write_bytes(zip_member("data/data.pkl", zeros_deflated(6 * GIB), says=4 * GIB - 1))
    refusal(read_authors_experiment, path, says="compressed")


def test_a_hole_of_gigabytes_in_the_authors_file(tmp_path: Path):
    whole = archive(tmp_path / "data.pt").read_bytes()
    with zipfile.ZipFile(tmp_path / "data.pt") as content:
        size = content.getinfo("data/data/1").file_size
    # What the list says about the second tensor's storage, and a file that is as long as that.
    said = struct.pack("<II", size, size)
    place = whole.rindex(said)
    patched = whole[:place] + struct.pack("<II", 3 * GIB, 3 * GIB) + whole[place + 8 :]
    path = written(tmp_path, patched, "b.pt")
    refusal(read_authors_experiment, path, says=r"data/data/\d: unpacks to too much")


def npz(path: Path, flight, *, method: int = zipfile.ZIP_DEFLATED, **about) -> Path:
    """A trajectory's file, with something else said beside its arrays."""
    flight.save(path)
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    members["about"] = np.array(json.dumps(json.loads(str(members["about"])) | about))
    with zipfile.ZipFile(path, "w", method) as target:
        for name, array in members.items():
            with target.open(f"{name}.npy", "w") as member:
                np.save(member, array)
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory):
    return read_authors_experiment(archive(tmp_path_factory.mktemp("pt") / "data.pt"))


def test_an_archive_written_by_hand_is_read(tmp_path: Path, flight):
    back = read_trajectory(npz(tmp_path / "a.npz", flight, delay_s=0.5, delay_known=True))
    assert np.array_equal(back.state, flight.state)
    assert back.delay == 0.5


@pytest.mark.parametrize(
    ("about", "field"),
    [
        ({"delay_s": "soon"}, "delay_s"),
        ({"delay_s": [0.1, 0.2]}, "delay_s"),
        ({"delay_s": None}, "delay_s"),
        ({"delay_s": float("nan")}, "delay_s"),
        ({"delay_s": 10**400}, "number"),
        ({"excluded": 7}, "excluded"),
        ({"excluded": [{"start": "a", "stop": 1.0, "cause": "gap"}]}, "excluded.0.start"),
        ({"excluded": [[0.0, 1.0]]}, "excluded.0"),
        ({"hashes": ["a"]}, "hashes"),
        ({"hashes": {"a": 7}}, "hashes.a"),
        ({"propellers": 6}, "propellers"),
        ({"propellers": ["a", "b"]}, "command"),
        ({"warnings": {}}, "warnings"),
        ({"format": ["airpuck"]}, "format"),
    ],
)
def test_what_a_trajectory_says_about_itself(tmp_path: Path, flight, about, field: str):
    assert field in refusal(read_trajectory, npz(tmp_path / "a.npz", flight, **about), says=".")


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_ways_of_packing(tmp_path: Path, flight, method: int):
    refusal(read_trajectory, npz(tmp_path / "a.npz", flight, method=method), says="about.*deflate")


@pytest.mark.parametrize(
    ("method", "flags", "says"), [(8, 1, "encrypted"), (99, 0, "another method")]
)
def test_encrypted_and_unknown_members(tmp_path: Path, method: int, flags: int, says: str):
    content = zip_member("about.npy", b"x" * 50, says=50, method=method, flags=flags)
    refusal(read_trajectory, written(tmp_path, content, "a.npz"), says=says)


@pytest.mark.parametrize(
    "text", ['{"format": ' + "[" * 100_000 + "]" * 100_000 + "}", '{"a": ' + "9" * 5000 + "}"]
)
def test_what_is_said_is_nested_or_long(tmp_path: Path, flight, text: str):
    path = npz(tmp_path / "a.npz", flight)
    with zipfile.ZipFile(path, "w") as target, target.open("about.npy", "w") as member:
        np.save(member, np.array(text))
    refusal(read_trajectory, path, says="nested|digits")


def test_an_archive_of_very_many_members(tmp_path: Path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as target:
        for number in range(30_000):
            target.writestr(f"member_of_a_long_name_{number}", b"")
    refusal(read_trajectory, path, says="list of members is too long")


# Bags.


def zeros_zstd(size: int) -> bytes:
    """A Zstandard frame of many zeros, in blocks of one repeated byte, without its size."""
    block = struct.pack("<I", 2**17 << 3 | 1 << 1)[:3] + b"\0"
    return b"\x28\xb5\x2f\xfd\x00\x38" + block * (size // 2**17) + b"\x01\x00\x00"


def zeros_lz4(size: int) -> bytes:
    """An LZ4 frame of many zeros: one compressed block, again and again."""
    import lz4.frame

    with lz4.frame.LZ4FrameCompressor(
        block_size=lz4.frame.BLOCKSIZE_MAX4MB, block_linked=False
    ) as c:
        head = c.begin()
        block = c.compress(bytes(4 * MIB))
    return head + block * (size // (4 * MIB)) + bytes(4)


def with_chunks(path: Path, data: bytes, compression: str, says: int, times: int = 1) -> Path:
    """A good bag with chunks added that may say anything."""
    whole = write_mcap(path, foreign_topics()).read_bytes()
    name = compression.encode()
    content = struct.pack("<QQQII", 1, 2, says, 0, len(name)) + name
    content += struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", 6, len(content)) + content
    head = 8 + 9 + struct.unpack_from("<Q", whole, 9)[0]
    path.write_bytes(whole[:head] + record * times + whole[head:])
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("size", [6 * GIB, GIB])
def test_a_bomb_that_says_so(tmp_path: Path, compression: str, size: int):
    data = zeros_zstd(size) if compression == "zstd" else zeros_lz4(size)
    path = with_chunks(tmp_path / "a.mcap", data, compression, size)
    refusal(read_recording, path, says="limit of 256 MiB")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_bomb_that_lies_costs_only_its_chunk(tmp_path: Path, compression: str):
    whole = read_recording(write_mcap(tmp_path / "b.mcap", foreign_topics()))
    data = zeros_zstd(6 * GIB) if compression == "zstd" else zeros_lz4(6 * GIB)
    path = with_chunks(tmp_path / "a.mcap", data, compression, 1000)
    with little_memory():
        recording = read_recording(path)
    assert recording.streams == whole.streams
    assert "1 damaged chunk" in recording.warnings[0]


def test_many_chunks_that_unpack_to_gigabytes(tmp_path: Path):
    import zstandard

    # One record of a kind that nobody knows.
    chunk = struct.pack("<BQ", 200, 128 * MIB - 9) + bytes(128 * MIB - 9)
    data = zstandard.ZstdCompressor(1).compress(chunk)
    path = with_chunks(tmp_path / "a.mcap", data, "zstd", len(chunk), times=50)
    refusal(read_recording, path, says="unpacks to more than 100 times")


def test_chunks_of_very_many_messages(tmp_path: Path):
    """A kilobyte of zeros and ones makes a million messages, each of which takes time."""
    import zstandard

    record = struct.pack("<BQHIQQ", 5, 22, 2, 0, 5, 5)
    data = record * (30 * MIB // len(record))
    packed = zstandard.ZstdCompressor().compress(data)
    path = with_chunks(tmp_path / "a.mcap", packed, "zstd", len(data), times=20)
    refusal(read_recording, path, says="unpacks to more than 100 times")


def test_a_chunk_of_empty_records(tmp_path: Path):
    import zstandard

    chunk = struct.pack("<BQ", 200, 0) * 20_000_000
    data = zstandard.ZstdCompressor(1).compress(chunk)
    path = with_chunks(tmp_path / "a.mcap", data, "zstd", len(chunk))
    refusal(read_recording, path, says="too many records")


def test_a_whole_file_that_unpacks_to_gigabytes(tmp_path: Path):
    path = written(tmp_path, zeros_zstd(6 * GIB), "a.db3.zstd")
    refusal(read_recording, path, says="unpacks to more than 100 times")


def test_an_index_in_circles(tmp_path: Path):
    """Lengths and offsets that lead back or beyond the file."""
    content = bytearray(write_mcap(tmp_path / "a.mcap", foreign_topics()).read_bytes())
    for length in (0, 2**63, 2**64 - 1):
        struct.pack_into("<Q", content, len(content) - 28, length)
        (tmp_path / "a.mcap").write_bytes(content)
        assert len(read_recording(tmp_path / "a.mcap")["pose"]) == 960


def test_a_topic_with_a_message_that_is_too_long(tmp_path: Path):
    topics = foreign_topics()
    msgtype, text, messages = topics["/drone/control"]
    topics["/drone/control"] = (msgtype, text, [*messages, (messages[-1][0], bytes(2 * MIB))])
    refusal(read_recording, write_mcap(tmp_path / "a.mcap", topics), says="limit of 1 MiB")


def test_long_messages_of_other_topics_are_passed_over(tmp_path: Path):
    topics = foreign_topics()
    start = topics["/rosout"][2][0][0]
    pictures = [(start + i, bytes([i]) * (3 * MIB)) for i in range(5)]
    topics["/camera"] = ("sensor_msgs/msg/Image", "uint8[] data\n", pictures)
    path = write_mcap(tmp_path / "a.mcap", topics)
    with little_memory(100 * MIB):
        recording = read_recording(path)
    assert len(recording["pose"]) == 960
    assert read_mcap(path, {"/drone/control"}).n_messages == 960 + 400 + 40 + 5


@pytest.mark.parametrize(
    ("statement", "says"),
    [
        ("UPDATE messages SET data = zeroblob(30000000) WHERE id < 5", "too big"),
        ("UPDATE topics SET name = hex(zeroblob(400000))", "too long a name"),
        ("UPDATE message_definitions SET encoded_message_definition = zeroblob(9)", "no text"),
    ],
)
def test_blobs_in_a_database(tmp_path: Path, statement: str, says: str):
    rosbags_folder(tmp_path / "bag")
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute(statement)
    refusal(read_recording, tmp_path / "bag" / "bag.db3", says=says)


def test_a_generated_column_of_gigabytes(tmp_path: Path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.executescript(f"""
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT);
            INSERT INTO topics VALUES (1, '/drone/control', '{COMMAND_TYPE}');
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
                data BLOB GENERATED ALWAYS AS (zeroblob(900000)) VIRTUAL);
            WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 9000)
            INSERT INTO messages(topic_id, timestamp) SELECT 1, i FROM n;
        """)
    refusal(read_recording, path, says="longer than the file")
    # Messages on other topics are not even made.
    assert read_sqlite(path, {"/nothing"}).n_messages == 9000


def test_tables_that_are_none(tmp_path: Path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.executescript("""
            CREATE TABLE topics(id, name, type);
            CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
                SELECT 1 AS topic_id, i AS timestamp, zeroblob(1000) AS data FROM n;
        """)
    refusal(read_recording, path, says="no tables")


# Message definitions.

LINE = "=" * 80 + "\n"


def chain(depth: int, width: int, array: str = "") -> str:
    """Types of which each holds the next some times."""
    parts = [
        f"{LINE}MSG: a/msg/A{i}\n" + "".join(f"A{i + 1}{array} f{k}\n" for k in range(width))
        for i in range(1, depth)
    ]
    first = "".join(f"A1{array} f{k}\n" for k in range(width))
    return first + "".join(parts) + f"{LINE}MSG: a/msg/A{depth}\nuint8 x\n"


@pytest.mark.parametrize(
    "text",
    [
        chain(15, 2),
        chain(15, 10, "[10]"),
        chain(300, 2, "[]"),
        chain(15, 10).replace("uint8 x\n", ""),
        "string[1000000] x\n",
        "float64[4000000000] x\n",
        "float64[-5] x\n",
        "".join(f"float64 f{i}\n" for i in range(5000)),
        "int32 A=" + "9" * 5000 + "\n",
        "float64 x" * 20_000,
        "A[] again\n",
    ],
    ids=lambda text: f"{len(text)}-{text[:12]!r}",
)
def test_definitions_that_grow(tmp_path: Path, text: str):
    topics = foreign_topics()
    messages = topics["/drone/control"][2]
    topics["/drone/control"] = ("a/msg/A", text, messages)
    message = refusal(read_recording, write_mcap(tmp_path / "a.mcap", topics), says="a/msg/A")
    assert "/drone/control" in message


IDL = "module a {{ module msg {{ {} struct A {{ double x; }}; }}; }};"


@pytest.mark.parametrize(
    "text",
    [
        IDL.format("const long c = " + "(" * 9 + "1" + ")" * 9 + ";"),
        IDL.format("const long c = 1 << 99999999999;"),
        IDL.format("const long c = 1 | 2 ^ 3 & 4;"),
        IDL.format("const long c = 3;" + "const long d = c * c;" * 40),
        IDL.format("@a(b=1) " * 2000),
        "module a { " * 2000,
    ],
    ids=lambda text: text[18:50],
)
def test_definitions_that_compute(text: str):
    refusal(
        lambda: definitions("a/msg/A", text, idl=True),
        says="a/msg/A (is defined|computes)|definition of a/msg/A",
        error=ValueError,
    )


def test_a_definition_with_comments_and_annotations():
    text = """
        @verbatim (language="comment", text="Two (2) * products << 3.")
        /* ((( */ // (((
    """
    types = definitions("a/msg/A", IDL.format(text + "const long N = -5;"), idl=True)
    assert "a/msg/A" in types


# Texts.


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 100_000, "nested"),
        ("a = " + "[" * (DEPTH + 1) + "]" * (DEPTH + 1), "nested"),
        ("a = " + "{b=" * 3000 + "1" + "}" * 3000, "nested"),
        (".".join("a" * 50_000) + " = 1", "nested"),
        ("[" + ".".join(["a"] * 50_000) + "]", "nested"),
        ('"a" . ' * 1000 + "b = 1", "nested"),
        ("".join(f"k{i} = 1\n" for i in range(KEYS + 1)), "keys"),
        ("".join(f"[t{i}]\n" for i in range(KEYS + 2)), "keys"),
        ("a = [" + "1," * (VALUES + 1) + "]", "values"),
        ("a = " + "9" * 5000, "digits"),
        ("a = " + "9" * 4000, "64 bits"),
        ("a = 0x" + "f" * 17, "64 bits"),
        ("#" * (TEXT_BYTES + 1), "too long"),
        ("'" * 999_999, "not valid TOML"),
        ('"""' * 300_000, "not valid TOML"),
        ("a" * 1_000_000, "not valid TOML"),
        ('a = "\x1b[2J"', "not valid TOML"),
    ],
    ids=lambda value: value[:20] if len(value) < 30 else f"{value[:10]}-{len(value)}",
)
def test_hostile_toml(tmp_path: Path, text: str, says: str):
    refusal(load_toml, written(tmp_path, text), says=says)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a":' * 100_000, "nested"),
        ('{"a":' + "[" * 500 + "]" * 500 + "}", "nested"),
        ('{"a": ' + "9" * 5000 + "}", "digits"),
        ("{" + ",".join(f'"{i}": 1' for i in range(KEYS + 1)) + "}", "keys"),
        ("[1]", "object"),
        ("\xff", "not valid JSON"),
    ],
)
def test_hostile_json(tmp_path: Path, text: str, says: str):
    refusal(load_json, written(tmp_path, text, "a.json"), says=says)


#: Each line repeats the one above three times.
REPEATED = "".join(f"a{i + 1}: &a{i + 1} [*a{i}, *a{i}, *a{i}]\n" for i in range(25))
MERGED = "".join(f"k{i}: &k{i} {{<<: [*a, *a]}}\n" for i in range(9))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: b\n" * 4_000_000, "too long"),
        ("[" * 2_000, "nested"),
        ("a: &a [1,1]\n" + MERGED, "merges"),
        ("a0: &a0 [1]\n" + REPEATED, "values"),
        ("a: &a [*a]\n", "nested"),
        ("a: " + "9" * 5000, "digits"),
        ("a: !!python/object/apply:os.system [ls]", "not valid YAML"),
    ],
    ids=lambda value: f"{value[:8]!r}-{len(value)}",
)
def test_hostile_yaml(tmp_path: Path, text: str, says: str):
    refusal(load_yaml, written(tmp_path, text, "a.yaml"), says=says)


def test_a_hostile_summary_does_not_keep_a_bag_from_being_read(tmp_path: Path):
    rosbags_folder(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text("a: b\n" * 4_000_000)
    assert len(read_recording(tmp_path / "bag")["pose"]) == 5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (",".join(map(str, range(COLUMNS + 1))) + "\n", "columns"),
        ("a," * 1_000_000 + "\n", "too long a line"),
        ("a" * (ROW_LENGTH + 1), "too long a line"),
        ('"\n",' * (ROW_LENGTH // 3), "too long a line"),
        ('a\n"' + "x\n" * 200_000, "field larger"),
        (b"a,b\n\xff\xfe\n", "not a text file"),
    ],
    ids=lambda value: f"{value[:5]!r}-{len(value)}",
)
def test_hostile_tables(tmp_path: Path, text: str | bytes, says: str):
    path = written(tmp_path, text, "a.csv")
    refusal(lambda path: list(csv_rows(path)), path, says=says)


def test_a_table_of_very_many_cells(tmp_path: Path):
    row = "1," * (COLUMNS - 1) + "1\n"
    path = written(tmp_path, row * (CELLS // COLUMNS + 1), "a.csv")
    refusal(lambda path: sum(1 for _ in csv_rows(path)), path, says="cells")


@pytest.mark.parametrize("read", [load_toml, load_json, load_yaml])
def test_an_endless_device(read):
    refusal(read, Path("/dev/zero"), says="too long")


def test_running_out_of_memory_is_one_line(tmp_path: Path):
    path = written(tmp_path, "a,b\n" + "123,456\n" * 400_000, "control.csv")
    with pytest.raises(InputError, match="needs more memory") as caught, little_memory(20 * MIB):
        read_recording(path.parent)
    assert str(tmp_path) in str(caught.value)


# Names.


@pytest.mark.parametrize("name", ["\x1b[2J\x1b[31mred", "a\nb", "\u202eevil", "\udcff", "a\x00b"])
def test_names_reach_no_terminal(name: str):
    error = InputError(f"has {name!s}", file=f"dir/{name}", field=name)
    assert str(error).isprintable()
    assert error.problem.isprintable()
    os.write(os.open(os.devnull, os.O_WRONLY), str(error).encode())


def test_what_can_be_printed_stays_as_it_is():
    assert escaped("γ [m/s²], 日本 ✓") == "γ [m/s²], 日本 ✓"
    assert escaped("\x1b[1m\tx\n") == r"\x1b[1m\tx\n"
    assert str(InputError("has a\n  line", file="a b")) == "a b: has a line"
    assert len(str(InputError("x" * 10**6, field="y" * 10**6))) < 5000
