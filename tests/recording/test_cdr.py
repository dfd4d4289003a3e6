import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from airpuck.recording.cdr import Field, decode, encode, flatten, layout_of

from ..apparatus.bags import pose_message, stamped
from ..apparatus.messages import STORE, serialise

POSE = "geometry_msgs/msg/PoseStamped"


def odometry(frame: str, child: str, x: float, sec: int = 5) -> bytes:
    header = {"stamp": {"sec": sec, "nanosec": 7}, "frame_id": frame}
    pose = {"pose": {"position": {"x": x}}}
    return serialise(
        "nav_msgs/msg/Odometry", {"header": header, "child_frame_id": child, "pose": pose}
    )


def test_fields_are_in_wire_order():
    leaves = flatten(STORE.fielddefs, POSE)
    assert [leaf.path for leaf in leaves[:4]] == [
        "header.stamp.sec",
        "header.stamp.nanosec",
        "header.frame_id",
        "pose.position.x",
    ]
    covariance = flatten(STORE.fielddefs, "nav_msgs/msg/Odometry")[-1]
    assert covariance == Field("twist.covariance", "36<f8")


def test_only_single_texts_and_sequences_of_them_are_read():
    text = "string one\nstring[3] three\nstring[] any\nfloat64[3] numbers\n"
    found = flatten(get_types_from_msg(text, "a/msg/B"), "a/msg/B")
    assert [leaf.code for leaf in found] == ["string", "", "*string", "3<f8"]


def test_a_missing_or_recursive_definition_raises_value_error():
    with pytest.raises(ValueError, match="other_msgs/msg/Thing is missing"):
        flatten(get_types_from_msg("other_msgs/Thing thing", "a/msg/A"), "a/msg/A")
    with pytest.raises(ValueError, match="nested too deeply"):
        flatten(get_types_from_msg("a/A again", "a/msg/A"), "a/msg/A")


@given(frame=st.text(max_size=12), count=st.integers(1, 5))
def test_poses_with_any_frame_name_match_rosbags(frame: str, count: int):
    messages = [pose_message(10**9 * i + 17, 0.1 * i, -3.0, 0.5, frame) for i in range(count)]
    paths = ["header.stamp.sec", "header.stamp.nanosec", "pose.position.x", "pose.orientation.w"]
    read = decode(messages, STORE.fielddefs, POSE, paths)
    by_rosbags = [STORE.deserialize_cdr(message, POSE) for message in messages]
    assert read["header.stamp.sec"].tolist() == [m.header.stamp.sec for m in by_rosbags]
    assert read["header.stamp.nanosec"].tolist() == [17] * count
    assert read["pose.position.x"].tolist() == [m.pose.position.x for m in by_rosbags]
    assert read["pose.orientation.w"].tolist() == [m.pose.orientation.w for m in by_rosbags]


@pytest.mark.parametrize(
    ("frames", "children"),
    [
        (["map", "map"], ["base", "base"]),
        # Equal sizes, but a shift between the strings; and different sizes.
        (["ab", "abc"], ["abc", "ab"]),
        (["a", "abcdefghijkl"], ["", "x"]),
    ],
)
def test_layouts_may_change_from_message_to_message(frames: list[str], children: list[str]):
    messages = [
        odometry(frame, child, x)
        for frame, child, x in zip(frames, children, (1.5, 2.5), strict=True)
    ]
    paths = ["header.stamp.sec", "pose.pose.position.x"]
    read = decode(messages, STORE.fielddefs, "nav_msgs/msg/Odometry", paths)
    assert read["pose.pose.position.x"].tolist() == [1.5, 2.5]
    assert read["header.stamp.sec"].tolist() == [5, 5]
    assert read["header.stamp.sec"].dtype == np.int32


@pytest.mark.parametrize(
    ("before", "after", "rows"),
    [
        ("string a", "string b", [("", 0.5, "abcdefgh"), ("abcdefghijk", 0.75, "")]),
        ("float64[] many", "", [(np.ones(3), 0.5), (np.ones(1), 0.75)]),
    ],
)
def test_numbers_between_strings_and_changing_sequences_are_read(before, after, rows):
    types = get_types_from_msg(f"{before}\nfloat64 x\n{after}", "a/msg/A")
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    messages = [bytes(store.serialize_cdr(store.types["a/msg/A"](*row), "a/msg/A")) for row in rows]
    assert decode(messages, types, "a/msg/A", ["x"])["x"].tolist() == [0.5, 0.75]


def test_messages_of_both_byte_orders_are_read():
    fields = {"header": {"stamp": {"sec": 3}}, "pose": {"position": {"y": 0.25}}}
    messages = [serialise(POSE, fields, little_endian=order) for order in (True, False)]
    # Without a string whose length would reveal it.
    types = get_types_from_msg("float64 x", "a/msg/A")
    plain = [b"\x00\x01\x00\x00" + struct.pack("<d", 1.5), bytes(4) + struct.pack(">d", 2.5)]
    for some in (messages, messages[1:] * 2):
        read = decode(some, STORE.fielddefs, POSE, ["header.stamp.sec", "pose.position.y"])
        assert read["header.stamp.sec"].tolist() == [3, 3]
        assert read["pose.position.y"].tolist() == [0.25, 0.25]
    assert decode(plain, types, "a/msg/A", ["x"])["x"].tolist() == [1.5, 2.5]


@pytest.mark.parametrize("cut", [0, 2, 4, 9, 15, 20, 40, 70])
def test_a_truncated_message_raises_value_error(cut: int):
    message = pose_message(1, 0, 0, 0, "world")
    for messages in ([message[:cut]], [message, message[:cut]], [message[:cut], message[:cut]]):
        with pytest.raises(ValueError, match="cannot be decoded"):
            decode(messages, STORE.fielddefs, POSE, ["pose.position.x"])


def test_an_overlong_message_raises_value_error():
    message = stamped(1, "", [1, 2, 3, 0, 0, 0, 1, 99])
    with pytest.raises(ValueError, match="message 1 cannot be decoded"):
        decode([message], STORE.fielddefs, POSE, ["pose.position.x"])


@pytest.mark.parametrize(
    "text",
    [
        "float64 x\nother_msgs/Thing[] things",
        "float64 x\na/A[] again",
        "builtin_interfaces/Time t\nfloat64 x\n" + "=" * 80 + "\n"
        "MSG: builtin_interfaces/Time\nint64 other\n",
    ],
)
def test_an_unusable_definition_raises_value_error(text: str):
    types = get_types_from_msg(text, "a/msg/A")
    with pytest.raises(ValueError, match="definition of a/msg/A cannot be used"):
        decode([b"\x00\x00\x00\x00" + bytes(8)], types, "a/msg/A", ["x"])


def test_no_messages_give_empty_columns():
    read = decode([], STORE.fielddefs, POSE, ["header.stamp.sec", "pose.position.x"])
    assert [len(column) for column in read.values()] == [0, 0]


@given(frame=st.text(alphabet="abcäö", max_size=9))
def test_encoding_matches_rosbags(frame: str):
    template, *expected = (
        serialise(
            POSE,
            {"header": {"stamp": {"sec": sec}, "frame_id": frame}, "pose": {"position": {"x": x}}},
        )
        for sec, x in ((7, 8.0), (1, 0.1), (2, -0.2))
    )
    layout = layout_of(flatten(STORE.fielddefs, POSE), template)
    values = {"header.stamp.sec": np.array([1, 2]), "pose.position.x": np.array([0.1, -0.2])}
    assert layout is not None
    assert encode(template, layout, values) == expected


@given(names=st.lists(st.text(max_size=9), min_size=1, max_size=80))
def test_texts_of_any_length_match_rosbags(names: list[str]):
    messages = [odometry("", name, float(k)) for k, name in enumerate(names)]
    read = decode(
        messages,
        STORE.fielddefs,
        "nav_msgs/msg/Odometry",
        ["child_frame_id", "pose.pose.position.x"],
    )
    expected = [STORE.deserialize_cdr(m, "nav_msgs/msg/Odometry").child_frame_id for m in messages]
    # NumPy's texts end before zeros.
    assert read["child_frame_id"].tolist() == [name.rstrip("\0") for name in expected]
    assert read["pose.pose.position.x"].tolist() == list(range(len(names)))
