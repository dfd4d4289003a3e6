"""Reading an SQLite storage file of rosbag2 within limits.

SQLite checks no types, and a database may contain code: a generated column can make blobs of any
size, and a damaged tree can loop forever. So lengths, steps and rows are bounded.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection
from contextlib import closing
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import MESSAGE_BYTES, MIB, TOPICS
from airpuck.recording.unpacking import Log, TopicLog

#: A row takes about 15 steps and at least ten bytes. More steps mean a damaged file.
_STEPS, _STEPS_PER_BYTE = 10**6, 20
_STEPS_AT_ONCE = 10**5
_IDL = "ros2idl"
#: Maximum length of a topic's name and type.
_LONGEST_NAME = 1000
#: Maximum length of all definitions; requested topics come first.
_DEFINITIONS = MIB


def read_sqlite(path: Path, wanted: Collection[str]) -> Log:
    """Read the wanted messages of an SQLite file."""
    try:
        uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_BYTES)
            database.execute("PRAGMA trusted_schema = OFF")
            _limit_steps(database, path.stat().st_size)
            log, topics = _topics(database, path, wanted)
            _read_messages(database, path, topics)
            _count(database, log)
    except InputError:
        raise
    # An operational error carries SQLite's own message; a damaged file can cause any of them.
    except (sqlite3.Error, ValueError, OverflowError) as error:
        reason = "it takes too long to read" if str(error) == "interrupted" else str(error)
        raise InputError(f"is not a readable recording ({reason})", file=path) from error
    log.sort()
    return log


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
    log, numbers = Log(), {}
    rows = database.execute(f"SELECT id, name, type FROM topics ORDER BY id LIMIT {TOPICS + 1}")
    for number, name, msgtype in rows:
        if not isinstance(name, str) or not isinstance(msgtype, str):
            raise ValueError("a topic has no name or no type")
        if len(name) + len(msgtype) > _LONGEST_NAME:
            raise ValueError("a topic has too long a name")
        topic = log.topics.setdefault(name, TopicLog(msgtype))
        if name in wanted:
            numbers[number] = topic
    if "message_definitions" in there:
        left = _DEFINITIONS
        for topic in [*numbers.values(), *log.topics.values()]:
            _define(database, topic)
            left -= len(topic.definition)
            if left < 0:
                break
    log.check_topics(path)
    return log, numbers


def _define(database: sqlite3.Connection, topic: TopicLog) -> None:
    """Add the definition embedded in the file."""
    row = database.execute(
        "SELECT encoded_message_definition, encoding FROM message_definitions "
        "WHERE topic_type = ? ORDER BY id LIMIT 1",
        [topic.msgtype],
    ).fetchone()
    if row is not None:
        if not isinstance(row[0], str):
            raise ValueError("a definition is not text")
        topic.definition, topic.idl = row[0], row[1] == _IDL


def _read_messages(database: sqlite3.Connection, path: Path, topics: dict[int, TopicLog]) -> None:
    """Read the messages of some topics, in the order of the file."""
    left = path.stat().st_size
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
        topic.received_ns.append(time)
        topic.messages.append(message)


def _count(database: sqlite3.Connection, log: Log) -> None:
    """Count the messages on all topics."""
    query = "SELECT count(*), min(timestamp), max(timestamp) FROM messages"
    n_messages, first, last = database.execute(query).fetchone()
    if n_messages and type(first) is int and type(last) is int:
        log.count(n_messages, first, last)
