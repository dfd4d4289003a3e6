import tomllib
from pathlib import Path

import numpy as np
import pytest

from airpuck import CommandMapping, InputError, PoseMapping, RecordingMapping
from airpuck.craft.vehicle import default_vehicle
from airpuck.preprocessing.pipeline import clean_streams
from airpuck.recording.mapping import Topics, read_mapping
from airpuck.recording.read import read_recording

from ..apparatus.bags import START_NS, Topic, foreign_topics, ros_header, ros_topic, write_mcap
from ..apparatus.refusals import rejected

N = 30
VALUES = np.random.default_rng(5).uniform(0, 1, (N, 4))
UNNAMED = ("value_1", "value_2", "value_3", "value_4")
NAMES = ("front_left", "front_right", "rear_left", "rear_right")
JOINTS = "sensor_msgs/msg/JointState"


def read(path: Path, motors: Topic, poses: Topic | None = None, **keys):
    """A recording of two topics; `keys` are parts of the mapping."""
    topics = {"/pose": poses or foreign_topics()["/optitrack/drone/pose"], "/motors": motors}
    mapping = RecordingMapping(topics=Topics(pose="/pose", command="/motors"), **keys)
    return read_recording(write_mcap(path / "a.mcap", topics), mapping=mapping)


def array(kind: str, values=VALUES, dimensions: int = 0) -> Topic:
    def make(row):
        def message(types):
            dimension = types["std_msgs/msg/MultiArrayDimension"]("motors", 4, 4)
            layout = types["std_msgs/msg/MultiArrayLayout"]([dimension] * dimensions, 0)
            return types[f"std_msgs/msg/{kind}MultiArray"](layout, np.array(row, kind.lower()))

        return message

    return ros_topic(f"std_msgs/msg/{kind}MultiArray", map(make, values))


def test_a_message_may_hold_a_bit_mask(tmp_path: Path):
    switches = np.random.default_rng(6).integers(0, 2, (N, 4))
    masks = (switches @ [1, 2, 4, 128])[:, None]
    command = CommandMapping(bits=(0, 1, 2, 7), propellers=NAMES)
    found = read(tmp_path, array("UInt8", masks), command=command)["command"]
    assert found.columns == NAMES
    np.testing.assert_array_equal(found.values, switches)


def joints(names, *, late: int = 7, **columns) -> Topic:
    """JointState; `names` of each message, columns (N, n)."""

    def make(index):
        def message(types):
            fields = [
                np.array(columns.get(name, np.zeros((N, 0)))[index])
                for name in ("position", "velocity", "effort")
            ]
            header = ros_header(types, START_NS + index * 10**7 - late)
            return types[JOINTS](header, list(names[index]), *fields)

        return message

    return ros_topic(JOINTS, map(make, range(N)))


def own(text: str, rows, *, stamped: bool = True) -> Topic:
    """A lab's own message type."""
    name = "lab_msgs/msg/Motors"

    def make(index_and_row):
        index, row = index_and_row

        def message(types):
            start = [ros_header(types, START_NS + index * 10**7 - 7)] if stamped else []
            return types[name](*start, *row)

        return message

    header = "std_msgs/Header header\n" if stamped else ""
    return ros_topic(name, map(make, enumerate(rows)), header + text)


@pytest.mark.parametrize("dimensions", [0, 1, 2])
@pytest.mark.parametrize(("kind", "exact"), [("Float64", 0), ("Float32", 1e-7)])
def test_arrays_without_a_header_are_read(tmp_path: Path, kind: str, exact: float, dimensions: int):
    recording = read(tmp_path, array(kind, dimensions=dimensions))
    command = recording["command"]
    assert command.columns == UNNAMED
    assert np.abs(command.values - VALUES).max() <= exact
    assert command.stamp_ns.tolist() == [START_NS + i * 10**7 for i in range(N)]
    (said,) = recording.warnings
    assert "/motors have no time" in said
    assert "arrival times" in said


def test_unnamed_values_follow_the_order_of_the_vehicle(tmp_path: Path):
    six = np.random.default_rng(6).uniform(0, 1, (N, 6))
    vehicle = default_vehicle()
    plain = read(tmp_path, array("Float64", six))
    _, cleaned, _ = clean_streams(plain, vehicle)
    assert np.array_equal(cleaned.values, six)
    names = vehicle.propeller_names[::-1]
    named = read(tmp_path, array("Float64", six), command=CommandMapping(propellers=names))
    assert named["command"].columns == names
    _, cleaned, _ = clean_streams(named, vehicle)
    assert np.array_equal(cleaned.values, six[:, ::-1])


def test_percentages_and_single_array_entries_are_read(tmp_path: Path):
    percent = np.round(100 * VALUES)
    chosen = CommandMapping(values=("data[3]", "data[0]"), scale=0.01)
    command = read(tmp_path, array("Float32", percent), command=chosen)["command"]
    np.testing.assert_allclose(command.values, percent[:, [3, 0]] / 100, rtol=1e-15)
    assert command.columns == ("value_1", "value_2")


def test_header_and_float32_fields_are_read(tmp_path: Path):
    text = "".join(f"float32 {name}\n" for name in NAMES)
    recording = read(tmp_path, own(text, VALUES.astype(np.float32)))
    assert recording["command"].columns == NAMES
    assert np.array_equal(recording["command"].values, VALUES.astype(np.float32))
    assert recording["command"].stamp_ns[2] == START_NS + 2 * 10**7 - 7
    assert recording.warnings == ()


@pytest.mark.parametrize("text", ["float64[4] speed\n", "float64[] speed\n"])
def test_a_header_with_an_array_is_read(tmp_path: Path, text: str):
    recording = read(tmp_path, own(text, [(row,) for row in VALUES]))
    assert recording["command"].columns == UNNAMED
    assert np.array_equal(recording["command"].values, VALUES)
    assert recording.warnings == ()


def test_pulse_widths_among_other_fields_are_read(tmp_path: Path):
    widths = np.round(1000 + 1000 * VALUES).astype(np.uint16)
    rows = [(3, np.concatenate([row, [0, 0]]).astype(np.uint16)) for row in widths]
    topic = own("uint8 rssi\nuint16[] channels\n", rows)
    with rejected("choose its fields", "rssi, channels"):
        read(tmp_path, topic)
    chosen = CommandMapping(
        values=tuple(f"channels[{k}]" for k in range(4)), propellers=NAMES, scale=0.001, offset=-1
    )
    command = read(tmp_path, topic, command=chosen)["command"]
    assert command.columns == NAMES
    np.testing.assert_allclose(command.values, (widths - 1000.0) / 1000, atol=1e-12)


def test_joint_states_may_change_their_order(tmp_path: Path):
    rng = np.random.default_rng(8)
    orders = [rng.permutation(4) for _ in range(N)]
    topic = joints(
        [[NAMES[k] for k in order] for order in orders],
        effort=np.array([row[order] for row, order in zip(VALUES, orders, strict=True)]),
    )
    command = read(tmp_path, topic)["command"]
    assert sorted(command.columns) == sorted(NAMES)
    order = [command.columns.index(name) for name in NAMES]
    assert np.array_equal(command.values[:, order], VALUES)
    assert command.stamp_ns[3] == START_NS + 3 * 10**7 - 7


def test_joint_states_with_several_filled_fields_need_a_choice(tmp_path: Path):
    topic = joints([NAMES] * N, velocity=VALUES, effort=1 - VALUES)
    with pytest.raises(InputError, match=r'numbers in velocity, effort; .*values = \["velocity"\]'):
        read(tmp_path, topic)
    command = read(tmp_path, topic, command=CommandMapping(values=("effort",)))["command"]
    assert command.columns == NAMES
    assert np.array_equal(command.values, 1 - VALUES)


def test_joint_states_without_names_or_stamps_are_read(tmp_path: Path):
    topic = joints([()] * N, position=VALUES, late=START_NS)
    # Their clock then shows 0 s, 0.01 s, ...: only a header that is never filled in is no time.
    assert read(tmp_path, topic).warnings == ()

    def message(types):
        return types[JOINTS](ros_header(types, 0), [], *(VALUES[0], np.zeros(0), np.zeros(0)))

    recording = read(tmp_path, ros_topic(JOINTS, [message] * N))
    assert recording["command"].columns == UNNAMED
    assert recording["command"].stamp_ns[1] == START_NS + 10**7
    assert "have no time" in recording.warnings[0]


@pytest.mark.parametrize(
    ("names", "columns", "says"),
    [
        (
            [NAMES] * 5 + [NAMES[:3]] * 25,
            VALUES,
            "message 6 has 3 entries in name, the first has 4",
        ),
        ([NAMES] * 5 + [("x", *NAMES[1:])] * 25, VALUES, "message 6 names other joints"),
        ([("x",) * 4] * N, VALUES, "names other joints"),
        ([NAMES] * N, np.zeros((N, 0)), "messages without a number"),
    ],
)
def test_invalid_joint_states_are_rejected(tmp_path: Path, names, columns, says: str):
    with pytest.raises(InputError, match=says):
        read(tmp_path, joints(names, effort=columns))


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"values": ("data[4]",)}, r"has 4 entries, so there is no data\[4\]"),
        ({"values": ("layout.data_offset[0]",)}, "has no entries, so there is no"),
        ({"values": ("speeds",)}, r"has no number speeds \(it has layout.data_offset, data\)"),
        ({"values": ("layout.dim",)}, "has no number layout.dim"),
        ({"propellers": NAMES[:3]}, "command.propellers: names 3 propellers for 4 values"),
        ({"time": "stamp"}, "without the number stamp"),
        ({"file": "motors.csv"}, r"command\.file: is a bag, which has no such file"),
    ],
)
def test_invalid_mappings_are_rejected(tmp_path: Path, keys, says: str):
    with pytest.raises(InputError, match=says):
        read(tmp_path, array("Float64"), command=CommandMapping(**keys))


def test_nan_commands_are_read_and_rejected_later(tmp_path: Path):
    values = np.tile(VALUES[:, :1], 6)
    values[4, 2] = np.nan
    recording = read(tmp_path, array("Float64", values))
    assert np.isnan(recording["command"].values[4, 2])
    with pytest.raises(InputError, match="1 of 30 commands are not finite"):
        clean_streams(recording, default_vehicle())


def test_poses_without_a_header_in_mm_and_y_up_are_read(tmp_path: Path):
    rng = np.random.default_rng(9)
    poses = rng.uniform(-1, 1, (N, 3))

    def make(row):
        x, y, yaw = row

        def message(types):
            point = types["geometry_msgs/msg/Point"](1000 * x, 30.0, -1000 * y)
            turn = types["geometry_msgs/msg/Quaternion"](0.0, np.sin(yaw / 2), 0.0, np.cos(yaw / 2))
            return types["geometry_msgs/msg/Pose"](point, turn)

        return message

    pose = ros_topic("geometry_msgs/msg/Pose", map(make, poses))
    keys = {"pose": PoseMapping(axes="Y-up", units=("mm",))}
    recording = read(tmp_path, array("Float64"), pose, **keys)
    np.testing.assert_allclose(recording["pose"].values, poses, atol=1e-12)
    assert recording["pose"].stamp_ns[4] == START_NS + 4 * 10**7
    assert len(recording.warnings) == 2


def test_a_custom_pose_message_is_read(tmp_path: Path):
    rows = [(1_000_000 + 10_000 * k, 10.0 * k, -5.0 * k, 2.0 * k) for k in range(N)]
    pose = own("uint64 micros\nfloat64 east\nfloat64 north\nfloat64 heading\n", rows)
    keys = PoseMapping(
        position=("east", "north"), orientation="heading", time="micros", units=("cm", "deg", "us")
    )
    found = read(tmp_path, array("Float64"), pose, pose=keys)["pose"]
    np.testing.assert_allclose(found.values[:, 0], 0.1 * np.arange(N), atol=1e-15)
    np.testing.assert_allclose(found.values[:, 2], np.radians(2.0 * np.arange(N)), atol=1e-15)
    assert found.stamp_ns[3] == 10**9 + 3 * 10**7
    with pytest.raises(InputError, match="name the fields of both"):
        read(tmp_path, array("Float64"), pose, pose=PoseMapping(position=("east", "north")))
    wrong = PoseMapping(position=("x", "y"), orientation="heading")
    with pytest.raises(InputError, match=r"without the number x, y \(it has header.stamp.sec"):
        read(tmp_path, array("Float64"), pose, pose=wrong)


def test_the_mapping_suggested_by_an_error_works(tmp_path: Path):
    foreign = foreign_topics()
    topics = {"/vicon": foreign.pop("/optitrack/drone/pose"), "/motors": array("Float32")}
    topics["/rosout"] = foreign["/rosout"]
    path = write_mcap(tmp_path / "a.mcap", topics)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    message = str(caught.value)
    assert "\n" not in message
    assert "/optitrack/drone/pose, /drone/control: there is no such topic" in message
    shown = message.partition("--mapping: ")[2]
    assert tomllib.loads(shown) == {"topics": {"pose": "/vicon", "command": "/motors"}}
    (tmp_path / "mapping.toml").write_text(shown)
    recording = read_recording(path, mapping=read_mapping(tmp_path / "mapping.toml"))
    assert recording["command"].columns == UNNAMED


def test_arrival_times_may_be_shifted(tmp_path: Path):
    command = read(tmp_path, array("Float64"), command=CommandMapping(start_s=-0.5))["command"]
    assert command.stamp_ns[1] == START_NS + 10**7 - 5 * 10**8
    assert command.received_ns[1] == START_NS + 10**7


def shortened(length: int):
    return lambda data: data[:length]


@pytest.mark.parametrize(
    "damage",
    [
        *map(shortened, [0, 3, 4, 9, 15, 20, 40]),
        # An array of another length, and one that claims the whole memory.
        lambda data: data[:-8].replace(b"\x04\0\0\0", b"\x03\0\0\0"),
        lambda data: data.replace(b"\x04\0\0\0", b"\xff\xff\xff\x7f"),
    ],
)
def test_a_damaged_message_is_named(tmp_path: Path, damage):
    msgtype, text, messages = array("Float64")
    messages[5] = (messages[5][0], damage(messages[5][1]))
    with pytest.raises(InputError, match=r"/motors: message 6 (cannot be decoded|has)"):
        read(tmp_path, (msgtype, text, messages))
    with pytest.raises(InputError, match="/motors: contains no message"):
        read(tmp_path, (msgtype, text, []))
