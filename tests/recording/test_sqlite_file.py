import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.read import read_recording

from ..apparatus.bags import rosbags_folder


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    rosbags_folder(tmp_path / "whole")
    return tmp_path / "whole" / "whole.db3"


def left_by_a_killed_recorder(live: Path, folder: Path) -> Path:
    """Copy an open database with its journals, as a killed recorder leaves them."""
    folder.mkdir()
    for suffix in ("", "-wal", "-shm", "-journal"):
        file = live.with_name(live.name + suffix)
        if file.exists():
            shutil.copy(file, folder / f"flight_0.db3{suffix}")
    return folder


def unfinished(whole: Path, folder: Path, *, saved: int | None) -> Path:
    """A bag of which only the first messages, or nothing at all, are out of the write-ahead log."""
    live = whole.with_name("live.db3")
    with closing(sqlite3.connect(whole)) as source:
        statements = [text for text in source.iterdump() if text.startswith(("CREATE", "INSERT"))]
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        for statement in sorted(statements, key=lambda text: 'INSERT INTO "messages"' in text):
            if saved == 0:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            if saved is not None:
                saved -= 'INSERT INTO "messages"' in statement
            database.execute(statement)
        return left_by_a_killed_recorder(live, folder)


@pytest.mark.parametrize("saved", [None, 4])
def test_messages_in_the_write_ahead_log_are_read(tmp_path: Path, whole: Path, saved: int | None):
    folder = unfinished(whole, tmp_path / "bag", saved=saved)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    recording = read_recording(folder)
    assert recording.streams == read_recording(whole).streams
    assert "flight_0.db3-wal is read with it" in recording.warnings[0]
    assert set(recording.hashes) == {"flight_0.db3", "flight_0.db3-wal"}
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_a_damaged_write_ahead_log_loses_only_its_messages(tmp_path: Path, whole: Path):
    folder = unfinished(whole, tmp_path / "bag", saved=4)
    journal = folder / "flight_0.db3-wal"
    for content in (b"x" * 10_000, journal.read_bytes()[:100], bytes(journal.stat().st_size)):
        journal.write_bytes(content)
        recording = read_recording(folder)
        assert 1 <= len(recording["pose"]) <= 4


def test_an_incomplete_transaction_is_rolled_back(tmp_path: Path, whole: Path):
    original = read_recording(whole)
    live = whole.with_name("live.db3")
    shutil.copy(whole, live)
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA cache_size = 1")
        database.execute("BEGIN")
        database.execute("UPDATE messages SET data = zeroblob(20000)")
        folder = left_by_a_killed_recorder(live, tmp_path / "bag")
    assert (folder / "flight_0.db3-journal").stat().st_size
    assert read_recording(folder).streams == original.streams


def test_the_hash_of_a_topic_selects_one_of_two_definitions(tmp_path: Path, whole: Path):
    original = read_recording(whole)["command"]
    with sqlite3.connect(whole) as database:
        (text, digest) = database.execute(
            "SELECT encoded_message_definition, type_description_hash FROM message_definitions "
            "WHERE topic_type LIKE '%Control%'"
        ).fetchone()
        kind = "holohover_msgs/msg/HolohoverControlStamped"
        other = text.replace("motor_a_1", "motor_x").replace("motor_c_2", "motor_a_1")
        database.execute("UPDATE message_definitions SET id = id + 10")
        database.execute(
            "INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?, 'RIHS01_other')",
            [kind, other],
        )
        assert digest
    assert read_recording(whole)["command"] == original
    with sqlite3.connect(whole) as database:
        database.execute("UPDATE topics SET type_description_hash = ''")
    with pytest.raises(InputError, match=r"defines holohover_msgs.* twice"):
        read_recording(whole)


def test_an_unknown_message_format_is_rejected_by_name(whole: Path):
    with sqlite3.connect(whole) as database:
        database.execute("UPDATE topics SET serialization_format = 'protobuf'")
    with pytest.raises(InputError, match="encoded as protobuf"):
        read_recording(whole)
