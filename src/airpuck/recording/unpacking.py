"""The undecoded contents of a bag's files, unpacked within limits.

What Zstandard, LZ4 and bzip2 unpack is counted, whatever a header says.
"""

from __future__ import annotations

import bz2
import contextlib
import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from airpuck.boundary.errors import explained
from airpuck.boundary.limits import (
    CHUNK_BYTES,
    DEFINITIONS,
    MESSAGE_BYTES,
    MIB,
    TOPICS,
    Unpacking,
    refused,
)


@dataclass
class TopicLog:
    """The messages of one topic in one definition, before they are decoded."""

    msgtype: str
    #: The definition embedded in the bag; empty if there is none.
    definition: str = ""
    #: Whether the definition is IDL instead of the ``.msg`` format.
    idl: bool = False
    #: Encoding of the messages: ``cdr``, ``ros1``, or another, which is not read.
    encoding: str = "cdr"
    #: The recorder's times [ns since the epoch].
    received_ns: list[int] = field(default_factory=list)
    #: Messages; CDR with encapsulation.
    messages: list[bytes] = field(default_factory=list)
    #: The topic; set by its log.
    name: str = ""

    def add(self, time_ns: int, message: bytes, path: Path) -> None:
        """Add a message; raise InputError if it is too long."""
        if len(message) > MESSAGE_BYTES:
            what, remedy = "contains too long a message", "choose another topic"
            raise refused(what, MESSAGE_BYTES, remedy, file=path, field=self.name)
        self.received_ns.append(time_ns)
        self.messages.append(message)

    @property
    def foreign(self) -> bool:
        """Whether messages have an encoding that is not read."""
        return self.encoding not in ("cdr", "ros1")


@dataclass
class Log:
    """Contents of a bag's files."""

    path: Path
    #: Definitions of each topic, since publishers may disagree; messages of wanted topics only.
    topics: dict[str, list[TopicLog]] = field(default_factory=dict)
    #: Messages on all topics.
    n_messages: int = 0
    #: Earliest and latest recorder time of all messages [ns since the epoch].
    first_ns: int | None = None
    last_ns: int | None = None
    #: Descriptions of the damage, in a few words each.
    damage: list[str] = field(default_factory=list)

    @property
    def entries(self) -> Iterator[TopicLog]:
        """All definitions of all topics."""
        return itertools.chain.from_iterable(self.topics.values())

    def count(self, n_messages: int, first_ns: int, last_ns: int) -> None:
        """Add messages to the count and the time span."""
        self.n_messages += n_messages
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def topic(self, name: str, like: TopicLog) -> TopicLog:
        """Return the entry of a topic with this type, encoding and definition; add it if new.

        Raise InputError if there are too many topics, or definitions of one.
        """
        entries = self.topics.setdefault(name, [])
        for entry in entries:
            same = (entry.msgtype, entry.encoding) == (like.msgtype, like.encoding)
            texts = {(e.definition, e.idl) for e in (entry, like) if e.definition}
            if same and len(texts) < 2:
                ((entry.definition, entry.idl),) = texts or {("", False)}
                return entry
        entries.append(replace(like, received_ns=[], messages=[], name=name))
        if len(self.topics) > TOPICS:
            raise refused("contains too many topics", TOPICS, "split it", file=self.path)
        if len(entries) > DEFINITIONS:
            what = "defines a topic in too many ways"
            raise refused(what, DEFINITIONS, "split it", file=self.path)
        return entries[-1]

    def sort(self) -> None:
        """Sort messages by the recorder's clock, as readers of bags do."""
        for topic in self.entries:
            times = topic.received_ns
            order = sorted(range(len(times)), key=times.__getitem__)
            topic.received_ns = [times[index] for index in order]
            topic.messages = [topic.messages[index] for index in order]

    def extend(self, later: Log) -> None:
        """Append a later file of the same recording."""
        for name, entries in later.topics.items():
            for entry in entries:
                mine = self.topic(name, entry)
                mine.received_ns += entry.received_ns
                mine.messages += entry.messages
        if later.first_ns is not None and later.last_ns is not None:
            self.count(later.n_messages, later.first_ns, later.last_ns)
        self.damage += later.damage


class Malformed(ValueError):
    """A record of a bag is malformed."""


def unpacked(data: bytes, compression: str, size: int, path: Path) -> bytes:
    """Unpack a chunk to its size; ValueError if the size differs or the chunk is damaged.

    Raise InputError if the chunk claims to unpack to too much.
    """
    import lz4.frame
    import zstandard

    if size > CHUNK_BYTES:
        what, remedy = "contains a chunk that unpacks to too much", "record smaller chunks"
        raise refused(what, CHUNK_BYTES, remedy, file=path)
    try:
        if compression == "zstd":
            # A decompressor takes as much memory as its window, up to the size of its output.
            decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES)
            content = decompressor.stream_reader(data).read(size + 1)
        elif compression == "lz4":
            content = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        elif compression == "bz2":
            content = bz2.BZ2Decompressor().decompress(data, size + 1)
        elif not compression:
            content = data
        else:
            raise ValueError("it is packed by an unknown method")
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError) as error:
        raise ValueError("it is damaged") from error
    if len(content) != size:
        raise ValueError("its size differs from the stated one")
    return content


def unpacked_message(data: bytes) -> bytes:
    """Unpack a message that rosbag2 compressed individually."""
    import zstandard

    try:
        content = zstandard.ZstdDecompressor().stream_reader(data).read(MESSAGE_BYTES + 1)
    except zstandard.ZstdError as error:
        raise ValueError("it contains a message that cannot be unpacked") from error
    if len(content) > MESSAGE_BYTES:
        raise ValueError(f"it contains a message that unpacks to more than {MESSAGE_BYTES:,} bytes")
    return content


@contextlib.contextmanager
def unpacked_file(path: Path) -> Iterator[Path]:
    """Unpack a fully compressed storage file, for the duration of the block."""
    import zstandard

    budget = Unpacking(path, path.stat().st_size)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, path.stem)
        damaged = explained(zstandard.ZstdError, "is not a readable recording ({error})", file=path)
        with damaged, path.open("rb") as source, plain.open("wb") as target:
            stream = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
            while block := stream.read(MIB):
                budget.spend(len(block))
                target.write(block)
        yield plain
