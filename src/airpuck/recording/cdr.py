"""Bulk decoding of ROS messages: CDR messages of constant layout as one array.

The wire format is the OMG's Common Data Representation, version 1: four bytes of encapsulation,
then the fields in order, each aligned to its own size counted from the end of the encapsulation. A
string is its length with the closing zero (uint32), then its bytes. Messages of one topic nearly
always have the same size, so a whole topic is one structured NumPy array, or one for each length of
its names; otherwise rosbags deserialises them one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from airpuck.boundary.limits import FIELDS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: Message definitions as rosbags keeps them: type name -> (constants, fields).
Types = Mapping[str, Any]

#: ROS name -> NumPy code of the little-endian number.
_NUMBERS = {
    **{f"int{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)},
    "float32": "<f4",
    "float64": "<f8",
    **dict.fromkeys(("bool", "byte", "char", "octet"), "<u1"),
}
_STRING = "string"
#: Suffix of the columns that hold texts; the column without it holds their length.
_TEXT = "\0"
#: Messages with more layouts than this, such as names of many lengths, are decoded one by one.
_LAYOUTS = 64
_ENCAPSULATION = 4
_LITTLE_ENDIAN = b"\x00\x01"
_DEEPEST = 16


class Field(NamedTuple):
    """One leaf of a message."""

    #: Field names from the outermost to the innermost, joined by dots: ``pose.position.x``.
    path: str
    #: NumPy code of a number or a fixed array (``36<f8``), or ``string``; with ``*`` before it, a
    #: sequence of these; empty for other types.
    code: str


def flatten(types: Types, msgtype: str) -> list[Field]:
    """List the leaves of a message type in wire order."""
    visited = list(islice(_fields(types, msgtype), FIELDS + 1))
    if len(visited) > FIELDS:
        raise ValueError(f"{msgtype} is defined with more than {FIELDS:,} fields")
    return [field for field in visited if field is not None]


def _fields(types: Types, msgtype: str, prefix: str = "", depth: int = 0) -> Iterator[Field | None]:
    """Yield the leaves of a message type, and None for each field with its own leaves."""
    from rosbags.interfaces import Nodetype

    if msgtype not in types:
        raise ValueError(f"the definition of {msgtype} is missing")
    if depth > _DEEPEST:
        raise ValueError(f"the definition of {msgtype} is nested too deeply")
    for name, (node, description) in types[msgtype][1]:
        count, prefixed = 1, ""
        if node == Nodetype.ARRAY:
            (node, description), count = description
        elif node == Nodetype.SEQUENCE:
            (node, description), prefixed = description[0], "*"
        if node == Nodetype.NAME and count == 1 and not prefixed:
            yield None
            yield from _fields(types, description, f"{prefix}{name}.", depth + 1)
            continue
        code = ""
        if node == Nodetype.BASE:
            if description[0] in _NUMBERS:
                code = prefixed + ("" if count == 1 else str(count)) + _NUMBERS[description[0]]
            elif description[0] == _STRING and count == 1:
                code = prefixed + _STRING
        yield Field(prefix + name, code)


def typestore(types: Types, msgtype: str) -> Typestore:
    """Return rosbags' store for a message type and its nested types."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(_definitions_within(types, msgtype))
    return store


def _definitions_within(types: Types, msgtype: str) -> dict[str, Any]:
    from rosbags.interfaces import Nodetype

    needed, missing = {}, [msgtype]
    while missing:
        name = missing.pop()
        if name in needed:
            continue
        needed[name] = types[name]
        for _, (node, description) in types[name][1]:
            while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                node, description = description[0]
            if node == Nodetype.NAME:
                missing.append(description)
    return needed


def decode(
    messages: Sequence[bytes], types: Types, msgtype: str, paths: Sequence[str]
) -> dict[str, np.ndarray]:
    """Read fields of many messages of one type; their arrays must agree in length."""
    fields = flatten(types, msgtype)
    codes = dict(fields)
    if not messages:
        return {path: _column(path, codes[path], ()) for path in paths}
    tables, places, rest = _tables(messages, fields)
    if not len(rest):
        order = np.argsort(np.concatenate(places), kind="stable") if len(places) > 1 else ...
        parts = {path: [_part(table, path, codes[path]) for table in tables] for path in paths}
        return {path: np.concatenate(part)[order] for path, part in parts.items()}
    rows = decode_singly(messages, types, msgtype, paths)
    columns = zip(paths, zip(*rows, strict=True), strict=True)
    return {path: _column(path, codes[path], column) for path, column in columns}


def _tables(
    messages: Sequence[bytes], fields: Sequence[Field]
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return tables of messages with one layout each, their places, and the places of others."""
    sizes = np.fromiter(map(len, messages), np.int64, len(messages))
    rest, tables, places = np.arange(len(messages)), [], []
    lengths = [path for path, code in fields if code == _STRING]
    while len(rest) and len(tables) < _LAYOUTS:
        layout = layout_of(fields, messages[rest[0]])
        if layout is None:
            break
        fits = sizes[rest] == layout.itemsize
        whole = len(rest) == len(messages) and fits.all()
        joint = b"".join(messages if whole else [messages[place] for place in rest[fits]])
        table = np.frombuffer(joint, layout)
        same = np.ones(len(table), bool)
        for name in ("encapsulation", *lengths):
            same &= table[name] == table[name][0]
        tables.append(table if same.all() else table[same])
        places.append(rest[fits][same])
        fits[fits] = same
        rest = rest[~fits]
    return tables, places, rest


def _part(table: np.ndarray, path: str, code: str) -> np.ndarray:
    """Return a field of all messages in a table."""
    if code != _STRING:
        return table[path]
    texts = table[path + _TEXT]
    if (texts == texts[0]).all():
        return np.full(len(texts), texts[0].decode(errors="replace"))
    return np.char.decode(texts, errors="replace")


def layout_of(fields: Sequence[Field], message: bytes) -> np.dtype | None:
    """Return the offsets of a message's numbers and string lengths; None if sizes vary.

    Messages have this layout if they agree in size, encapsulation and lengths of strings.
    """
    if message[:2] != _LITTLE_ENDIAN:
        return None
    names, numbers, offsets = ["encapsulation"], [np.dtype("<u4")], [0]
    end = _ENCAPSULATION
    for path, code in fields:
        if not code or code[0] == "*":
            return None
        number = np.dtype("<u4" if code == _STRING else code)
        start = end + -(end - _ENCAPSULATION) % number.base.itemsize
        end = start + number.itemsize
        names.append(path)
        numbers.append(number)
        offsets.append(start)
        if code == _STRING:
            size = int.from_bytes(message[start:end], "little")
            if 0 < size <= len(message) - end:
                names.append(path + _TEXT)
                numbers.append(np.dtype(f"S{size}"))
                offsets.append(end)
            end += size
    if not end <= len(message) < end + 4:
        return None
    return np.dtype(
        {"names": names, "formats": numbers, "offsets": offsets, "itemsize": len(message)}
    )


def _column(path: str, code: str, values: Sequence[Any]) -> np.ndarray:
    """Collect one field of many messages in an array, with a row for each."""
    number = code.removeprefix("*")
    kind = np.dtype(str if number == _STRING else number)
    if not values:
        return np.zeros((0, 0) if code[0] == "*" else (0, *kind.shape), kind.base)
    if code[0] == "*":
        first = len(values[0])
        for index, value in enumerate(values):
            if len(value) != first:
                raise ValueError(
                    f"message {index + 1} has {len(value)} entries in {path}, the first has {first}"
                )
    return np.array(values, kind.base)


def decode_singly(
    messages: Sequence[bytes], types: Types, msgtype: str, paths: Sequence[str]
) -> list[tuple[Any, ...]]:
    """Let rosbags deserialise message by message."""
    try:
        store = typestore(types, msgtype)
        store.get_msgdef(msgtype)
    # rosbags compiles definitions to code; a damaged definition can fail there in any way.
    except Exception as error:
        raise ValueError(f"the definition of {msgtype} cannot be used") from error
    rows = []
    for index, message in enumerate(messages):
        try:
            row = store.deserialize_cdr(message, msgtype)
        # rosbags does not check the content of messages either.
        except Exception as error:
            raise ValueError(f"message {index + 1} cannot be decoded: {error}") from error
        rows.append(tuple(attrgetter(path)(row) for path in paths))
    return rows


def encode(template: bytes, layout: np.dtype, columns: Mapping[str, np.ndarray]) -> list[bytes]:
    """Write many messages that differ from a template only in some numbers."""
    table = np.frombuffer(bytearray(template * len(next(iter(columns.values())))), layout)
    for path, column in columns.items():
        table[path] = column
    raw = table.tobytes()
    return [raw[start : start + len(template)] for start in range(0, len(raw), len(template))]
