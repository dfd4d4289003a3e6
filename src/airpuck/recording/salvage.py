"""Reading the intact part of a damaged MCAP file.

rosbags needs the index at the end of the file, which a recorder that was killed never wrote. The
records before the damage are as good as ever; they are read from the front.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Schema


@dataclass
class TopicLog:
    """The messages of one topic before they are decoded."""

    msgtype: str
    #: The definition that the bag embeds; empty for none.
    definition: str = ""
    #: Whether the definition is IDL rather than the ``.msg`` format.
    idl: bool = False
    #: The recorder's times [ns since the epoch].
    received_ns: list[int] = field(default_factory=list)
    #: In CDR, with encapsulation.
    messages: list[bytes] = field(default_factory=list)


@dataclass
class Log:
    """What the files of a bag hold."""

    #: Messages of the wanted topics only.
    topics: dict[str, TopicLog] = field(default_factory=dict)
    #: Messages on all topics.
    n_messages: int = 0
    #: Earliest and latest recorder time of them [ns since the epoch].
    first_ns: int | None = None
    last_ns: int | None = None
    #: What was wrong, in a few words each.
    damage: list[str] = field(default_factory=list)

    def count(self, n_messages: int, first_ns: int, last_ns: int) -> None:
        """Add messages to the number and the span of time."""
        self.n_messages += n_messages
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def extend(self, later: Log) -> None:
        """Append a later file of the same recording."""
        for name, topic in later.topics.items():
            mine = self.topics.setdefault(name, TopicLog(topic.msgtype))
            if not mine.definition:
                mine.definition, mine.idl = topic.definition, topic.idl
            mine.received_ns += topic.received_ns
            mine.messages += topic.messages
        if later.first_ns is not None and later.last_ns is not None:
            self.count(later.n_messages, later.first_ns, later.last_ns)
        self.damage += later.damage


def salvage_mcap(path: Path, wanted: Collection[str]) -> Log:
    """Read every whole chunk of an MCAP file."""
    from mcap.records import Channel, Message, Schema

    log = Log()
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for record in _records(path, log.damage):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel, time = channels.get(record.channel_id), record.log_time
            # A message without a channel belongs to a lost chunk.
            if channel is None or channel.message_encoding != "cdr" or time >= 2**63:
                continue
            if channel.topic not in log.topics:
                log.topics[channel.topic] = _topic_log(schemas.get(channel.schema_id))
            if channel.topic in wanted:
                log.topics[channel.topic].received_ns.append(time)
                log.topics[channel.topic].messages.append(record.data)
            log.count(1, time, time)
    for topic in log.topics.values():
        # Into the order of the recorder's clock, as MCAP readers do.
        order = sorted(range(len(topic.messages)), key=topic.received_ns.__getitem__)
        topic.received_ns = [topic.received_ns[index] for index in order]
        topic.messages = [topic.messages[index] for index in order]
    return log


def _topic_log(schema: Schema | None) -> TopicLog:
    if schema is None:
        return TopicLog("")
    idl = schema.encoding in ("ros2idl", "omgidl")
    return TopicLog(schema.name, schema.data.decode(errors="replace"), idl)


def _records(path: Path, damage: list[str]) -> Iterator[McapRecord]:
    """Yield schemas, channels and messages, noting damage instead of raising."""
    from mcap.records import Chunk
    from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

    size = path.stat().st_size
    lost: list[Chunk] = []
    with path.open("rb") as file:
        # No record is longer than the file: a damaged length must not ask for memory.
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size)
        records = iter(reader.records)
        while True:
            try:
                record = next(records)
            except StopIteration:
                break
            except CRCValidationError:
                if not lost:
                    damage.append("its checksum does not match its content")
                break
            # A damaged file can make the parser fail in any way, and every one means the same.
            except Exception:
                position = file.tell()
                damage.append(
                    f"it is cut short after {size} bytes"
                    if position >= size
                    else f"it cannot be read beyond byte {position} of {size}"
                )
                break
            if not isinstance(record, Chunk):
                yield record
                continue
            try:
                inner = breakup_chunk(record, validate_crc=True)
            except Exception:
                lost.append(record)
                continue
            yield from inner
    if lost:
        # What a lost chunk says about its own times may be damaged too, but is all there is.
        start = min(chunk.message_start_time for chunk in lost)
        stop = max(chunk.message_end_time for chunk in lost)
        chunks = f"{len(lost)} damaged chunk{'s' if len(lost) > 1 else ''}"
        damage.append(f"{chunks} within {(stop - start) / 1e9:.3f} s left out")
