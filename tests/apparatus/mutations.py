"""Damage to files of every kind: random bytes, and damage specific to each format."""

import bz2
import io
import json
import random
import re
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np

HUGE = [2**8, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**33, 2**62, 2**63, 2**64 - 1]
#: Replacements of a number, a text or a table.
VALUES = ["nan", "inf", "-inf", "1e400", "-0", "-1", "0", "1", "1e-320", "true", '""', '"text"']
VALUES += ["[]", "{}", "[[1.0]]", "[nan]", '["a"]', "null", "1979-05-27", "0x7fffffffffffffffffff"]
VALUES += ["9" * 26]
VALUES += ["9" * 5000, "[" * 900 + "]" * 900, "{a=" * 200 + "1" + "}" * 200]
VALUES += ['"\\u001b[2J\\u202e"', '"' + "x" * 5000 + '"', "[" + "1.0," * 3000 + "1.0]"]
#: Separators of tokens.
STRANGE = ["\x1b[31m", "\0", "\u202e", "é", "[[", "a.b", "&a *a", "<<: "]
_TOKEN = re.compile(r'"[^"\n]*"|[\w.+-]+|[^\w\s]')


def bytes_damaged(content: bytes, rng: random.Random) -> bytes:
    """Flip, cut, repeat, move, lengthen or overwrite some bytes."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        place, length = rng.randrange(len(data) + 1), rng.choice([1, 4, 8, 50, 1000])
        end = min(place + length, len(data))
        match rng.randrange(8):
            case 0 if data:
                data[place - 1] ^= 1 << rng.randrange(8)
            case 1 if data:
                data[place - 1] = rng.choice([0, 1, 9, 10, 27, 34, 44, 127, 128, 255])
            case 2:
                del data[place:end]
            case 3:
                del data[place:]
            case 4:
                data[place:place] = data[place:end] * rng.choice([1, 2, 50])
            case 5:
                size = rng.choice([2, 4, 8])
                number = rng.choice(HUGE) % 2 ** (8 * size)
                data[place : place + size] = number.to_bytes(size, "little")
            case 6:
                data[place:end] = rng.choice([b"\0", b"\xff"]) * (end - place)
            case _:
                other = rng.randrange(len(data) + 1)
                data[other:other] = data[place:end]
    return bytes(data)


def text_damaged(content: bytes, rng: random.Random) -> bytes:
    """Replace tokens and lines of a text, or its bytes."""
    if rng.random() < 0.2:
        return bytes_damaged(content, rng)
    text = content.decode()
    for _ in range(rng.choice([1, 1, 2, 5])):
        tokens = list(_TOKEN.finditer(text))
        lines = text.splitlines(keepends=True)
        if not tokens:
            return content
        token, line = rng.choice(tokens), rng.randrange(len(lines))
        other = rng.choice(tokens)[0]
        match rng.randrange(9):
            case 0 | 1 | 2:
                text = text[: token.start()] + rng.choice(VALUES) + text[token.end() :]
            case 3:
                text = text[: token.start()] + other + text[token.end() :]
            case 4:
                text = text[: token.start()] + text[token.end() :]
            case 5:
                text = "".join(lines[:line] + lines[line + 1 :])
            case 6:
                text = "".join(lines[:line] + lines[line : line + 1] * 2 + lines[line + 1 :])
            case 7:
                text = "".join(rng.sample(lines, len(lines)))
            case _:
                text = text[: token.start()] + rng.choice(STRANGE) + text[token.start() :]
    return text.encode()


def table_damaged(content: bytes, rng: random.Random) -> bytes:
    """Damage a CSV file: cells, columns, or its text."""
    if rng.random() < 0.3:
        return text_damaged(content, rng)
    rows = [line.split(",") for line in content.decode().splitlines()]
    row = rng.choice([rows[0], rng.choice(rows)])
    column = rng.randrange(len(row))
    match rng.randrange(5):
        case 0:
            row[column] = rng.choice([*VALUES, '"', '"\n', "log_time_ns", "header.stamp.sec"])
        case 1:
            for row in rows:
                row[column : column + 1] = []
        case 2:
            for row in rows:
                row[column : column + 1] *= rng.choice([2, 300])
        case 3:
            row[column:] = []
        case _:
            rows = rows[:1] * rng.choice([1, 2, 50])
    return "\n".join(map(",".join, rows)).encode()


def array_damaged(content: bytes, rng: random.Random) -> bytes:
    """Replace a NumPy array by one of other numbers, shape or type, or falsify its header."""
    if rng.random() < 0.4:
        return bytes_damaged(content[:200], rng) + content[200:]
    array = np.load(io.BytesIO(content))
    match rng.randrange(7):
        case 0:
            array = array[: rng.randrange(3)] if array.ndim else array[None]
        case 1:
            kind = rng.choice(["f4", "i8", "c16", "U3", "S5", "M8[s]", "?", "f8,i4", ">f8"])
            array = np.zeros(array.shape, kind)
        case 2 if array.dtype.kind == "f" and array.size:
            array = array.copy()
            array.flat[rng.randrange(array.size)] = rng.choice([np.nan, np.inf, 1e308, -5.0])
        case 3:
            array = np.asfortranarray(array).T
        case 4:
            array = array.reshape(rng.choice([(-1,), (1, -1), (-1, 1, 1)]))
        case _:
            shape = rng.choice(
                [b"(99999999999,)", b"(-1,)", b"(2,", b"((1,),)", b"(4611686018427387904, 4)"]
            )
            return re.sub(rb"\([^)]*\), ", shape + b", ", content[:200]) + content[200:]
    target = io.BytesIO()
    np.save(target, array, allow_pickle=True)
    return target.getvalue()


def archive_damaged(content: bytes, rng: random.Random) -> bytes:
    """Damage a member of a zip file and store it with the right checksum, or damage the file."""
    if rng.random() < 0.25:
        return bytes_damaged(content, rng)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
        method = archive.infolist()[0].compress_type
    name = rng.choice(list(members))
    if rng.random() < 0.2:
        members[rng.choice(list(members))] = members[name]
    elif rng.random() < 0.1:
        del members[name]
    elif name == "about.npy":
        about = json.loads(str(np.load(io.BytesIO(members[name]))))
        damaged = text_damaged(json.dumps(about, indent=1).encode(), rng)
        target = io.BytesIO()
        np.save(target, np.array(damaged.decode(errors="replace")))
        members[name] = target.getvalue()
    elif name.endswith(".npy"):
        members[name] = array_damaged(members[name], rng)
    else:
        members[name] = bytes_damaged(members[name], rng)
    if rng.random() < 0.05:
        method = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return target.getvalue()


_RECORD = struct.Struct("<BQ")


def _records(content: bytes) -> list[tuple[int, bytes]]:
    found, place = [], 0
    while place + 9 <= len(content):
        code, length = _RECORD.unpack_from(content, place)
        found.append((code, content[place + 9 : place + 9 + length]))
        place += 9 + length
    return found


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(_RECORD.pack(code, len(data)) + data for code, data in records)


def mcap_damaged(content: bytes, rng: random.Random) -> bytes:
    """Damage records, those in chunks included, with right lengths and checksums; or the file.

    The file's chunks must not be compressed.
    """
    if rng.random() < 0.25:
        return bytes_damaged(content, rng)
    records = _records(content[8:-8])
    index = rng.randrange(len(records))
    code, data = records[index]
    if code != 6 and rng.random() < 0.6:
        index = rng.choice([i for i, (code, _) in enumerate(records) if code == 6])
        code, data = records[index]
    if code == 6 and rng.random() < 0.9:
        inner = _records(data[40:])
        place = rng.choice([rng.randrange(len(inner)), rng.randrange(min(4, len(inner)))])
        kind, payload = inner[place]
        damaged = text_damaged if kind == 3 and rng.random() < 0.5 else bytes_damaged
        try:
            payload = damaged(payload, rng)
        except UnicodeDecodeError:
            payload = bytes_damaged(payload, rng)
        inner[place] = (rng.choice([kind] * 9 + [3, 4, 5, 6]), payload)
        chunk = _joined(inner * rng.choice([1, 1, 1, 3]))
        head = bytearray(data[:40])
        struct.pack_into("<QI", head, 16, len(chunk), zlib.crc32(chunk))
        struct.pack_into("<Q", head, 32, len(chunk))
        if rng.random() < 0.1:
            struct.pack_into("<Q", head, rng.choice([0, 8, 16, 32]), rng.choice(HUGE))
        records[index] = (6, bytes(head) + chunk)
    else:
        records[index] = (rng.choice([code, rng.randrange(16)]), bytes_damaged(data, rng))
    return content[:8] + _joined(records) + content[-8:]


_LENGTH = struct.Struct("<I")
#: Lengths and counts that no record has.
_ABSURD = [0, 1, 2**16, 2**28 + 1, 2**31 - 1, 2**32 - 1]
_PACK: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": bz2.compress,
    b"lz4": lz4.frame.compress,
}
_CONNECTION, _CHUNK = 7, 5

#: Header and content of a record in a ROS 1 bag.
Ros1Record = tuple[dict[bytes, bytes], bytes]


def _prefixed(data: bytes) -> bytes:
    return _LENGTH.pack(len(data)) + data


def _pieces(data: bytes) -> list[bytes]:
    """Split data into what the lengths before each piece say."""
    found, place = [], 0
    while place < len(data):
        (length,) = _LENGTH.unpack_from(data, place)
        found.append(data[place + 4 : place + 4 + length])
        place += 4 + length
    return found


def _ros1_fields(data: bytes) -> dict[bytes, bytes]:
    return {name: value for name, _, value in (one.partition(b"=") for one in _pieces(data))}


def _ros1_records(data: bytes) -> list[Ros1Record]:
    pieces = _pieces(data)
    return [(_ros1_fields(a), b) for a, b in zip(pieces[::2], pieces[1::2], strict=True)]


def _ros1_joined(fields: dict[bytes, bytes]) -> bytes:
    return b"".join(_prefixed(name + b"=" + value) for name, value in fields.items())


def _ros1_written(records: list[Ros1Record]) -> bytes:
    return b"".join(_prefixed(_ros1_joined(head)) + _prefixed(data) for head, data in records)


def _field_damaged(fields: dict[bytes, bytes], rng: random.Random) -> None:
    """Damage, drop or rename a field of a header."""
    if not fields:
        return
    name = rng.choice(list(fields))
    value = fields.pop(name)
    match rng.randrange(5):
        case 0:
            return
        case 1:
            fields[bytes_damaged(name, rng)] = value
        case 2 if len(value) in (4, 8):
            fields[name] = _LENGTH.pack(rng.choice(_ABSURD)) * (len(value) // 4)
        case 3:
            fields[name] = b"0" * len(value)
        case _:
            fields[name] = bytes_damaged(value, rng)


def _definition_damaged(fields: dict[bytes, bytes], rng: random.Random) -> bytes:
    """Damage the definition of a message, as text if it still is one."""
    content = fields.get(b"message_definition", b"")
    try:
        return text_damaged(content, rng)
    except UnicodeDecodeError:
        return bytes_damaged(content, rng)


def _connection_damaged(content: bytes, rng: random.Random) -> bytes:
    """Damage the description of a topic: its type, its definition, its md5sum."""
    fields = _ros1_fields(content)
    match rng.randrange(4):
        case 0:
            fields[b"md5sum"] = rng.choice([b"*", b"", b"0" * 32, b"\xff" * 32])
        case 1:
            fields[b"message_definition"] = _definition_damaged(fields, rng)
        case 2:
            others = [b"std_msgs/String", b"ff_msgs/WheelVelCommand", b"a", b"/", b"a/b/c", b""]
            fields[b"type"] = rng.choice(others)
        case _:
            _field_damaged(fields, rng)
    return _ros1_joined(fields)


def _ros1_record_damaged(record: Ros1Record, rng: random.Random) -> Ros1Record:
    """Damage one record: its header, or its content."""
    head, content = dict(record[0]), record[1]
    if rng.random() < 0.3:
        _field_damaged(head, rng)
    elif head.get(b"op") == bytes([_CONNECTION]) and rng.random() < 0.8:
        content = _connection_damaged(content, rng)
    else:
        content = bytes_damaged(content, rng)
    return head, content


def _chunk_damaged(record: Ros1Record, rng: random.Random) -> Ros1Record:
    """Damage records in a chunk and pack it, perhaps with a false size or method."""
    head, inner = dict(record[0]), _ros1_records(record[1])
    if rng.random() < 0.3:
        inner = [one for one in inner if one[0][b"op"] != bytes([_CONNECTION])]
    connections = [k for k, one in enumerate(inner) if one[0][b"op"] == bytes([_CONNECTION])]
    for _ in range(rng.choice([0, 1, 1, 4])):
        among = connections if connections and rng.random() < 0.5 else range(len(inner))
        place = rng.choice(among)
        inner[place] = _ros1_record_damaged(inner[place], rng)
    plain = _ros1_written(inner * rng.choice([1, 1, 1, 3]))
    method = rng.choice(list(_PACK))
    content, size = _PACK[method](plain), len(plain)
    match rng.randrange(6):
        case 0:
            size = rng.choice([*_ABSURD, size - 1, size + 1])
        case 1:
            method = rng.choice([b"bz2", b"lz4", b"none", b"zip", b"", b"\xff"])
        case 2:
            content = bytes_damaged(content, rng)
        case _:
            pass
    return head | {b"compression": method, b"size": _LENGTH.pack(size)}, content


def ros1_damaged(content: bytes, rng: random.Random) -> bytes:
    """Damage records of a ROS 1 bag, those in chunks included, with right lengths; or the file.

    The file's chunks must not be compressed.
    """
    if rng.random() < 0.2:
        return bytes_damaged(content, rng)
    start = content.index(b"\n") + 1
    records = _ros1_records(content[start:])
    chunks = [k for k, (head, _) in enumerate(records) if head[b"op"] == bytes([_CHUNK])]
    for _ in range(rng.choice([1, 1, 2, 5])):
        # The first chunks describe the topics.
        place = rng.choice(
            [rng.choice(chunks), rng.choice(chunks[:2]), rng.randrange(len(records))]
        )
        if place in chunks and rng.random() < 0.8:
            records[place] = _chunk_damaged(records[place], rng)
            chunks.remove(place)
        else:
            records[place] = _ros1_record_damaged(records[place], rng)
            chunks = [k for k in chunks if k != place]
        if not chunks:
            break
    if rng.random() < 0.1:
        records = rng.sample(records, len(records))
    return content[:start] + _ros1_written(records)


_STATEMENTS = [
    "UPDATE messages SET timestamp = {value} WHERE {where}",
    "UPDATE messages SET data = {value} WHERE {where}",
    "UPDATE messages SET data = zeroblob({size}) WHERE {where}",
    "UPDATE messages SET topic_id = {value} WHERE {where}",
    "UPDATE topics SET name = {value} WHERE {where}",
    "UPDATE topics SET type = {value} WHERE {where}",
    "UPDATE topics SET id = {value} WHERE {where}",
    "UPDATE message_definitions SET encoded_message_definition = {value} WHERE {where}",
    "UPDATE message_definitions SET encoding = {value} WHERE {where}",
    "DROP TABLE messages",
    "DROP TABLE message_definitions",
    "INSERT INTO messages SELECT id + 1000000, topic_id, timestamp, data FROM messages",
]


def sqlite_damaged(content: bytes, rng: random.Random, scratch: Path) -> bytes:
    """Change a database by statements of its own language, or damage the file."""
    if rng.random() < 0.5:
        return bytes_damaged(content, rng)
    scratch.write_bytes(content)
    database = sqlite3.connect(scratch)
    values = ["NULL", "'noon'", "x'00ff'", "-5", "1e300", "9223372036854775807", "zeroblob(100)"]
    values += ["char(27,91,50,74)", "'/drone/control'", "'holohover_msgs/msg/HolohoverState'"]
    for _ in range(rng.choice([1, 1, 3])):
        statement = rng.choice(_STATEMENTS).format(
            value=rng.choice(values),
            where=rng.choice(["1", f"id = {rng.randrange(12)}", "id % 2"]),
            size=rng.choice([0, 3, 4, 76, 100_000, 3_000_000]),
        )
        try:
            with database:
                database.execute(statement)
        except sqlite3.Error:
            continue
    database.close()
    damaged = scratch.read_bytes()
    scratch.unlink()
    return damaged


Mutate = Callable[[bytes, random.Random], bytes]
