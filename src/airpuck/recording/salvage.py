"""Reading what is whole of a damaged MCAP file.

rosbags needs the index at the end of the file, which a recorder that was killed never wrote. The
records before the damage are as good as ever; they are read from the front.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from airpuck.recording.topic_log import TopicLog

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Message, Schema


@dataclass
class Salvage:
    """What could be read."""

    #: By topic, in the order of the recorder's clock; messages of the wanted ones only.
    topics: dict[str, TopicLog] = field(default_factory=dict)
    #: What was wrong, in a few words each; empty for a whole file.
    damage: list[str] = field(default_factory=list)
    #: Messages read, on all topics.
    n_messages: int = 0
    #: Earliest and latest recorder time of them [ns since the epoch].
    first_ns: int | None = None
    last_ns: int | None = None


def salvage_mcap(path: Path, wanted: Collection[str]) -> Salvage:
    """Read every whole chunk of an MCAP file."""
    from mcap.records import Channel, Message, Schema

    result = Salvage()
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for record in _records(path, result):
        if isinstance(record, Message):
            _keep(record, channels, schemas, wanted, result)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
    for topic in result.topics.values():
        topic.sort()
    return result


def _keep(
    message: Message,
    channels: dict[int, Channel],
    schemas: dict[int, Schema],
    wanted: Collection[str],
    result: Salvage,
) -> None:
    """Add a message to its topic; one without a channel belongs to a lost chunk."""
    channel = channels.get(message.channel_id)
    if channel is None or channel.message_encoding != "cdr" or message.log_time >= 2**63:
        return
    topic = result.topics.get(channel.topic)
    if topic is None:
        schema = schemas.get(channel.schema_id)
        topic = TopicLog(
            msgtype=schema.name if schema else "",
            definition=schema.data.decode(errors="replace") if schema else "",
            idl=schema is not None and schema.encoding in ("ros2idl", "omgidl"),
        )
        result.topics[channel.topic] = topic
    time = message.log_time
    if channel.topic in wanted:
        topic.received_ns.append(time)
        topic.messages.append(message.data)
    result.n_messages += 1
    result.first_ns = time if result.first_ns is None else min(result.first_ns, time)
    result.last_ns = time if result.last_ns is None else max(result.last_ns, time)


def _records(path: Path, result: Salvage) -> Iterator[McapRecord]:
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
                    result.damage.append("its checksum does not match its content")
                break
            # A damaged file can make the parser fail in any way, and every one means the same.
            except Exception:
                position = file.tell()
                result.damage.append(
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
        result.damage.append(f"{chunks} within {(stop - start) / 1e9:.3f} s left out")
