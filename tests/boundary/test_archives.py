"""Hostile zip archives: they unpack to gigabytes, grow without end, or have false headers."""

import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from airpuck.boundary.limits import MIB
from airpuck.data.trajectory_file import read_trajectory
from airpuck.recording.torch_archive import read_authors_experiment

from ..apparatus.refusals import GIB, refusal, written
from ..apparatus.torch_archives import archive


def zeros_deflated(size: int) -> bytes:
    """Raw deflate of many zeros: one block, repeated."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(bytes(16 * MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    return block * (size // (16 * MIB)) + zlib.compressobj(9, zlib.DEFLATED, -15).flush()


def zip_member(name: str, data: bytes, *, says: int, method: int = 8, flags: int = 0) -> bytes:
    """A zip file with one member whose header may claim anything, packed by hand."""
    common = struct.pack("<HHHHHIIIHH", 20, flags, method, 0, 0, 0, len(data), says, len(name), 0)
    local = b"PK\3\4" + common + name.encode() + data
    entry = b"PK\1\2" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, 0)
    listed = entry + name.encode()
    return (
        local + listed + b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(listed), len(local), 0)
    )


@pytest.mark.parametrize("says", [4 * GIB - 1, 1000], ids=["honest", "lying"])
def test_a_zip_bomb_in_a_trajectory_is_rejected(tmp_path: Path, says: int):
    path = written(tmp_path, zip_member("about.npy", zeros_deflated(6 * GIB), says=says), "a.npz")
    assert path.stat().st_size < 8 * MIB
    refusal(read_trajectory, path, says="limit of 4 MiB" if says > GIB else "not a trajectory")


def test_a_zip_bomb_in_the_authors_file_is_rejected(tmp_path: Path):
    path = tmp_path / "data.pt"
    path.write_bytes(zip_member("data/data.pkl", zeros_deflated(6 * GIB), says=4 * GIB - 1))
    refusal(read_authors_experiment, path, says="compressed")


def test_a_sparse_file_of_gigabytes_is_rejected(tmp_path: Path):
    whole = archive(tmp_path / "data.pt").read_bytes()
    with zipfile.ZipFile(tmp_path / "data.pt") as content:
        size = content.getinfo("data/data/1").file_size
    # The claimed size of the second tensor's storage, and a file that is long enough for it.
    said = struct.pack("<II", size, size)
    place = whole.rindex(said)
    patched = whole[:place] + struct.pack("<II", 3 * GIB, 3 * GIB) + whole[place + 8 :]
    path = written(tmp_path, patched, "b.pt")
    refusal(read_authors_experiment, path, says=r"data/data/\d: unpacks to too much")


def npz(path: Path, flight, *, method: int = zipfile.ZIP_DEFLATED, **about) -> Path:
    """A trajectory's file with other metadata."""
    flight.save(path)
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    members["about"] = np.array(json.dumps(json.loads(str(members["about"])) | about))
    with zipfile.ZipFile(path, "w", method) as target:
        for name, array in members.items():
            with target.open(f"{name}.npy", "w") as member:
                np.save(member, array)
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory):
    return read_authors_experiment(archive(tmp_path_factory.mktemp("pt") / "data.pt"))


def test_an_archive_written_by_hand_is_read(tmp_path: Path, flight):
    back = read_trajectory(npz(tmp_path / "a.npz", flight, delay_s=0.5, delay_known=True))
    assert np.array_equal(back.state, flight.state)
    assert back.delay == 0.5


@pytest.mark.parametrize(
    ("about", "field"),
    [
        ({"delay_s": "soon"}, "delay_s"),
        ({"delay_s": [0.1, 0.2]}, "delay_s"),
        ({"delay_s": None}, "delay_s"),
        ({"delay_s": float("nan")}, "delay_s"),
        ({"delay_s": 10**400}, "number"),
        ({"excluded": 7}, "excluded"),
        ({"excluded": [{"start": "a", "stop": 1.0, "cause": "gap"}]}, "excluded.0.start"),
        ({"excluded": [[0.0, 1.0]]}, "excluded.0"),
        ({"hashes": ["a"]}, "hashes"),
        ({"hashes": {"a": 7}}, "hashes.a"),
        ({"propellers": 6}, "propellers"),
        ({"propellers": ["a", "b"]}, "command"),
        ({"warnings": {}}, "warnings"),
        ({"format": ["airpuck"]}, "format"),
    ],
)
def test_invalid_metadata_of_a_trajectory_names_its_field(
    tmp_path: Path, flight, about, field: str
):
    assert field in refusal(read_trajectory, npz(tmp_path / "a.npz", flight, **about), says=".")


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_unsupported_compression_is_rejected(tmp_path: Path, flight, method: int):
    refusal(read_trajectory, npz(tmp_path / "a.npz", flight, method=method), says="about.*deflate")


@pytest.mark.parametrize(
    ("method", "flags", "says"), [(8, 1, "encrypted"), (99, 0, "a method other than deflate")]
)
def test_encrypted_and_unknown_members_are_rejected(
    tmp_path: Path, method: int, flags: int, says: str
):
    content = zip_member("about.npy", b"x" * 50, says=50, method=method, flags=flags)
    refusal(read_trajectory, written(tmp_path, content, "a.npz"), says=says)


@pytest.mark.parametrize(
    "text", ['{"format": ' + "[" * 100_000 + "]" * 100_000 + "}", '{"a": ' + "9" * 5000 + "}"]
)
def test_metadata_that_is_nested_too_deeply_or_too_long_is_rejected(
    tmp_path: Path, flight, text: str
):
    path = npz(tmp_path / "a.npz", flight)
    with zipfile.ZipFile(path, "w") as target, target.open("about.npy", "w") as member:
        np.save(member, np.array(text))
    refusal(read_trajectory, path, says="nested|digits")


def test_an_archive_with_too_many_members_is_rejected(tmp_path: Path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as target:
        for number in range(30_000):
            target.writestr(f"member_of_a_long_name_{number}", b"")
    refusal(read_trajectory, path, says="list of members is too long")
