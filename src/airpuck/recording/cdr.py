"""Thousands of ROS messages as one array: CDR messages of constant layout, in bulk.

The wire format is the OMG's Common Data Representation, version 1: four bytes of encapsulation,
then the fields in order, each aligned to its own size counted from the end of the encapsulation. A
string is its length with the closing zero (uint32), then its bytes. Messages of one topic have
nearly always the same size, so that a whole topic is one structured NumPy array; where they do not,
rosbags deserialises them one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

#: Message definitions as rosbags keeps them: type name -> (constants, fields).
Types = Mapping[str, Any]

_PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_ENCAPSULATION = 4
_LITTLE_ENDIAN = b"\x00\x01"
_DEEPEST = 16


@dataclass(frozen=True)
class Field:
    """One leaf of a message."""

    #: Names from the message down, joined by dots: ``pose.position.x``.
    path: str
    #: ROS name of a primitive type, ``string``, or ``sequence`` for all that has no fixed size.
    kind: str
    #: Number of elements of a fixed array; 1 for a plain field.
    count: int = 1


def flatten(types: Types, msgtype: str) -> tuple[Field, ...]:
    """List the leaves of a message type in the order of the wire."""
    return tuple(_leaves(types, msgtype, "", 0))


def _leaves(types: Types, msgtype: str, prefix: str, depth: int) -> list[Field]:
    from rosbags.interfaces import Nodetype

    if msgtype not in types:
        raise ValueError(f"the definition of {msgtype} is missing")
    if depth > _DEEPEST:
        raise ValueError(f"the definition of {msgtype} is nested too deeply")
    leaves = []
    for name, (node, description) in types[msgtype][1]:
        count = 1
        if node == Nodetype.ARRAY:
            (node, description), count = description
        path = prefix + name
        if node == Nodetype.NAME and count == 1:
            leaves += _leaves(types, description, f"{path}.", depth + 1)
        elif node == Nodetype.BASE and description[0] in _PRIMITIVES:
            leaves.append(Field(path, description[0], count))
        elif node == Nodetype.BASE and description[0] == "string" and count == 1:
            leaves.append(Field(path, "string"))
        else:
            leaves.append(Field(path, "sequence"))
    return leaves


def definitions_within(types: Types, msgtype: str) -> dict[str, Any]:
    """Pick the definitions that a message type needs."""
    from rosbags.interfaces import Nodetype

    needed = {msgtype: types[msgtype]}
    for _, (node, description) in types[msgtype][1]:
        while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, description = description[0]
        if node == Nodetype.NAME:
            needed.update(definitions_within(types, description))
    return needed


def decode(
    messages: Sequence[bytes], types: Types, msgtype: str, paths: Sequence[str]
) -> dict[str, np.ndarray]:
    """Read some number fields of many messages of one type."""
    fields = flatten(types, msgtype)
    table = _as_table(messages, fields)
    if table is not None:
        return {path: table[path] for path in paths}
    return _decode_singly(messages, types, msgtype, fields, paths)


def _as_table(messages: Sequence[bytes], fields: Sequence[Field]) -> np.ndarray | None:
    """Return the messages as one structured array, or None if they have no common layout."""
    if not messages:
        return np.zeros(0, _layout(fields, {}))
    size = len(messages[0])
    lengths = _string_lengths(messages[0], fields)
    if lengths is None or any(len(message) != size for message in messages):
        return None
    layout = _layout(fields, lengths)
    if not layout.itemsize <= size < layout.itemsize + 4:
        return None
    padded = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, size)
    table = np.ascontiguousarray(padded[:, : layout.itemsize]).view(layout)[:, 0]
    same = (table["encapsulation"] == table["encapsulation"][0]).all() and all(
        (table[f"{path} length"] == length).all() for path, length in lengths.items()
    )
    return table if same else None


def _string_lengths(message: bytes, fields: Sequence[Field]) -> dict[str, int] | None:
    """Read the lengths of the strings in a message; None where it has no constant layout."""
    if message[:2] != _LITTLE_ENDIAN or any(field.kind == "sequence" for field in fields):
        return None
    lengths: dict[str, int] = {}
    for index, field in enumerate(fields):
        if field.kind == "string":
            start = _layout((*fields[:index], Field(field.path, "uint32")), lengths).itemsize
            length = int.from_bytes(message[start - 4 : start], "little")
            if start + length > len(message):
                return None
            lengths[field.path] = length
    return lengths


def _layout(fields: Sequence[Field], lengths: Mapping[str, int]) -> np.dtype:
    """Return the structured type of messages whose strings have the given lengths."""
    names, formats, offsets = ["encapsulation"], ["<u4"], [0]
    position = _ENCAPSULATION

    def place(name: str, code: str, alignment: int, size: int) -> None:
        nonlocal position
        position += -(position - _ENCAPSULATION) % alignment
        names.append(name)
        formats.append(code)
        offsets.append(position)
        position += size

    for field in fields:
        if field.kind == "string":
            length = lengths.get(field.path, 0)
            place(f"{field.path} length", "<u4", 4, 4)
            place(field.path, f"V{length}", 1, length)
        elif field.kind != "sequence":
            code = _PRIMITIVES[field.kind]
            width = int(code[1])
            shape = "" if field.count == 1 else str(field.count)
            place(field.path, f"{shape}<{code}", width, width * field.count)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": position})


def _decode_singly(
    messages: Sequence[bytes],
    types: Types,
    msgtype: str,
    fields: Sequence[Field],
    paths: Sequence[str],
) -> dict[str, np.ndarray]:
    """Let rosbags deserialise message by message."""
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, TypesysError, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(definitions_within(types, msgtype))
    # rosbags makes code of definitions, and those of a damaged file can make it fail in any way.
    except Exception as error:
        raise ValueError(f"the definition of {msgtype} cannot be used") from error
    rows = []
    for index, message in enumerate(messages):
        try:
            row = store.deserialize_cdr(message, msgtype)
        except (SerdeError, TypesysError, IndexError, MemoryError, OverflowError) as error:
            raise ValueError(f"message {index + 1} cannot be decoded: {error}") from error
        rows.append([_leaf(row, path) for path in paths])
    kinds = {field.path: _PRIMITIVES.get(field.kind) for field in fields}
    return {
        path: np.array([row[index] for row in rows], dtype=kinds[path])
        for index, path in enumerate(paths)
    }


def _leaf(message: Any, path: str) -> Any:
    for name in path.split("."):
        message = getattr(message, name)
    return message


def encode(
    types: Types, msgtype: str, values: Mapping[str, np.ndarray], strings: Mapping[str, str]
) -> list[bytes]:
    """Write many messages of one type."""
    fields = flatten(types, msgtype)
    texts = {
        field.path: strings.get(field.path, "").encode() + b"\0"
        for field in fields
        if field.kind == "string"
    }
    layout = _layout(fields, {path: len(text) for path, text in texts.items()})
    n = len(next(iter(values.values())))
    table = np.zeros(n, layout)
    table["encapsulation"] = int.from_bytes(_LITTLE_ENDIAN + b"\0\0", "little")
    for path, text in texts.items():
        table[f"{path} length"] = len(text)
        table[path] = np.void(text)
    for path, column in values.items():
        table[path] = column
    raw = table.tobytes()
    return [raw[start : start + layout.itemsize] for start in range(0, len(raw), layout.itemsize)]
