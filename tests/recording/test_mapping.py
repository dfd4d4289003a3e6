from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.mapping import Topics, read_mapping


def test_given_names_replace_the_defaults(tmp_path: Path):
    (tmp_path / "t.toml").write_text('[topics]\npose = "/mocap/puck"\n')
    topics = read_mapping(tmp_path / "t.toml").topics
    assert topics.pose == "/mocap/puck"
    assert topics.command == "/drone/control"
    assert topics.by_stream["imu"] == "/drone/imu"
    (tmp_path / "t.toml").write_text("")
    assert read_mapping(tmp_path / "t.toml").topics == Topics()


def test_a_named_topic_is_required():
    assert not Topics().required("imu")
    assert Topics(imu="/drone/imu").required("imu")
    assert Topics().required("pose")


WHOLE = """
[topics]
pose = "/vicon/pose"
[pose]
units = ["mm", "deg"]
axes = ["-y", "x", "z"]
position = ["px", "py", "pz"]
orientation = { ZYX = ["a", "b", "c"] }
[command]
propellers = ["left", "right"]
scale = 0.01
"""


def test_a_complete_mapping_is_read(tmp_path: Path):
    (tmp_path / "m.toml").write_text(WHOLE)
    found = read_mapping(tmp_path / "m.toml")
    assert found.topics.pose == "/vicon/pose"
    assert found.pose.orientation == ("ZYX", ("a", "b", "c"))
    assert found.pose.size("length") == 1e-3
    assert found.pose.size("time") == 1
    index, sign = found.pose.permutation
    assert (index.tolist(), sign.tolist()) == ([1, 0, 2], [-1, 1, 1])
    assert found.command.propellers == ("left", "right")


@pytest.mark.parametrize(
    ("given", "kind", "columns"),
    [
        ('"yaw"', "yaw", ("yaw",)),
        ('{ w = "d", x = "a", y = "b", z = "c" }', "quaternion", ("a", "b", "c", "d")),
        ('["1", "2", "3", "4", "5", "6", "7", "8", "9"]', "matrix", tuple("123456789")),
        ('{ xzy = ["a", "b", "c"] }', "xzy", ("a", "b", "c")),
    ],
)
def test_every_notation_of_orientation_is_read(
    tmp_path: Path, given: str, kind: str, columns: tuple[str, ...]
):
    (tmp_path / "m.toml").write_text(f"[pose]\norientation = {given}\n")
    assert read_mapping(tmp_path / "m.toml").pose.orientation == (kind, columns)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[topics]\nposes = "/a"', "topics.poses: is not a known key"),
        ('[topics]\npose = " "', "topics.pose: ' ' is not the name of a topic"),
        ('[topics]\npose = "/a\\u0000"', "topics.pose"),
        ("[topics]\npose = 3", "topics.pose"),
        ('[topics]\npose = "/drone/control"', "named for two streams"),
        ('[topic]\npose = "/a"', "topic: is not a known key"),
        ('pose.orientation = ["a", "b", "c", "d"]', "pose.orientation: is .column. .yaw."),
        ("pose.orientation = 3", "pose.orientation: is .column."),
        ('pose.orientation = ""', "pose.orientation: is .column."),
        ('pose.orientation = { x = "a", y = "b", z = "c" }', "pose.orientation: is .column."),
        ('pose.orientation = { XyZ = ["a", "b", "c"] }', "pose.orientation: is .column."),
        ('pose.orientation = { XYX = ["a", "b", "c"] }', "pose.orientation: is .column."),
        ('pose.position = ["x"]', "pose.position: needs two or three coordinates, not 1"),
        ('pose.axes = "X-up"', "pose.axes: is .Z-up., .Y-up., .NED., or our x, y and z"),
        ('pose.axes = ["x", "y", "y"]', "pose.axes: is .Z-up."),
        ("pose.axes = 3", "pose.axes: is .Z-up."),
        ("pose.axes = [1, 2, 3]", "pose.axes: is .Z-up."),
        ('pose.units = ["inch"]', "pose.units.0"),
        ('pose.units = ["mm", "m"]', "pose.units: names two units of length"),
        ("pose.start_s = nan", "pose.start_s"),
        ("command.scale = 0", "command: scale: must not be 0"),
        ('command.scale = "0.01"', "command.scale"),
        ('command.propellers = ["a", "b", "a"]', "command: a is named twice"),
        ('command.topic = "/motors"', "command.topic: is not a known key"),
        ("[command]\nneutral = 1500", "neutral and span: use both"),
        ("[command]\nneutral = 1500\nspan = 0", "span: must not be 0"),
        ("[command]\nneutral = 1500\nspan = 500\nscale = 2", "exclude each other"),
        ("[command]\nbits = [0, 1]\noffset = 1", "exclude each other"),
        ("[command]\nbits = [0, 0]", "0 is named twice"),
        ("[command]\nbits = [0, 53]", "less than 53"),
        ('[command]\nbits = [0, 1]\nvalues = ["a", "b"]', "a bit mask is one value"),
    ],
)
def test_mistakes_are_reported_by_key(tmp_path: Path, text: str, says: str):
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(InputError, match=says):
        read_mapping(tmp_path / "m.toml")
