"""Recordings, and bags that were not written by airpuck."""

import struct
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from airpuck.recording.stream import COLUMNS, Recording, Stream

SIX = ("motor_a_1", "motor_a_2", "motor_b_1", "motor_b_2", "motor_c_1", "motor_c_2")
START_NS = 1_709_651_570_000_000_123
#: Data that `ros1_bag` writes.
ROS1_POSES = np.random.default_rng(3).uniform(-1, 1, (300, 3))
ROS1_COMMANDS = np.random.default_rng(4).uniform(0, 1, (120, 6))

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
POSE_TEXT = (
    "std_msgs/Header header\ngeometry_msgs/Pose pose"
    + HEADER
    + """================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
)
COMMAND_TYPE = "holohover_msgs/msg/HolohoverControlStamped"
COMMAND_TEXT = "std_msgs/Header header\n" + "".join(f"float64 {name}\n" for name in SIX) + HEADER


def stamped(stamp_ns: int, frame: str, numbers: Iterable[float]) -> bytes:
    """A header and float64 fields in CDR, by hand."""
    text = frame.encode() + b"\0"
    body = struct.pack("<iII", *divmod(stamp_ns, 10**9), len(text)) + text
    body += b"\0" * (-len(body) % 8)
    numbers = list(numbers)
    return b"\x00\x01\x00\x00" + body + struct.pack(f"<{len(numbers)}d", *numbers)


def pose_message(stamp_ns: int, x: float, y: float, yaw: float, frame: str = "") -> bytes:
    return stamped(stamp_ns, frame, (x, y, 0, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))


def stream(
    n: int, rate: float, columns: tuple[str, ...], seed: int, latency: int = 3_000_000
) -> Stream:
    """Return random numbers, which use all digits of a float."""
    rng = np.random.default_rng(seed)
    stamp = START_NS + (np.arange(n) * (1e9 / rate)).astype(np.int64)
    return Stream(
        stamp_ns=stamp,
        received_ns=stamp + latency + rng.integers(0, 500_000, n),
        values=rng.uniform(0, 1, (n, len(columns))),
        columns=columns,
    )


def flight() -> Recording:
    """Ten seconds with every stream; numbers have all their digits."""
    streams = {
        "pose": stream(2400, 240, COLUMNS["pose"], 1),
        "command": stream(1000, 100, SIX, 2),
        "reference": stream(4, 0.5, COLUMNS["reference"], 3, latency=0),
        "estimate": stream(2000, 200, COLUMNS["estimate"], 4),
        "imu": stream(1000, 100, COLUMNS["imu"], 5),
        "mouse": stream(1000, 100, COLUMNS["mouse"], 6),
        "puck": stream(2400, 240, COLUMNS["puck"], 7),
        "mallet": stream(2400, 240, COLUMNS["mallet"], 8),
        "mallet_target": stream(1000, 100, COLUMNS["mallet_target"], 11),
        "opponent_command": stream(1000, 100, SIX, 9),
        "game": stream(20, 2, COLUMNS["game"], 10),
    }
    reference = streams["reference"]
    streams["reference"] = Stream(
        reference.stamp_ns, reference.stamp_ns, reference.values, reference.columns
    )
    return Recording(streams, "made up")


Types = Mapping[str, Any]
Topic = tuple[str, str, list[tuple[int, bytes]]]


def write_mcap(path: Path, topics: dict[str, Topic], **options: Any) -> Path:
    """Write topic -> (type, definition, [(time, message)]); options as of `write_channels`."""
    return write_channels(path, *((name, *topic) for name, topic in topics.items()), **options)


def write_channels(
    path: Path,
    *channels: tuple[str, str, str, list[tuple[int, bytes]]],
    encoding: str = "cdr",
    schemas: str = "ros2msg",
    in_order: bool = True,
    **options: Any,
) -> Path:
    """Write a channel for each topic, type, definition and messages; topics may repeat."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("", "not airpuck")
        events = []
        for name, msgtype, text, messages in channels:
            schema = writer.register_schema(msgtype, schemas, text.encode())
            channel = writer.register_channel(name, encoding, schema)
            events += [(time, channel, message) for time, message in messages]
        if in_order:
            events.sort(key=lambda event: event[0])
        for time, channel, message in events:
            writer.add_message(channel, time, message, time)
        writer.finish()
    return path


def ros_topic(msgtype: str, messages: Iterable[Callable[[Types], object]], text: str = "") -> Topic:
    """A topic as ROS writes it, by rosbags' serialiser; messages a hundredth of a second apart."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    if text:
        store.register(get_types_from_msg(text, msgtype))
    made = [bytes(store.serialize_cdr(make(store.types), msgtype)) for make in messages]
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return msgtype, text, [(START_NS + i * 10**7, data) for i, data in enumerate(made)]


def ros_header(types: Types, stamp_ns: int) -> object:
    """The header of a message."""
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return types["std_msgs/msg/Header"](stamp, "")


def foreign_topics() -> dict[str, Topic]:
    """Four seconds of poses and commands as another recorder would store them."""
    rng = np.random.default_rng(7)
    poses, commands = rng.uniform(-1, 1, (960, 3)), rng.uniform(0, 1, (400, 6))
    return {
        "/optitrack/drone/pose": (
            POSE_TYPE,
            POSE_TEXT,
            [
                (START_NS + i * 4_166_667 + 1_000_000, pose_message(START_NS + i * 4_166_667, *row))
                for i, row in enumerate(poses.tolist())
            ],
        ),
        "/drone/control": (
            COMMAND_TYPE,
            COMMAND_TEXT,
            [
                (START_NS + i * 10**7 + 500_000, stamped(START_NS + i * 10**7, "body", row))
                for i, row in enumerate(commands.tolist())
            ],
        ),
        "/rosout": (
            "std_msgs/msg/String",
            "string data",
            [(START_NS + i * 10**8, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00") for i in range(40)],
        ),
    }


def rosbags_folder(path: Path, *, plugin=StoragePlugin.SQLITE3, version=8, compress=None) -> None:
    """A folder by rosbags' own writer and serialiser."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(COMMAND_TEXT, COMMAND_TYPE))
    t = store.types
    writer = Writer(path, version=version, storage_plugin=plugin)
    if compress is not None:
        writer.set_compression(*compress)
    with writer:
        pose = writer.add_connection("/optitrack/drone/pose", POSE_TYPE, typestore=store)
        command = writer.add_connection("/drone/control", COMMAND_TYPE, typestore=store)
        for i in range(5):
            header = t["std_msgs/msg/Header"](t["builtin_interfaces/msg/Time"](100 + i, 5), "w")
            message = t[POSE_TYPE](
                header,
                t["geometry_msgs/msg/Pose"](
                    t["geometry_msgs/msg/Point"](0.5 * i, -0.25, 0.0),
                    t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(0.15), np.cos(0.15)),
                ),
            )
            writer.write(pose, 10**9 * (200 + i), store.serialize_cdr(message, POSE_TYPE))
            message = t[COMMAND_TYPE](header, *(0.1 * np.arange(6)))
            writer.write(command, 10**9 * (200 + i), store.serialize_cdr(message, COMMAND_TYPE))


def ros1_bag(
    path: Path,
    compression: Ros1Writer.CompressionFormat | None = None,
    *,
    n_poses: int = 300,
    n_commands: int = 120,
) -> Path:
    """A bag of ROS 1 by rosbags' own writer, in many chunks."""
    store = get_typestore(Stores.ROS1_NOETIC)
    text = "std_msgs/Header header\n" + "".join(f"float64 {name}\n" for name in SIX)
    store.register(get_types_from_msg(text, COMMAND_TYPE))
    t = store.types
    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = 2000

    def header(k: int, stamp_ns: int) -> object:
        stamp = t["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        return t["std_msgs/msg/Header"](k, stamp, "w")

    events = []
    for k, (x, y, yaw) in enumerate(ROS1_POSES[:n_poses]):
        stamp = START_NS + k * 4_166_667
        place = t["geometry_msgs/msg/Point"](x, y, 0.0)
        turn = t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        message = t[POSE_TYPE](header(k, stamp), t["geometry_msgs/msg/Pose"](place, turn))
        events.append((stamp + 10**6, "/optitrack/drone/pose", POSE_TYPE, message))
    for k, row in enumerate(ROS1_COMMANDS[:n_commands]):
        stamp = START_NS + k * 10**7
        message = t[COMMAND_TYPE](header(k, stamp), *row)
        events.append((stamp + 10**5, "/drone/control", COMMAND_TYPE, message))
    _log(writer, store, events)
    return path


def _log(writer, store, events) -> None:
    """Write events, (time, topic, type, message), in the order of their times."""
    with writer:
        topics = {}
        for time, topic, msgtype, message in sorted(events, key=lambda event: event[0]):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, msgtype, typestore=store)
            writer.write(topics[topic], time, store.serialize_ros1(message, msgtype))


_STAMPED = "std_msgs/Header header\n"
#: Messages of other labs' craft: topic, type, definition, rate [Hz], and the values of the fields.
_LABS = {
    "/pose": (
        "ff_msgs/msg/Pose2DStamped",
        "float32 x\nfloat32 y\nfloat32 theta\n",
        50,
        lambda rng: rng.uniform(-1, 1, 3).tolist(),
    ),
    "/switches": (
        "ff_msgs/msg/ThrusterCommand",
        "bool[8] switches\n",
        10,
        lambda rng: [rng.random(8) < 0.5],
    ),
    "/duties": (
        "ff_msgs/msg/ThrusterPWMCommand",
        "float64[8] duty_cycles\n",
        10,
        lambda rng: [rng.random(8)],
    ),
    "/wheel": (
        "ff_msgs/msg/WheelVelCommand",
        "float64 velocity\n",
        20,
        lambda rng: [float(rng.uniform(-500, 500))],
    ),
    "/motors": (
        "px4_msgs/msg/ActuatorMotors",
        "uint64 timestamp\nuint64 timestamp_sample\nuint16 reversible_flags\nfloat32[12] control\n",
        20,
        lambda rng: [np.r_[rng.random(8), np.full(4, np.nan)].astype(np.float32)],
    ),
}


def labs_bag(path: Path) -> Path:
    """Two seconds of ROS 1 with messages of the Stanford free-flyer and of PX4, in chunks."""
    store, rng = get_typestore(Stores.ROS1_NOETIC), np.random.default_rng(11)
    t, writer, events = store.types, Ros1Writer(path), []
    writer.chunk_threshold = 3000
    for topic, (name, fields, rate, values) in _LABS.items():
        px4 = name.startswith("px4")
        store.register(get_types_from_msg(fields if px4 else _STAMPED + fields, name))
        for k in range(2 * rate):
            stamp = START_NS + round(k * 1e9 / rate)
            stamped = t["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            begin = (stamp // 1000, stamp // 1000, 0)
            begin = begin if px4 else (t["std_msgs/msg/Header"](k, stamped, "w"),)
            events.append((stamp + 10**6, topic, name, t[name](*begin, *values(rng))))
    _log(writer, store, events)
    return path


def write_ulog(path: Path, topics: Mapping[str, tuple[str, Iterable[bytes]]]) -> Path:
    """A PX4 log by its specification: topic, or its instance name[1] -> (fields, messages)."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    parts += [
        message("F", f"{name.partition('[')[0]}:{fields}".encode())
        for name, (fields, _) in topics.items()
    ]
    for number, topic in enumerate(topics):
        name, _, instance = topic.partition("[")
        multi_id = int(instance.rstrip("]") or 0)
        parts.append(message("A", struct.pack("<BH", multi_id, number) + name.encode()))
    for number, (_, messages) in enumerate(topics.values()):
        parts += [message("D", struct.pack("<H", number) + one) for one in messages]
    path.write_bytes(b"".join(parts))
    return path


#: Data that `ulog` writes: poses in north, east, down, and commands of eight motors.
ULOG_POSES = np.random.default_rng(8).uniform(-2, 2, (200, 3))
ULOG_COMMANDS = np.random.default_rng(9).uniform(0, 1, (80, 8))


def ulog(path: Path) -> Path:
    """A log of motion capture and motors, as PX4 writes it."""
    poses, motors = [], []
    for k, (x, y, yaw) in enumerate(ULOG_POSES):
        turn = np.cos(yaw / 2), 0.0, 0.0, -np.sin(yaw / 2)
        poses.append(struct.pack("<QQ7fB", 10_000 * k + 900, 10_000 * k, x, -y, 0.3, *turn, 1))
    for k, row in enumerate(ULOG_COMMANDS):
        stopped = [float("nan")] * 4
        motors.append(struct.pack("<QQ12fH", 10_000 * k + 50, 10_000 * k, *row, *stopped, 0))
    times = "uint64_t timestamp;uint64_t timestamp_sample;"
    return write_ulog(
        path,
        {
            "vehicle_visual_odometry": (
                f"{times}float[3] position;float[4] q;uint8_t pose_frame;",
                poses,
            ),
            "actuator_motors": (f"{times}float[12] control;uint16_t reversible_flags;", motors),
        },
    )
