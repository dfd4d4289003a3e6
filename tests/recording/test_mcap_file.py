import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, Recording, Stream
from airpuck.recording.bag import write_bag
from airpuck.recording.mcap_file import read_mcap
from airpuck.recording.read import read_recording

from ..apparatus.bags import START_NS, flight, foreign_topics, write_mcap
from ..apparatus.examples import examples


def is_prefix(part: Stream, whole: Stream) -> bool:
    n = len(part)
    return (
        part.columns == whole.columns
        and np.array_equal(part.received_ns, whole.received_ns[:n])
        and np.array_equal(part.stamp_ns, whole.stamp_ns[:n])
        and np.array_equal(part.values, whole.values[:n])
    )


def chunks_of(path: Path) -> list:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)


def damaged(path: Path, whole: Path, *lost) -> Recording:
    """Read a copy of a file with zeros in the middle of some chunks."""
    content = bytearray(whole.read_bytes())
    for chunk in lost:
        middle = chunk.chunk_start_offset + chunk.chunk_length // 2
        content[middle : middle + 50] = bytes(50)
    path.write_bytes(content)
    return read_recording(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of many chunks by another writer."""
    folder = tmp_path_factory.mktemp("whole")
    return write_mcap(folder / "flight.mcap", foreign_topics(), chunk_size=10_000)


@pytest.fixture(scope="module")
def complete(whole: Path) -> Recording:
    return read_recording(whole)


def test_metadata_reveals_missing_messages(tmp_path: Path):
    made = flight()
    write_bag(made, tmp_path / "bag")
    whole = read_recording(tmp_path / "bag")
    n_messages = sum(map(len, whole.streams.values()))
    file = tmp_path / "bag" / "bag_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    cut = read_recording(tmp_path / "bag")
    read = sum(map(len, cut.streams.values()))
    assert 0 < read < n_messages
    assert all(is_prefix(cut.streams[name], whole.streams[name]) for name in cut.streams)
    last = max(stream.received_ns.max() for stream in cut.streams.values())
    end = max(stream.received_ns.max() for stream in whole.streams.values())
    (warning,) = cut.warnings
    assert f"{n_messages - read} messages are missing" in warning
    match = re.search(r"the last (\d+\.\d{3}) s and", warning)
    assert match is not None
    assert float(match[1]) == pytest.approx((end - last) / 1e9, abs=1e-3)
    # And without it.
    (tmp_path / "bag" / "metadata.yaml").unlink()
    without = read_recording(tmp_path / "bag")
    assert without.streams == cut.streams
    assert "missing" not in without.warnings[0]


def test_a_damaged_chunk_loses_only_its_own_messages(tmp_path: Path, whole: Path, complete):
    lost = chunks_of(whole)[4]
    recording = damaged(tmp_path / "damaged.mcap", whole, lost)
    received = complete["pose"].received_ns
    kept = (received < lost.message_start_time) | (received > lost.message_end_time)
    assert 0 < kept.sum() < len(received)
    assert np.array_equal(recording["pose"].received_ns, received[kept])
    assert np.array_equal(recording["pose"].values, complete["pose"].values[kept])
    assert "1 damaged chunk within" in recording.warnings[0]
    assert "cut short" not in recording.warnings[0]


def test_the_warning_covers_the_first_to_the_last_damaged_chunk(tmp_path: Path, whole: Path):
    first, last = chunks_of(whole)[2:6:3]
    recording = damaged(tmp_path / "damaged.mcap", whole, first, last)
    seconds = (last.message_end_time - first.message_start_time) / 1e9
    assert f"2 damaged chunks within {seconds:.3f} s left out" in recording.warnings[0]


def test_a_wrong_checksum_is_detected(tmp_path: Path):
    from mcap.writer import CompressionType

    path = write_mcap(
        tmp_path / "a.mcap", foreign_topics(), chunk_size=10_000, compression=CompressionType.NONE
    )
    whole = read_recording(path)
    content = bytearray(path.read_bytes())
    lost = chunks_of(path)[2]
    # A flipped bit in a number: only the checksum reveals it.
    content[lost.chunk_start_offset + lost.chunk_length - 3] ^= 1
    path.write_bytes(content)
    recording = read_recording(path)
    assert recording.warnings
    assert len(recording["pose"]) + len(recording["command"]) < len(whole["pose"]) + len(
        whole["command"]
    )


def test_messages_outside_chunks_are_recovered_one_by_one(tmp_path: Path):
    path = write_mcap(tmp_path / "a.mcap", foreign_topics(), use_chunking=False)
    whole = read_recording(path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])
    recording = read_recording(path)
    assert 100 < len(recording["pose"]) < len(whole["pose"])
    assert is_prefix(recording["pose"], whole["pose"])
    assert recording.warnings


def test_late_messages_are_ordered_as_in_other_readers(tmp_path: Path, complete: Recording):
    topics = foreign_topics()
    messages = topics["/optitrack/drone/pose"][2]
    messages[10], messages[30] = messages[30], messages[10]
    path = write_mcap(tmp_path / "a.mcap", topics, in_order=False, chunk_size=10_000)
    assert read_recording(path).streams == complete.streams
    path.write_bytes(path.read_bytes()[:-20])
    recording = read_recording(path)
    assert recording.warnings
    assert recording.streams == complete.streams


def test_other_topics_are_counted_but_not_kept(whole: Path):
    rest = read_mcap(whole, {"/drone/control"})
    assert rest.damage == []
    assert rest.n_messages == 960 + 400 + 40
    assert {name: len(topic.messages) for name, (topic,) in rest.topics.items()} == {
        "/optitrack/drone/pose": 0,
        "/drone/control": 400,
        "/rosout": 0,
    }


def test_only_the_last_file_of_a_split_bag_is_truncated(tmp_path: Path):
    topics = foreign_topics()
    half = START_NS + 2 * 10**9
    for index, keep in enumerate((lambda time: time < half, lambda time: time >= half)):
        part = {
            name: (msgtype, text, [item for item in messages if keep(item[0])])
            for name, (msgtype, text, messages) in topics.items()
        }
        write_mcap(tmp_path / f"part_{index}.mcap", part, chunk_size=10_000)
    whole = read_recording(tmp_path)
    last = tmp_path / "part_1.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    recording = read_recording(tmp_path)
    assert is_prefix(recording["pose"], whole["pose"])
    assert recording["pose"].received_ns[-1] > half
    (warning,) = recording.warnings
    assert warning.startswith("part_1.mcap is damaged")


def read_damaged(content: bytes) -> Recording | None:
    """Read a damaged file; return None if it is rejected in one line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.mcap"
        path.write_bytes(content)
        try:
            return read_recording(path)
        except InputError as error:
            assert "\n" not in str(error)
            assert "damaged.mcap" in str(error)
            return None


@examples(150)
@given(data=st.data())
def test_every_complete_chunk_before_a_truncation_is_read(
    whole: Path, complete: Recording, data: st.DataObject
):
    content, chunks = whole.read_bytes(), chunks_of(whole)
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks]
    cut = data.draw(st.integers(0, len(content) - 1) | st.sampled_from(ends))
    recording = read_damaged(content[:cut])
    if cut < ends[0]:
        assert recording is None
        return
    last = max(c.message_end_time for c, end in zip(chunks, ends, strict=True) if end <= cut)
    assert recording is not None
    assert len(recording["pose"]) == (complete["pose"].received_ns <= last).sum()
    assert is_prefix(recording["pose"], complete["pose"])
    assert is_prefix(recording["command"], complete["command"])
    (warning,) = recording.warnings
    assert f"damaged.mcap is damaged: it is cut short after {cut} bytes" in warning
    match = re.search(r"read up to (\d+\.\d{3}) s .*\((\S+Z)\)", warning)
    assert match is not None
    first = min(chunk.message_start_time for chunk in chunks)
    assert float(match[1]) == pytest.approx((last - first) / 1e9, abs=6e-4)
    assert np.datetime64(match[2][:-1], "ms").astype(int) == last // 10**6
    assert "missing" not in warning


@examples(100)
@given(junk=st.binary(max_size=400))
def test_junk_after_the_magic_is_rejected(junk: bytes):
    assert read_damaged(b"\x89MCAP0\r\n" + junk) is None
