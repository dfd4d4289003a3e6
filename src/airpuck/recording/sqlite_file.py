"""Reading an SQLite storage file of rosbag2 within limits.

A killed recorder leaves a journal beside the file: a write-ahead log (``-wal``) with messages that
the file lacks, or what a half-written transaction replaced (``-journal``). SQLite applies it to a
copy, since the recording must not change.

SQLite checks no types, and a database may contain code: a generated column can make blobs of any
size, and a damaged tree can loop forever. So lengths, steps and rows are bounded.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import MESSAGE_BYTES, MIB, TOPICS
from airpuck.recording.unpacking import Log, TopicLog

#: A row takes about 15 steps and at least ten bytes. More steps mean a damaged file.
_STEPS, _STEPS_PER_BYTE = 10**6, 20
_STEPS_AT_ONCE = 10**5
_IDL = "ros2idl"
#: Columns that older versions of rosbag2 do not write.
_SERIALIZATION, _DIGEST = "serialization_format", "type_description_hash"
#: Maximum length of a topic's name and type.
_LONGEST_NAME = 1000
#: Maximum length of all definitions; requested topics come first.
_DEFINITIONS = MIB


def journals(path: Path) -> list[Path]:
    """Return what an unfinished recorder left beside an SQLite file."""
    beside = (path.with_name(path.name + suffix) for suffix in ("-wal", "-journal"))
    return [file for file in beside if file.is_file() and file.stat().st_size]


def read_sqlite(path: Path, wanted: Collection[str]) -> Log:
    """Read the wanted messages of an SQLite file, and of the journal beside it."""
    left = journals(path)
    size = sum(file.stat().st_size for file in (path, *left))
    try:
        with _opened(path, left) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_BYTES)
            database.execute("PRAGMA trusted_schema = OFF")
            _limit_steps(database, size)
            log, topics = _topics(database, path, wanted)
            _read_messages(database, size, topics, path)
            _count(database, log)
    except InputError:
        raise
    # An operational error carries SQLite's own message; a damaged file can cause any of them.
    except (sqlite3.Error, ValueError, OverflowError, OSError) as error:
        reason = "it takes too long to read" if str(error) == "interrupted" else str(error)
        raise InputError(f"is not a readable recording ({reason})", file=path) from error
    log.sort()
    if left:
        names = ", ".join(file.name for file in left)
        log.damage = [f"{path.name} was not closed by its recorder: {names} is read with it"]
    return log


@contextmanager
def _opened(path: Path, left: Sequence[Path]) -> Iterator[sqlite3.Connection]:
    """Open a database, or a copy to which its journals are applied."""
    if not left:
        uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as database:
            yield database
        return
    with tempfile.TemporaryDirectory() as folder:
        for file in (path, *left):
            shutil.copyfile(file, Path(folder, file.name))
        with closing(sqlite3.connect(Path(folder, path.name))) as database:
            yield database


def _limit_steps(database: sqlite3.Connection, size: int) -> None:
    """Interrupt a query that takes more steps than a file of this size can need."""
    left = _STEPS + _STEPS_PER_BYTE * size

    def used_up() -> bool:
        nonlocal left
        left -= _STEPS_AT_ONCE
        return left < 0

    database.set_progress_handler(used_up, _STEPS_AT_ONCE)


def _topics(
    database: sqlite3.Connection, path: Path, wanted: Collection[str]
) -> tuple[Log, dict[int, TopicLog]]:
    """Read the list of topics; return it, and the requested topics by number."""
    tables = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%'"
    there = {name for (name,) in database.execute(tables)}
    if not there >= {"messages", "topics"}:
        raise ValueError("it has no tables of messages and topics")
    log, numbers = Log(path), {}
    columns = _columns(database, "topics")
    encoding = _SERIALIZATION if _SERIALIZATION in columns else "'cdr'"
    digest = _DIGEST if _DIGEST in columns else "''"
    rows = database.execute(
        f"SELECT id, name, type, {encoding}, {digest} FROM topics ORDER BY id LIMIT {TOPICS + 1}"
    ).fetchall()
    if any(not isinstance(text, str) for row in rows for text in row[1:4]):
        raise ValueError("a topic has no name or no type")
    if any(sum(map(len, row[1:4])) > _LONGEST_NAME for row in rows):
        raise ValueError("a topic has too long a name")
    left = _DEFINITIONS if "message_definitions" in there else 0
    # Requested topics first, since the definitions of others only serve suggestions.
    for number, name, msgtype, encoding, digest in sorted(rows, key=lambda r: r[1] not in wanted):
        described = TopicLog(msgtype, encoding=encoding)
        if left > 0:
            _define(database, described, digest, needed=name in wanted)
            left -= len(described.definition)
        topic = log.topic(name, described)
        if name in wanted:
            numbers[number] = topic
    return log, numbers


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {name for (name,) in database.execute(f"SELECT name FROM pragma_table_info('{table}')")}


def _define(database: sqlite3.Connection, topic: TopicLog, digest: str, *, needed: bool) -> None:
    """Add the definition embedded in the file: of several, the one with the topic's hash."""
    hashed = _DIGEST if _DIGEST in _columns(database, "message_definitions") else "''"
    rows = database.execute(
        f"SELECT DISTINCT encoded_message_definition, encoding, {hashed} = ? AS mine "
        "FROM message_definitions WHERE topic_type = ? ORDER BY mine DESC, id LIMIT 2",
        [digest, topic.msgtype],
    ).fetchall()
    if not rows:
        return
    (text, encoding, mine), *others = rows
    if not isinstance(text, str):
        raise ValueError("a definition is not text")
    if needed and others and others[0][2] == mine and others[0][0] != text:
        raise ValueError(
            f"it defines {topic.msgtype} twice, and its messages do not say which they follow; "
            "export each part as CSV where its definition is installed"
        )
    topic.definition, topic.idl = text, encoding == _IDL


def _read_messages(
    database: sqlite3.Connection, left: int, topics: dict[int, TopicLog], path: Path
) -> None:
    """Read the messages of some topics, of this length together, in the order of the file."""
    places = ",".join("?" * len(topics))
    rows = database.execute(
        f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})", [*topics]
    )
    for number, time, message in rows:
        if type(time) is not int or not 0 <= time < 2**63 or type(message) is not bytes:
            raise ValueError("a message has no time or no content")
        left -= len(message)
        if left < 0:
            raise ValueError("its messages are longer than the file")
        topic = topics.get(number)
        if topic is None:
            raise ValueError("a message belongs to no topic")
        topic.add(time, message, path)


def _count(database: sqlite3.Connection, log: Log) -> None:
    """Count the messages on all topics."""
    query = "SELECT count(*), min(timestamp), max(timestamp) FROM messages"
    n_messages, first, last = database.execute(query).fetchone()
    if n_messages and type(first) is int and type(last) is int:
        log.count(n_messages, first, last)
