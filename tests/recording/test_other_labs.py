"""Messages of other labs' craft: PX4's and the Stanford free-flyer's."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airpuck import InputError, preprocess, read_mapping, read_recording, read_vehicle

from ..apparatus.bags import START_NS, ros_header, ros_topic, write_mcap

RNG = np.random.default_rng(5)
POSES = RNG.uniform(-2, 2, (200, 3))
DUTIES = RNG.uniform(0, 1, (80, 8))
EXAMPLES = Path(__file__).parents[2] / "examples"
#: Our axes (forward, left, up) expressed in PX4's axes (forward, right, down).
DOWN = np.diag([1.0, -1.0, -1.0])

MOTORS = """uint64 timestamp
uint64 timestamp_sample
uint16 reversible_flags
float32[12] control
"""
ODOMETRY = """uint64 timestamp
uint64 timestamp_sample
uint8 pose_frame
float32[3] position
float32[4] q
"""
LOCAL = """uint64 timestamp
uint64 timestamp_sample
bool xy_valid
float32 x
float32 y
float32 z
float32 heading
"""


def motors(types, k):
    """Eight of twelve motors, all stopped at first."""
    row = np.full(12, np.nan)
    row[:8] = DUTIES[k] if k >= 5 else np.nan
    time = 10_000 * k
    return types["px4_msgs/msg/ActuatorMotors"](time + 900, time, 0, row.astype(np.float32))


def odometry(types, k):
    """A pose in NED, by rotation matrices."""
    x, y, yaw = POSES[k]
    place = DOWN @ (x, y, 0.0)
    turned = DOWN @ Rotation.from_euler("z", yaw).as_matrix() @ DOWN
    q = Rotation.from_matrix(turned).as_quat()[[3, 0, 1, 2]]
    single = np.float32
    return types["px4_msgs/msg/VehicleOdometry"](
        10_000 * k + 900, 10_000 * k, 1, place.astype(single), q.astype(single)
    )


def local(types, k):
    x, y, yaw = POSES[k]
    return types["px4_msgs/msg/VehicleLocalPosition"](
        10_000 * k + 900, 10_000 * k, True, x, -y, 0.3, -np.angle(np.exp(1j * yaw))
    )


def topic(name, text, make, count):
    return ros_topic(name, [lambda types, k=k: make(types, k) for k in range(count)], text)


@pytest.mark.parametrize(
    ("pose", "make"),
    [
        (("px4_msgs/msg/VehicleOdometry", ODOMETRY), odometry),
        (("px4_msgs/msg/VehicleLocalPosition", LOCAL), local),
    ],
)
def test_px4_recordings_need_only_topic_names(tmp_path, pose, make):
    topics = {
        "/fmu/in/vehicle_mocap_odometry": topic(*pose, make, 200),
        "/fmu/out/actuator_motors": topic("px4_msgs/msg/ActuatorMotors", MOTORS, motors, 80),
    }
    (tmp_path / "m.toml").write_text(
        '[topics]\npose = "/fmu/in/vehicle_mocap_odometry"\ncommand = "/fmu/out/actuator_motors"\n'
    )
    path = write_mcap(tmp_path / "a.mcap", topics)
    recording = read_recording(path, mapping=read_mapping(tmp_path / "m.toml"))
    found, command = recording["pose"], recording["command"]
    np.testing.assert_allclose(found.values[:, :2], POSES[:, :2], atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * found.values[:, 2]), np.exp(1j * POSES[:, 2]), atol=1e-6)
    assert found.stamp_ns[3] == 30_000_000
    assert command.values.shape == (80, 8)
    assert (command.values[:5] == 0).all()
    np.testing.assert_allclose(command.values[5:], DUTIES[5:], atol=1e-6)
    assert command.stamp_ns[3] == 30_900_000


def test_a_missing_entry_is_named(tmp_path):
    topics = {
        "/p": topic("px4_msgs/msg/VehicleOdometry", ODOMETRY, odometry, 20),
        "/c": topic("px4_msgs/msg/ActuatorMotors", MOTORS, motors, 20),
    }
    path = write_mcap(tmp_path / "a.mcap", topics)
    for position, says in (
        (["position[0]", "position[3]"], "no position\\[3\\]"),
        (["position", "q[0]"], "without the number position"),
    ):
        (tmp_path / "m.toml").write_text(
            f'topics = {{pose = "/p", command = "/c"}}\npose.position = {position}\n'.replace(
                "'", '"'
            )
        )
        with pytest.raises(InputError, match=says):
            read_recording(path, mapping=read_mapping(tmp_path / "m.toml"))


def stamped(kind: str, field: str, value, count: int, start: int = 0, step: int = 10**7):
    """A topic of ff_msgs with a header and one or several values."""

    def make(types, k):
        return types[f"ff_msgs/msg/{kind}"](
            ros_header(types, START_NS + start + k * step), *value(k)
        )

    return topic(f"ff_msgs/msg/{kind}", f"std_msgs/Header header\n{field}\n", make, count)


FREE_FLYER = {
    "/optitrack/drone/pose": stamped(
        "Pose2DStamped", "float32 x\nfloat32 y\nfloat32 theta", lambda k: POSES[k], 200
    ),
    "/drone/control": stamped(
        "ThrusterPWMCommand", "float64[8] duty_cycles", lambda k: [DUTIES[k]], 80
    ),
}


def test_switches_duties_and_poses_of_the_free_flyer_are_read(tmp_path):
    switches = DUTIES > 0.5
    switched = stamped("ThrusterCommand", "bool[8] switches", lambda k: [switches[k]], 80)
    for control, expected in ((FREE_FLYER["/drone/control"], DUTIES), (switched, switches)):
        path = write_mcap(tmp_path / "a.mcap", FREE_FLYER | {"/drone/control": control})
        recording = read_recording(path)
        np.testing.assert_allclose(recording["pose"].values, POSES, atol=1e-6)
        np.testing.assert_array_equal(recording["command"].values, expected)


def free_flyer(folder, wheel_field="float64 velocity", velocity=lambda k: 30.0 * k, wheels=40):
    """A bag of poses, duty cycles, and the reaction wheel's speeds on a topic of its own."""
    wheel = stamped(
        "WheelVelCommand", wheel_field, lambda k: [velocity(k)], wheels, 10**8, 2 * 10**7
    )
    (folder / "m.toml").write_text('topics = {wheels = "/ctrl/wheel"}\n[wheels]\nscale = 1e-3\n')
    path = write_mcap(folder / "a.mcap", FREE_FLYER | {"/ctrl/wheel": wheel})
    return path, read_mapping(folder / "m.toml")


def test_the_free_flyers_wheel_has_its_own_topic(tmp_path):
    path, mapping = free_flyer(tmp_path)
    recording = read_recording(path, mapping=mapping)
    command = recording["command"]
    assert "wheels" not in recording.streams
    assert command.columns == tuple(f"value_{k}" for k in range(1, 10))
    # Wheel and thrusters were stamped at common times: every tenth of a second from 0.1 s on.
    np.testing.assert_array_equal(command.values[:80, :8], DUTIES)
    expected = np.maximum(np.arange(80) - 10, 0) // 2 * 0.03
    np.testing.assert_allclose(command.values[:80, 8], expected)
    assert len(command) == 80 + 5  # the wheel's last commands come later


WHEEL = """
[[wheels]]
name = "wheel"
torque_Nm = 0.1
inertia_kg_m2 = 0.01
max_speed_rad_s = 1000.0
commanded = "speed"
"""


@pytest.mark.parametrize(
    "damage",
    [
        {"wheel_field": "string velocity", "velocity": str},
        {"wheel_field": "float64[3] velocity", "velocity": lambda k: np.zeros(3)},
        {"velocity": lambda k: math.nan},
        {"velocity": lambda k: 1e308},
        {"wheels": 0},
    ],
)
def test_a_damaged_wheel_topic_ends_in_one_line(tmp_path, damage):
    plain = (EXAMPLES / "free_flyers" / "freeflyer2.toml").read_text()
    (tmp_path / "craft.toml").write_text(plain.replace("[nominal]", f"{WHEEL}\n[nominal]"))
    vehicle = read_vehicle(tmp_path / "craft.toml")
    path, mapping = free_flyer(tmp_path, **damage)
    with pytest.raises(InputError):
        preprocess(read_recording(path, mapping=mapping), vehicle)
