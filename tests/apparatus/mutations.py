"""Damage to files of every kind: random bytes, and damage specific to each format."""

from __future__ import annotations

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
                strange = rng.choice(
                    ["\x1b[31m", "\0", "\u202e", "é", "[[", "a.b", "&a *a", "<<: "]
                )
                text = text[: token.start()] + strange + text[token.start() :]
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
        case 2 if array.dtype.kind == "f":
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
