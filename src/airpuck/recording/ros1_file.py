"""Reading a ROS 1 bag (format 2.0) from front to back; of a damaged one, the intact part.

A killed recorder never wrote the index at the end, so none is used. rosbags turns messages into
CDR, so everything after this file is the same for ROS 1 and ROS 2.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO

from airpuck.boundary.errors import InputError, explained
from airpuck.boundary.limits import CHUNK_BYTES, Unpacking, refused
from airpuck.recording.cdr import typestore
from airpuck.recording.message import definitions
from airpuck.recording.unpacking import Log, Malformed, TopicLog, unpacked

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_LENGTH = struct.Struct("<I")
#: Seconds and nanoseconds.
_TIME = struct.Struct("<II")
#: Maximum length of a record's header [bytes]; a message's header has 40.
_HEADER_BYTES = 4096
#: ROS 2's names of the compression methods.
_COMPRESSIONS = {"none": "", "bz2": "bz2", "lz4": "lz4"}
#: Counter in the headers of ROS 1, absent in ROS 2; rosbags drops it.
_COUNTER = re.compile(r"^uint32 seq\b.*\n", re.MULTILINE)
#: ROS 1 has time and duration as numbers, ROS 2 as messages.
_TIMES = "".join(
    f"\n{'=' * 80}\nMSG: builtin_interfaces/{name}\nint32 sec\nuint32 nanosec\n"
    for name in ("Time", "Duration")
)


#: Encoding of the messages, as MCAP files name it.
ROS1 = "ros1"


class _BagRecords:
    """Processes records in the order of the file."""

    def __init__(self, path: Path, wanted: Collection[str]) -> None:
        self.log, self.path, self._wanted = Log(path), path, wanted
        self._budget = Unpacking(path, path.stat().st_size)
        self._topics: dict[int, TopicLog] = {}

    def connection(self, header: dict[str, bytes], content: bytes) -> None:
        """Process the description of a topic by one of its publishers."""
        described = _fields(content)
        (number,) = _LENGTH.unpack(_field(header, "conn", 4))
        topic = ros1_topic(_text(described, "type"), _text(described, "message_definition"))
        self._topics[number] = self.log.topic(_text(header, "topic"), topic)

    def message(self, header: dict[str, bytes], content: bytes) -> None:
        """Process a message; one without a connection belongs to a lost chunk."""
        (number,) = _LENGTH.unpack(_field(header, "conn", 4))
        seconds, nanoseconds = _TIME.unpack(_field(header, "time", 8))
        if number not in self._topics:
            return
        topic, time = self._topics[number], seconds * 10**9 + nanoseconds
        self.log.count(1, time, time)
        if topic.name in self._wanted:
            topic.add(time, content, self.path)

    def chunk(self, header: dict[str, bytes], content: bytes) -> None:
        """Process the records of a chunk."""
        (size,) = _LENGTH.unpack(_field(header, "size", 4))
        compression = _COMPRESSIONS.get(_text(header, "compression"), "unknown")
        plain = unpacked(content, compression, size, self.path)
        records = list(_records(plain, self._budget.records_left))
        self._budget.spend(size, len(records))
        for head, inner in records:
            self.take(head, inner, inside=True)

    def take(self, header: dict[str, bytes], content: bytes, *, inside: bool = False) -> None:
        """Process any record; the index is not needed."""
        code = _field(header, "op", 1)[0]
        if code == _CONNECTION:
            self.connection(header, content)
        elif code == _MESSAGE:
            self.message(header, content)
        elif code == _CHUNK and not inside:
            self.chunk(header, content)


def _field(fields: dict[str, bytes], name: str, size: int | None = None) -> bytes:
    value = fields.get(name)
    if value is None or size not in (None, len(value)):
        raise Malformed(f"a record has no {name}")
    return value


def _text(fields: dict[str, bytes], name: str) -> str:
    return _field(fields, name).decode(errors="replace")


def _fields(data: bytes) -> dict[str, bytes]:
    """Parse the fields of a header: each its length, its name, an equals sign and its value."""
    found, start = dict[str, bytes](), 0
    while start < len(data):
        text, start = _counted(data, start)
        name, equals, value = text.partition(b"=")
        if not equals:
            raise Malformed("a record has a field without a value")
        found[name.decode(errors="replace")] = value
    return found


def _counted(data: bytes, start: int) -> tuple[bytes, int]:
    """Read a length at `start` and as many bytes; return them and their end."""
    begin = start + _LENGTH.size
    end = begin + (_LENGTH.unpack_from(data, start)[0] if begin <= len(data) else 0)
    if max(begin, end) > len(data):
        raise Malformed("the length of a record is impossible")
    return data[begin:end], end


def _records(data: bytes, most: int) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield header and content of the records in a chunk, at most one more than `most`."""
    start = 0
    while start < len(data) and most >= 0:
        header, start = _counted(data, start)
        content, start = _counted(data, start)
        yield _fields(header), content
        most -= 1


def _headed(file: BinaryIO, size: int, path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Yield header and content of the records of a file."""
    position = len(_MAGIC)
    if file.read(position) != _MAGIC:
        raise InputError("is not a ROS 1 bag of format 2.0", file=path)
    while position < size:
        parts = []
        for most in (_HEADER_BYTES, CHUNK_BYTES):
            start = file.read(_LENGTH.size)
            position += _LENGTH.size
            length = _LENGTH.unpack(start)[0] if len(start) == _LENGTH.size else size
            if length > size - position:
                raise Malformed(f"it is cut short after {size} bytes")
            if length > most:
                remedy = "record smaller chunks"
                raise refused("contains too large a record", most, remedy, file=path)
            parts.append(file.read(length))
            position += length
        yield parts[0], parts[1]


def read_ros1(path: Path, wanted: Collection[str]) -> Log:
    """Read the wanted messages up to the damage, if any."""
    sink, lost = _BagRecords(path, wanted), 0
    try:
        with path.open("rb") as file:
            for header, content in _headed(file, path.stat().st_size, path):
                try:
                    sink.take(_fields(header), content)
                except InputError:
                    raise
                except ValueError:
                    lost += 1
    except Malformed as error:
        sink.log.damage.append(str(error))
    if lost:
        number = f"{lost} damaged record{'s' if lost > 1 else ''}"
        sink.log.damage.append(f"{number} left out")
    sink.log.sort()
    return sink.log


def ros1_topic(kind: str, definition: str) -> TopicLog:
    """Describe a topic by ROS 1's name and definition of its type, in the notation of ROS 2."""
    package, _, name = kind.partition("/")
    return TopicLog(f"{package}/msg/{name}", _COUNTER.sub("", definition) + _TIMES, encoding=ROS1)


def convert_ros1(log: Log, path: Path) -> None:
    """Turn messages of ROS 1 into CDR."""
    for topic in log.entries:
        if topic.encoding != ROS1:
            continue
        topic.encoding = "cdr"
        if not topic.messages:
            continue
        problem = f"contains a {topic.msgtype} that cannot be decoded"
        # rosbags compiles definitions to code and checks no message: both can fail in any way.
        with explained(Exception, problem, file=path, field=topic.name):
            types = definitions(topic.msgtype, topic.definition)
            store = typestore(types, topic.msgtype)
            topic.messages = [bytes(store.ros1_to_cdr(m, topic.msgtype)) for m in topic.messages]
