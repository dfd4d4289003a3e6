"""Messages one at a time, as they come and go on a live graph; `cdr` is for thousands at once."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.recording.cdr import Types, definitions_within, flatten
from airpuck.recording.message_types import (
    PATHS,
    columns_of,
    command_type,
    definitions,
    stamp_paths,
)
from airpuck.recording.stream import COLUMNS

_SECOND = 10**9
_FRAMES = {"command": "body", "imu": "body", "mouse": "body"}


class MessageCodec:
    """Between CDR bytes and message objects of one type, through rosbags."""

    def __init__(self, msgtype: str, types: Types | None = None) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.msgtype = msgtype
        known = definitions(msgtype) if types is None else types
        self._fields = flatten(known, msgtype)
        self._store = get_typestore(Stores.EMPTY)
        self._store.register(definitions_within(known, msgtype))
        # rosbags makes its code at the first use, which must not be in flight.
        self.decode(self.encode(self.blank()))

    def blank(self) -> Any:
        """Make a message of zeros, empty strings and empty sequences."""
        return self._blank(self.msgtype)

    def encode(self, message: Any) -> bytes:
        """Write a message."""
        return bytes(self._store.serialize_cdr(message, self.msgtype))

    def decode(self, data: bytes) -> Any:
        """Read a message."""
        try:
            return self._store.deserialize_cdr(data, self.msgtype)
        # rosbags checks little, so that a foreign message can make it fail in any way.
        except Exception as error:
            raise ValueError(f"{len(data)} bytes are no {self.msgtype}") from error

    def message(self, msgtype: str, **fields: Any) -> Any:
        """Make a message of a type within this one, for a sequence of them."""
        made = self._blank(msgtype)
        for name, value in fields.items():
            setattr(made, name, value)
        return made

    def _blank(self, msgtype: str) -> Any:
        from rosbags.interfaces import Nodetype

        values: dict[str, Any] = {}
        definition: Any = self._store.fielddefs[msgtype]
        for name, (node, description) in definition[1]:
            if node == Nodetype.NAME:
                values[name] = self._blank(description)
            elif node == Nodetype.BASE:
                values[name] = "" if description[0] == "string" else 0
            elif node == Nodetype.ARRAY:
                (_, (kind, _)), count = description
                values[name] = np.zeros(count, kind)
            else:
                values[name] = []
        return self._store.types[msgtype](**values)


class StreamCodec:
    """Between CDR bytes and the numbers of a stream."""

    def __init__(self, stream: str, motors: tuple[str, ...] = ()) -> None:
        self._stream = stream
        if stream == "command":
            self.msgtype, self.types = command_type(motors)
            paths = self.columns = motors
        else:
            self.msgtype, paths = next(iter(PATHS[stream].items()))
            self.types = definitions(self.msgtype)
            self.columns = COLUMNS[stream]
        self._codec = MessageCodec(self.msgtype, self.types)
        stamps = stamp_paths(flatten(self.types, self.msgtype))
        self._stamped = bool(stamps)
        self._read = attrgetter(*stamps, *paths)
        # One message is written over and over: what is sent has left as bytes.
        self._message = self._codec.blank()
        self._slots = [self._slot(path) for path in (*stamps, *paths)]
        if stamps:
            self._message.header.frame_id = _FRAMES.get(stream, "world")

    def encode(self, stamp_ns: int, values: Sequence[float] | Float[np.ndarray, " k"]) -> bytes:
        """Write a message."""
        numbers: list[Any] = [float(value) for value in values]
        if self._stream == "pose":
            x, y, yaw = numbers
            numbers = [x, y, 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))]
        if self._stamped:
            numbers = [*divmod(stamp_ns, _SECOND), *numbers]
        for (owner, name), number in zip(self._slots, numbers, strict=True):
            setattr(owner, name, number)
        return self._codec.encode(self._message)

    def decode(self, data: bytes) -> tuple[int | None, Float[np.ndarray, " k"]]:
        """Read a message."""
        numbers = self._read(self._codec.decode(data))
        stamp = None
        if self._stamped:
            stamp = numbers[0] * _SECOND + numbers[1]
            numbers = numbers[2:]
        values = np.array(numbers, dtype=float)
        return stamp, columns_of(self._stream, list(values[:, None]))[0]

    def _slot(self, path: str) -> tuple[Any, str]:
        """Return the part of the message that a path ends in, and the name there."""
        *within, name = path.split(".")
        owner = self._message
        for part in within:
            owner = getattr(owner, part)
        return owner, name
