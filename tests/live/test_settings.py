from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.live.settings import read_topics


def test_a_live_mapping_accepts_only_topics(tmp_path: Path):
    (tmp_path / "m.toml").write_text("[command]\nscale = 0.01\n")
    with pytest.raises(InputError, match=r"m\.toml: command: is for recordings"):
        read_topics(tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text('[topics]\npose = "/a"\n')
    assert read_topics(tmp_path / "m.toml").pose == "/a"
    (tmp_path / "m.toml").write_text('[topics]\npose = "a"\n')
    with pytest.raises(InputError, match=r"topics\.pose: 'a' must begin with a slash"):
        read_topics(tmp_path / "m.toml")
