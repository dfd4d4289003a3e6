from __future__ import annotations

from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.mapping import Topics, read_mapping


def test_names_given_replace_the_defaults(tmp_path: Path):
    (tmp_path / "t.toml").write_text('[topics]\npose = "/mocap/puck"\n')
    topics = read_mapping(tmp_path / "t.toml").topics
    assert topics.pose == "/mocap/puck"
    assert topics.command == "/drone/control"
    assert topics.by_stream["imu"] == "/drone/imu"


def test_no_section_is_the_defaults(tmp_path: Path):
    (tmp_path / "t.toml").write_text("")
    assert read_mapping(tmp_path / "t.toml").topics == Topics()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[topics]\nposes = "/a"', "topics.poses: is not a known key"),
        ('[topics]\npose = "a"', "topics.pose"),
        ("[topics]\npose = 3", "topics.pose"),
        ('[topics]\npose = "/drone/control"', "named for two streams"),
        ('[topic]\npose = "/a"', "topic: is not a known key"),
    ],
)
def test_mistakes(tmp_path: Path, text: str, says: str):
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(InputError, match=says):
        read_mapping(tmp_path / "t.toml")


def test_a_topic_is_required_once_it_is_named():
    assert not Topics().required("imu")
    assert Topics(imu="/drone/imu").required("imu")
    assert Topics().required("pose")
