from __future__ import annotations

from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.files import sha256


def test_the_hash_of_the_standard(tmp_path: Path):
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1.
    assert sha256(tmp_path / "abc") == (
        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    )


def test_what_cannot_be_read(tmp_path: Path):
    with pytest.raises(InputError, match="cannot be read"):
        sha256(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        sha256(tmp_path / "nowhere")
