"""Bags that unpack to gigabytes or have false headers; definitions that grow without end."""

import sqlite3
import struct
from pathlib import Path

import pytest

from airpuck.boundary.limits import MIB
from airpuck.recording.mcap_file import read_mcap
from airpuck.recording.message import definitions
from airpuck.recording.read import read_recording
from airpuck.recording.sqlite_file import read_sqlite

from ..apparatus.bags import (
    COMMAND_TYPE,
    foreign_topics,
    rosbags_folder,
    write_channels,
    write_mcap,
)
from ..apparatus.refusals import GIB, little_memory, refusal, written


def zeros_zstd(size: int) -> bytes:
    """A Zstandard frame of many zeros, in blocks of one repeated byte, without its size."""
    block = struct.pack("<I", 2**17 << 3 | 1 << 1)[:3] + b"\0"
    return b"\x28\xb5\x2f\xfd\x00\x38" + block * (size // 2**17) + b"\x01\x00\x00"


def zeros_lz4(size: int) -> bytes:
    """An LZ4 frame of many zeros: one compressed block, repeated."""
    import lz4.frame

    with lz4.frame.LZ4FrameCompressor(
        block_size=lz4.frame.BLOCKSIZE_MAX4MB, block_linked=False
    ) as c:
        head = c.begin()
        block = c.compress(bytes(4 * MIB))
    return head + block * (size // (4 * MIB)) + bytes(4)


def with_chunks(path: Path, data: bytes, compression: str, says: int, times: int = 1) -> Path:
    """A good bag with additional chunks whose headers may claim anything."""
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
def test_a_chunk_that_declares_too_large_a_size_is_rejected(
    tmp_path: Path, compression: str, size: int
):
    data = zeros_zstd(size) if compression == "zstd" else zeros_lz4(size)
    path = with_chunks(tmp_path / "a.mcap", data, compression, size)
    refusal(read_recording, path, says="limit of 256 MiB")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_larger_than_declared_costs_only_itself(tmp_path: Path, compression: str):
    whole = read_recording(write_mcap(tmp_path / "b.mcap", foreign_topics()))
    data = zeros_zstd(6 * GIB) if compression == "zstd" else zeros_lz4(6 * GIB)
    path = with_chunks(tmp_path / "a.mcap", data, compression, 1000)
    with little_memory():
        recording = read_recording(path)
    assert recording.streams == whole.streams
    assert "1 damaged chunk" in recording.warnings[0]


@pytest.mark.parametrize(
    ("record", "count", "times", "says"),
    [
        # One record of an unknown kind.
        (struct.pack("<BQ", 200, 128 * MIB - 9) + bytes(128 * MIB - 9), 1, 50, "100 times"),
        # A kilobyte of zeros and ones makes a million messages, each of which takes time.
        (struct.pack("<BQHIQQ", 5, 22, 2, 0, 5, 5), 30 * MIB // 31, 20, "100 times"),
        (struct.pack("<BQ", 200, 0), 20_000_000, 1, "too many records"),
    ],
    ids=["gigabytes", "very many messages", "empty records"],
)
def test_chunks_that_unpack_to_too_much_are_rejected(tmp_path: Path, record, count, times, says):
    import zstandard

    data = zstandard.ZstdCompressor(1).compress(record * count)
    path = with_chunks(tmp_path / "a.mcap", data, "zstd", count * len(record), times=times)
    refusal(read_recording, path, says=says)


def test_a_file_that_unpacks_to_gigabytes_is_rejected(tmp_path: Path):
    path = written(tmp_path, zeros_zstd(6 * GIB), "a.db3.zstd")
    refusal(read_recording, path, says="unpacks to more than 100 times")


def test_an_index_that_loops_or_points_outside_the_file_is_rejected(tmp_path: Path):
    """Lengths and offsets that lead back or beyond the file."""
    content = bytearray(write_mcap(tmp_path / "a.mcap", foreign_topics()).read_bytes())
    for length in (0, 2**63, 2**64 - 1):
        struct.pack_into("<Q", content, len(content) - 28, length)
        (tmp_path / "a.mcap").write_bytes(content)
        assert len(read_recording(tmp_path / "a.mcap")["pose"]) == 960


def test_an_overlong_message_of_a_topic_is_rejected(tmp_path: Path):
    topics = foreign_topics()
    msgtype, text, messages = topics["/drone/control"]
    topics["/drone/control"] = (msgtype, text, [*messages, (messages[-1][0], bytes(2 * MIB))])
    refusal(read_recording, write_mcap(tmp_path / "a.mcap", topics), says="limit of 1 MiB")


def test_a_topic_with_too_many_definitions_is_rejected(tmp_path: Path):
    msgtype, text, messages = foreign_topics()["/drone/control"]
    channels = [("/a", msgtype, f"{text}\n# {k}\n", messages[:1]) for k in range(200)]
    path = write_channels(tmp_path / "a.mcap", *channels)
    refusal(read_recording, path, says="defines a topic in too many ways")


def test_long_messages_of_other_topics_are_skipped(tmp_path: Path):
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
        ("UPDATE message_definitions SET encoded_message_definition = zeroblob(9)", "not text"),
    ],
)
def test_oversized_blobs_in_a_database_are_rejected(tmp_path: Path, statement: str, says: str):
    rosbags_folder(tmp_path / "bag")
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute(statement)
    refusal(read_recording, tmp_path / "bag" / "bag.db3", says=says)


def test_a_generated_column_of_gigabytes_is_rejected(tmp_path: Path):
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
    # Messages on other topics are not even generated.
    assert read_sqlite(path, {"/nothing"}).n_messages == 9000


def test_views_in_place_of_tables_are_rejected(tmp_path: Path):
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
    """Types that each contain the next one several times."""
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
def test_definitions_that_expand_too_far_are_rejected(tmp_path: Path, text: str):
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
def test_definitions_that_compute_values_are_rejected(text: str):
    refusal(
        lambda: definitions("a/msg/A", text, idl=True),
        says="a/msg/A (is defined|computes)|definition of a/msg/A",
        error=ValueError,
    )


def test_a_definition_may_have_comments_and_annotations():
    text = """
        @verbatim (language="comment", text="Two (2) * products << 3.")
        /* ((( */ // (((
    """
    types = definitions("a/msg/A", IDL.format(text + "const long N = -5;"), idl=True)
    assert "a/msg/A" in types
