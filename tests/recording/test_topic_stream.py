"""Topics on which several rigid bodies are published."""

from pathlib import Path

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.mapping import PoseMapping, RecordingMapping, Topics
from airpuck.recording.message import definitions
from airpuck.recording.read import read_recording
from airpuck.recording.topic_stream import body_array

from ..apparatus.bags import START_NS, foreign_topics, ros_header, ros_topic, write_mcap

N = 30
POSES = np.random.default_rng(5).uniform(-1, 1, (N, 3))
NAMED_POSES = (
    "std_msgs/Header header\nNamedPose[] poses\n"
    + "=" * 80
    + "\nMSG: motion_capture_tracking_interfaces/NamedPose\nstring name\ngeometry_msgs/Pose pose\n"
)
RIGID_BODIES = (
    "std_msgs/Header header\nuint32 frame_number\nmocap4r2_msgs/RigidBody[] rigidbodies\n"
    + "=" * 80
    + "\nMSG: mocap4r2_msgs/RigidBody\nstring rigid_body_name\ngeometry_msgs/Pose pose\n"
)


def placed(types, pose, position="Point", kind="Pose"):
    """A pose of our three numbers, as a message."""
    x, y, yaw = map(float, pose)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    return types[f"geometry_msgs/msg/{kind}"](
        types[f"geometry_msgs/msg/{position}"](x, y, 0.1), turn
    )


def transform(types, k: int, name: str, pose):
    header = ros_header(types, START_NS + k)
    moved = placed(types, pose, "Vector3", "Transform")
    return types["geometry_msgs/msg/TransformStamped"](header, name, moved)


def odometry(types, k: int, name: str, pose):
    within = types["geometry_msgs/msg/PoseWithCovariance"](placed(types, pose), np.zeros(36))
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = types["geometry_msgs/msg/Twist"](zero, zero)
    moving = types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
    header = ros_header(types, START_NS + k)
    return types["nav_msgs/msg/Odometry"](header, name, within, moving)


def bodies(k: int):
    """The bodies seen in frame k; the ball is lost from time to time."""
    yield "wand", (0.3, 0.2, 0.1)
    if k % 7:
        yield "ball of the game", (-0.1 * k, 0.0, 0.5)
    yield "craft", POSES[k]


def one_by_one(kind: str, make):
    sent = [(k, name, pose) for k in range(N) for name, pose in bodies(k)]
    return ros_topic(kind, [lambda t, s=s: make(t, *s) for s in sent])


def together(kind: str, make, text: str = ""):
    return ros_topic(kind, [lambda t, k=k: make(t, k) for k in range(N)], text)


def named_poses(types, k: int):
    entry = types["motion_capture_tracking_interfaces/msg/NamedPose"]
    entries = [entry(name, placed(types, pose)) for name, pose in bodies(k)]
    kind = types["motion_capture_tracking_interfaces/msg/NamedPoseArray"]
    return kind(ros_header(types, START_NS + k), entries)


def rigid_bodies(types, k: int):
    entry = types["mocap4r2_msgs/msg/RigidBody"]
    entries = [entry(name, placed(types, pose)) for name, pose in bodies(k)]
    kind = types["mocap4r2_msgs/msg/RigidBodies"]
    return kind(ros_header(types, START_NS + k), k, entries)


def frames(types, k: int):
    entries = [transform(types, k, name, pose) for name, pose in bodies(k)]
    return types["tf2_msgs/msg/TFMessage"](entries)


#: Message type -> how its topic is made.
FORMS = {
    "geometry_msgs/msg/TransformStamped": (one_by_one, transform),
    "nav_msgs/msg/Odometry": (one_by_one, odometry),
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": (together, named_poses, NAMED_POSES),
    "mocap4r2_msgs/msg/RigidBodies": (together, rigid_bodies, RIGID_BODIES),
    "tf2_msgs/msg/TFMessage": (together, frames),
}


def make(form: str):
    """A topic of several bodies."""
    made, *how = FORMS[form]
    return made(form, *how)


def bag(path: Path, form: str) -> Path:
    topics = {"/bodies": make(form), "/drone/control": foreign_topics()["/drone/control"]}
    return write_mcap(path / "a.mcap", topics)


def mapping(body: str = "", **more) -> RecordingMapping:
    topics = Topics(pose="/bodies", **dict.fromkeys(more, "/bodies"))
    return RecordingMapping(topics=topics, pose=PoseMapping(body=body), **more)


@pytest.mark.parametrize("form", FORMS)
def test_one_of_several_bodies_is_selected_by_name(tmp_path: Path, form: str):
    path = bag(tmp_path, form)
    recording = read_recording(path, mapping=mapping("craft"))
    assert recording["pose"].values == pytest.approx(POSES, abs=1e-12)
    assert (np.diff(recording["pose"].stamp_ns) == 1).all()
    both = mapping("craft", puck=PoseMapping(body="ball of the game"))
    recording = read_recording(path, mapping=both)
    assert recording["pose"].values == pytest.approx(POSES, abs=1e-12)
    assert recording["puck"].values[:, 0] == pytest.approx([-0.1 * k for k in range(N) if k % 7])


@pytest.mark.parametrize("form", FORMS)
def test_several_bodies_are_listed_unless_one_is_selected(tmp_path: Path, form: str):
    path, listed = bag(tmp_path, form), "rigid bodies wand, craft, ball of the game; choose one"
    with pytest.raises(InputError, match=f"/bodies: contains the {listed}"):
        read_recording(path, mapping=mapping())
    with pytest.raises(InputError, match=rf"pose\.body: contains the {listed}"):
        read_recording(path, mapping=mapping("Craft"))
    # A missing topic may be the one that holds bodies.
    with pytest.raises(InputError, match=r'topics = \{pose = "/bodies"\}'):
        read_recording(path)


def test_poses_of_a_single_body_need_no_name(tmp_path: Path):
    made = [lambda t, k=k: transform(t, k, "craft", POSES[k]) for k in range(N)]
    topics = foreign_topics() | {"/bodies": ros_topic("geometry_msgs/msg/TransformStamped", made)}
    recording = read_recording(write_mcap(tmp_path / "a.mcap", topics), mapping=mapping())
    assert recording["pose"].values == pytest.approx(POSES, abs=1e-12)


def test_a_body_name_is_rejected_if_messages_contain_none(tmp_path: Path):
    path = write_mcap(tmp_path / "a.mcap", foreign_topics())
    named = RecordingMapping(pose=PoseMapping(body="craft"))
    with pytest.raises(InputError, match=r"pose\.body: names no rigid bodies; leave out body"):
        read_recording(path, mapping=named)


def test_the_first_text_of_an_entry_is_its_name():
    text = NAMED_POSES.replace("string name", "std_msgs/Header header\nstring name\nstring owner")
    kind = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
    found = body_array({**definitions(), **definitions(kind, text)}, kind)
    assert found is not None
    assert (found.path, found.name) == ("poses", "name")
    assert found.pose[0] == "pose.position.x"


def test_two_streams_of_one_topic_need_different_bodies():
    with pytest.raises(InputError, match="/bodies is named for two streams; name a body for each"):
        RecordingMapping(topics=Topics(pose="/bodies", puck="/bodies"))
