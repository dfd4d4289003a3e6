import os
import shutil
from pathlib import Path

import pytest

from airpuck import InputError, Recording
from airpuck.recording.bag import write_bag
from airpuck.recording.csv_folder import write_csv
from airpuck.recording.read import read_recording

from ..apparatus.bags import flight
from ..apparatus.refusals import rejected


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    write_bag(flight(), tmp_path / "bag")
    return tmp_path / "bag"


def test_a_folder_with_one_recording_stands_for_it(tmp_path: Path, bag: Path):
    (tmp_path / "plots").mkdir()
    (tmp_path / "data.pt").write_bytes(b"preprocessed")
    recording = read_recording(tmp_path)
    assert recording.source == str(bag)
    assert recording.streams == read_recording(bag).streams


def test_several_recordings_are_reported_instead_of_guessed(tmp_path: Path, bag: Path):
    write_csv(flight(), tmp_path / "csv")
    with pytest.raises(InputError, match="contains several recordings; choose one of bag, csv"):
        read_recording(tmp_path)


def test_a_bag_takes_precedence_over_csv_files_made_from_it(tmp_path: Path, bag: Path):
    made = flight()
    write_csv(Recording({"pose": made["pose"], "command": made["command"]}, ""), tmp_path / "csv")
    for file in (tmp_path / "csv").iterdir():
        shutil.move(file, bag)
    assert set(read_recording(bag).streams) == set(made.streams)


def test_metadata_without_its_storage_file_is_reported(bag: Path):
    (bag / "bag_0.mcap").unlink()
    with pytest.raises(InputError, match="storage file is missing"):
        read_recording(bag)


def test_csv_files_are_read_beside_metadata_of_an_absent_bag(tmp_path: Path, bag: Path):
    write_csv(flight(), tmp_path / "csv")
    shutil.copy(bag / "metadata.yaml", tmp_path / "csv")
    recording = read_recording(tmp_path / "csv")
    assert recording.streams == flight().streams
    assert recording.warnings == ()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nowhere", "no such file or folder"),
        ("empty", "contains no recording"),
        ("file.csv", "has no header"),
        ("traj.npz", "is already preprocessed"),
        ("data.pt", "is already preprocessed"),
        ("notes.txt", "is not a recording"),
        ("pipe", "not a regular file"),
    ],
)
def test_files_that_are_not_recordings_are_rejected(tmp_path: Path, name: str, says: str):
    (tmp_path / "empty").mkdir()
    for file in ("file.csv", "traj.npz", "data.pt", "notes.txt"):
        (tmp_path / file).write_text("1,2\n")
    os.mkfifo(tmp_path / "pipe")
    with rejected(tmp_path / name, match=says):
        read_recording(tmp_path / name)


def test_hostile_names_stay_on_one_line(tmp_path: Path):
    from ..apparatus.bags import write_mcap

    path = write_mcap(
        tmp_path / "a.mcap", {f"/a\nb{i}": ("x\x1b[31m", "\n", []) for i in range(50)}
    )
    with rejected("38 more"):
        read_recording(path)
