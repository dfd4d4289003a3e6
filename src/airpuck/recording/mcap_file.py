"""Reading an MCAP file from front to back; of a damaged one, the intact part.

A killed recorder never wrote the index at the end, but the records before the damage are intact. So
the index serves only to skip chunks without wanted messages. The lengths that records claim, and
the unpacked sizes that chunks claim, are not trusted.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import CHUNK_BYTES, INDEX_BYTES, Unpacking, refused
from airpuck.recording.ros1_file import ROS1, ros1_topic
from airpuck.recording.unpacking import Log, Malformed, TopicLog, unpacked

if TYPE_CHECKING:
    from mcap.records import ChunkIndex, Schema

_MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length before each record.
_HEAD = struct.Struct("<BQ")
#: Channel, sequence number, recorder's and sender's time at the start of a message.
_MESSAGE = struct.Struct("<HIQQ")
#: Header of a chunk: first and last time, unpacked size and checksum, length of the compression's
#: name.
_CHUNK = struct.Struct("<QQQII")
#: The last record, which locates the summary, and the magic bytes after it.
_FOOTER_BYTES = _HEAD.size + 20 + len(_MAGIC)

_FOOTER_CODE, _SCHEMA_CODE, _CHANNEL_CODE, _MESSAGE_CODE, _CHUNK_CODE = 2, 3, 4, 5, 6
_CHUNK_INDEX_CODE = 8
#: Size of the groups in which messages outside chunks are processed [bytes].
_TOGETHER_BYTES = 2**18


class _Sink:
    """Processes records in the order of the file."""

    def __init__(self, path: Path, wanted: Collection[str]) -> None:
        self.log = Log(path)
        self.path, self._wanted = path, wanted
        self._budget = Unpacking(path, path.stat().st_size)
        self._schemas: dict[int, Schema] = {}
        #: Topic of each channel; None if the channel is skipped.
        self._channels: dict[int, TopicLog | None] = {}
        #: Stated times of damaged chunks [ns]; they may be wrong, but there is no other source.
        self.lost: list[tuple[int, int]] = []

    def wants(self, channels: Collection[int]) -> bool:
        """Return whether one of the channels is read, or still unknown."""
        return any(self._channels.get(channel, True) is not None for channel in channels)

    def describe(self, code: int, content: bytes) -> None:
        """Process a schema or a channel."""
        from mcap.records import Channel, Schema

        if code == _SCHEMA_CODE:
            schema = _parsed(Schema, content)
            self._schemas[schema.id] = schema
            return
        channel = _parsed(Channel, content)
        if channel.id in self._channels:
            return
        described = _topic_log(self._schemas.get(channel.schema_id), channel.message_encoding)
        topic = self.log.topic(channel.topic, described)
        self._channels[channel.id] = topic if channel.topic in self._wanted else None

    def chunk(self, content: bytes) -> None:
        """Process all records of a chunk, or none if one is damaged."""
        found: list[tuple[TopicLog, int, bytes]] = []
        times: list[int] = []
        records = _framed(content)
        for code, start, end in islice(records, self._budget.records_left):
            if code == _MESSAGE_CODE:
                if end - start < _MESSAGE.size:
                    raise Malformed("a message is cut short")
                channel, _, time, _ = _MESSAGE.unpack_from(content, start)
                # A message without a channel belongs to a lost chunk.
                if channel not in self._channels or time >= 2**63:
                    continue
                times.append(time)
                topic = self._channels[channel]
                if topic is not None:
                    found.append((topic, time, content[start + _MESSAGE.size : end]))
            elif code in (_SCHEMA_CODE, _CHANNEL_CODE):
                self.describe(code, content[start:end])
        # A leftover record exceeds the limit.
        self._budget.spend(len(content), len(content) if any(records) else len(times))
        for topic, time, message in found:
            topic.add(time, message, self.path)
        if times:
            self.log.count(len(times), min(times), max(times))


def _framed(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield each record's opcode, and where its content begins and ends."""
    start, size = _HEAD.size, len(content)
    while start <= size:
        code, length = _HEAD.unpack_from(content, start - _HEAD.size)
        end = start + length
        if end > size or not code:
            raise Malformed("the length of a record is impossible")
        yield code, start, end
        start = end + _HEAD.size


def _parsed(record: Any, content: bytes) -> Any:
    """Let mcap parse a record, which may be damaged in any way."""
    from mcap.data_stream import ReadDataStream

    try:
        return record.read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise Malformed("a record cannot be read") from error


def _topic_log(schema: Schema | None, encoding: str) -> TopicLog:
    if schema is None:
        return TopicLog("", encoding=encoding)
    text = schema.data.decode(errors="replace")
    if encoding == ROS1:
        return ros1_topic(schema.name, text)
    return TopicLog(schema.name, text, schema.encoding in ("ros2idl", "omgidl"), encoding)


def read_mcap(path: Path, wanted: Collection[str]) -> Log:
    """Read every intact chunk of an MCAP file, and record the damage."""
    size = path.stat().st_size
    sink = _Sink(path, wanted)
    with path.open("rb") as file:
        # Messages outside chunks.
        single = bytearray()
        try:
            chunks = _chunk_indices(file, size)
            file.seek(0)
            for position, code, length in _headed(file, size):
                if code == _MESSAGE_CODE and length >= _MESSAGE.size:
                    single += _HEAD.pack(code, length) + _take(file, length, path)
                    if len(single) < _TOGETHER_BYTES:
                        continue
                sink.chunk(bytes(single))
                single.clear()
                index = chunks.get(position)
                if code == _CHUNK_CODE and index and not sink.wants(index.message_index_offsets):
                    _pass_over(index, sink.log)
                elif code == _CHUNK_CODE:
                    _read_chunk(_take(file, length, path), sink)
                elif code in (_SCHEMA_CODE, _CHANNEL_CODE):
                    sink.describe(code, _take(file, length, path))
        except Malformed as error:
            sink.log.damage.append(str(error))
        sink.chunk(bytes(single))
    if sink.lost:
        starts, stops = zip(*sink.lost, strict=True)
        number = f"{len(starts)} damaged chunk{'s' if len(starts) > 1 else ''}"
        sink.log.damage.append(f"{number} within {(max(stops) - min(starts)) / 1e9:.3f} s left out")
    sink.log.sort()
    return sink.log


def _headed(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield position, opcode and length of each record up to the end of the file.

    The file is positioned after the record's header; content that the caller does not read is
    skipped.
    """
    position = len(_MAGIC)
    checked = file.read(position) == _MAGIC
    while checked:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Malformed(f"it is cut short after {size} bytes")
        code, length = _HEAD.unpack(head)
        if not code or length > size:
            break
        if length > size - position - _HEAD.size:
            raise Malformed(f"it is cut short after {size} bytes")
        yield position, code, length
        position += _HEAD.size + length
        file.seek(position)
        if code == _FOOTER_CODE:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise Malformed(f"it is cut short after {size} bytes")
            return
    raise Malformed(f"it cannot be read beyond byte {position} of {size}")


def _take(file: BinaryIO, length: int, path: Path) -> bytes:
    """Read the content of a record that is not too long."""
    if length > CHUNK_BYTES:
        raise refused("contains too large a chunk", CHUNK_BYTES, "record smaller chunks", file=path)
    return file.read(length)


def _read_chunk(content: bytes, sink: _Sink) -> None:
    """Unpack a chunk and process its records; note the chunk if it is damaged."""
    if len(content) < _CHUNK.size + 8:
        raise Malformed("a chunk is cut short")
    start_ns, stop_ns, size, checksum, name = _CHUNK.unpack_from(content)
    data = _CHUNK.size + name + 8
    try:
        compression = content[_CHUNK.size : data - 8].decode()
        records = unpacked(content[data:], compression, size, sink.path)
        if checksum and zlib.crc32(records) != checksum:
            raise Malformed("its checksum does not match its content")
        sink.chunk(records)
    except InputError:
        raise
    except ValueError:
        sink.lost.append((start_ns, stop_ns))


def _chunk_indices(file: BinaryIO, size: int) -> dict[int, ChunkIndex]:
    """Return the index entry of each chunk, by position; empty if the index is damaged."""
    from mcap.records import ChunkIndex

    file.seek(max(0, size - _FOOTER_BYTES))
    footer = file.read()
    if not footer.endswith(_MAGIC) or footer[0] != _FOOTER_CODE:
        return {}
    (start,) = struct.unpack_from("<Q", footer, _HEAD.size)
    if not 0 < size - _FOOTER_BYTES - start <= INDEX_BYTES or not start:
        return {}
    file.seek(start)
    content = file.read(size - _FOOTER_BYTES - start)
    try:
        found = [record for record in _framed(content) if record[0] == _CHUNK_INDEX_CODE]
        indices = [_parsed(ChunkIndex, content[start:end]) for _, start, end in found]
    except Malformed:
        return {}
    return {index.chunk_start_offset: index for index in indices}


def _pass_over(index: ChunkIndex, log: Log) -> None:
    """Count the messages of a chunk: each has 16 bytes in an index of its channel."""
    heads = (_HEAD.size + 6) * len(index.message_index_offsets)
    n_messages = max(0, index.message_index_length - heads) // 16
    if n_messages and index.message_start_time <= index.message_end_time < 2**63:
        log.count(n_messages, index.message_start_time, index.message_end_time)
