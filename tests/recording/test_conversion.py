import json
import re
from itertools import permutations, product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airpuck import CommandMapping, InputError, PoseMapping
from airpuck.recording.conversion import commands_of, poses_of, stamps_of

#: All renamings of axes with their matrices.
RENAMINGS = {}
for order in permutations(range(3)):
    for signs in product((1, -1), repeat=3):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        names = [
            "xyz"[k] if sign > 0 else f"-{'xyz'[k]}" for k, sign in zip(order, signs, strict=True)
        ]
        RENAMINGS[tuple(names)] = matrix


def random_rotations(n: int = 50) -> Rotation:
    return Rotation.random(n, random_state=3)


@pytest.mark.parametrize("axes", RENAMINGS)
def test_renamed_axes_rotate_positions_and_orientations_alike(axes: tuple[str, ...]):
    renaming, rotations = RENAMINGS[axes], random_rotations()
    positions = np.random.default_rng(1).normal(size=(50, 3))
    # The axis of each rotation is renamed; the sense about it stays the same, even in a mirror.
    turned = Rotation.from_rotvec(rotations.as_rotvec() @ renaming.T).as_matrix()
    yaw = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    for kind, numbers in (
        ("quaternion", rotations.as_quat()),
        ("quaternion", 3.7 * rotations.as_quat()),
        ("quaternion", 0.4 * rotations.as_quat()),
        ("matrix", rotations.as_matrix().reshape(-1, 9)),
        ("XYZ", rotations.as_euler("XYZ")),
        ("zyx", rotations.as_euler("zyx")),
    ):
        found = poses_of(positions, numbers, kind, PoseMapping(axes=axes))
        np.testing.assert_array_equal(found[:, :2], (positions @ renaming.T)[:, :2])
        apart = np.angle(np.exp(1j * (found[:, 2] - yaw)))
        assert np.abs(apart).max() < 1e-9, kind


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_another_vertical_axis_is_recognised_by_the_positions(up: str):
    """A flight over the table, turned as a program with that vertical axis logs it."""
    t = np.linspace(0, 20, 500)
    rng = np.random.default_rng(4)
    flight = np.column_stack([np.sin(t), 0.4 * np.cos(2 * t), 0.02 + 1e-3 * rng.normal(size=500)])
    yaw = 3 * np.sin(t)
    # Our x, y, z are logged in this order and with these signs.
    logged = {"z": flight, "y": flight[:, [0, 2, 1]] * [1, 1, -1], "x": flight[:, [2, 0, 1]]}[up]
    about = {"z": [0, 0, 1], "y": [0, 1, 0], "x": [1, 0, 0]}[up]
    numbers = Rotation.from_rotvec(yaw[:, None] * about).as_quat()
    if up == "z":
        poses_of(logged, numbers, "quaternion", PoseMapping())
        return
    with pytest.raises(InputError, match=f"{up.upper()} is up") as caught:
        poses_of(logged, numbers, "quaternion", PoseMapping())
    axes = re.search(r"axes = (\[.*?\])", str(caught.value))
    assert axes is not None
    mended = poses_of(logged, numbers, "quaternion", PoseMapping(axes=tuple(json.loads(axes[1]))))
    np.testing.assert_allclose(mended[:, :2], flight[:, :2], atol=1e-12)
    assert np.abs(np.angle(np.exp(1j * (mended[:, 2] - yaw)))).max() < 1e-9


@pytest.mark.parametrize("level", [0, 1])
def test_a_column_of_heights_among_two_coordinates_is_recognised(level: int):
    """The mapping named two of a program's three columns, and one of them is the height."""
    t = np.linspace(0, 20, 500)
    logged = np.column_stack([np.sin(t), 0.02 + 1e-4 * np.random.default_rng(4).normal(size=500)])
    logged = logged[:, [1, 0]] if level == 0 else logged
    names = f"its {['first', 'second'][level]} coordinate stays within 0.. mm, like a height"
    with pytest.raises(InputError, match=names) as caught:
        poses_of(logged, t[:, None], "yaw", PoseMapping())
    axes = tuple(json.loads(re.search(r"axes = (\[.*?\])", str(caught.value))[1]))
    whole = np.insert(logged, 2, np.cos(t), axis=1)
    moving = poses_of(whole, t[:, None], "yaw", PoseMapping(axes=axes))[:, :2]
    assert np.ptp(moving, axis=0).min() > 1


@pytest.mark.filterwarnings("error")
def test_motion_along_a_line_or_a_single_pose_reveals_no_vertical_axis():
    t = np.linspace(0, 20, 500)
    noise = 1e-4 * np.random.default_rng(4).normal(size=500)
    # A puck has no yaw, and a controller that moves the craft along x holds y to millimetres.
    for kind, y in (("yaw", 0 * t + 0.1), ("none", 0.1 + noise), ("yaw", 2e-3 * np.sin(3 * t))):
        logged = np.column_stack([np.sin(t), y])
        turned = t[:, None] if kind == "yaw" else np.zeros((500, 0))
        for part in (slice(None), slice(1)):
            found = poses_of(logged[part], turned[part], kind, PoseMapping())
            np.testing.assert_array_equal(found[:, :2], logged[part])


@pytest.mark.parametrize("order", ["".join(order) for order in permutations("XYZ")])
def test_euler_angles_in_every_order_are_converted_from_degrees(order: str):
    rotations = random_rotations()
    expected = poses_of(np.zeros((50, 2)), rotations.as_quat(), "quaternion", PoseMapping())
    for kind in (order, order.lower()):
        angles = rotations.as_euler(kind, degrees=True)
        found = poses_of(np.zeros((50, 2)), angles, kind, PoseMapping(units=("deg",)))
        assert np.abs(np.angle(np.exp(1j * (found - expected)[:, 2]))).max() < 1e-9


@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
def test_wrong_signs_of_x_y_and_yaw_are_corrected_one_by_one(signs: tuple[int, ...]):
    rng = np.random.default_rng(2)
    poses = rng.uniform(-1, 1, (20, 3))
    logged = poses * signs
    axes = tuple(axis if sign > 0 else f"-{axis}" for axis, sign in zip("xyz", signs, strict=True))
    found = poses_of(logged[:, :2], logged[:, 2:], "yaw", PoseMapping(axes=axes))
    np.testing.assert_array_equal(found, poses)
    level = Rotation.from_euler("z", logged[:, 2:])
    for kind, numbers in (("quaternion", level.as_quat()), ("matrix", level.as_matrix())):
        numbers = numbers.reshape(20, -1)
        found = poses_of(logged[:, :2], numbers, kind, PoseMapping(axes=axes))
        np.testing.assert_allclose(found, poses, atol=1e-12)


def test_y_up_matches_a_hand_calculation():
    # Motive's axes: y up, and seen from above z points down when x points right. A craft at
    # x = 1 m, 2 m away from us (-z), that turned left by 30 degrees.
    left = Rotation.from_euler("y", [[30]], degrees=True)
    found = poses_of(
        np.array([[1000.0, 100.0, -2000.0]]),
        left.as_quat(),
        "quaternion",
        PoseMapping(axes="Y-up", units=("mm",)),
    )
    np.testing.assert_allclose(found, [[1, 2, np.pi / 6]], atol=1e-15)


def test_the_yaw_is_about_the_vertical_axis_of_the_file():
    yaw, positions = np.array([[90.0]]), np.array([[1.0, 2.0, 3.0]])
    degrees = ("deg",)
    for axes, x, y, angle in (
        ("Z-up", 1, 2, 90),
        ("Y-up", 1, -3, 90),
        (("y", "-x", "z"), 2, -1, 90),
        (("x", "-y", "-z"), 1, -2, -90),
    ):
        found = poses_of(positions, yaw, "yaw", PoseMapping(axes=axes, units=degrees))
        np.testing.assert_allclose(found, [[x, y, np.radians(angle)]])


def test_two_coordinates_cannot_be_rotated_to_y_up():
    with pytest.raises(InputError, match="axes needs the third"):
        poses_of(np.zeros((1, 2)), np.zeros((1, 1)), "yaw", PoseMapping(axes="Y-up"))


def test_nine_numbers_that_are_not_a_rotation_are_rejected():
    rotations = random_rotations(3).as_matrix()
    for wrong in (2 * rotations, -rotations, rotations[:, ::-1]):
        with pytest.raises(InputError, match="not a rotation matrix"):
            poses_of(np.zeros((3, 2)), wrong.reshape(3, 9), "matrix", PoseMapping())


def test_a_non_finite_rotation_stays_non_finite():
    matrices = random_rotations(3).as_matrix().reshape(3, 9)
    matrices[1, 4] = np.nan
    euler = random_rotations(3).as_euler("XYZ")
    euler[1, 0] = np.inf
    with np.errstate(invalid="ignore"):
        for kind, numbers in (("matrix", matrices), ("XYZ", euler)):
            yaw = poses_of(np.zeros((3, 2)), numbers, kind, PoseMapping())[:, 2]
            assert np.isfinite(yaw[[0, 2]]).all()


def test_integer_times_and_dates_are_exact():
    late = 1_709_651_570_788_520_097
    assert stamps_of(np.array([late]), PoseMapping(units=("ns",))).tolist() == [late]
    assert stamps_of(np.array([late // 1000]), PoseMapping(units=("us",))).tolist() == [
        late // 1000 * 1000
    ]
    dates = np.array([late], dtype="datetime64[ns]")
    assert stamps_of(dates, PoseMapping(start_s=-0.5)).tolist() == [late - 5 * 10**8]
    assert stamps_of(dates.astype("datetime64[us]"), PoseMapping()).tolist() == [
        late // 1000 * 1000
    ]


def test_times_in_every_unit_are_converted():
    for unit, time in (("s", 1.25), ("ms", 1250.0), ("us", 1.25e6), ("ns", 1.25e9)):
        found = stamps_of(np.array([time]), PoseMapping(units=(unit,), start_s=2.0))
        assert found.tolist() == [3_250_000_000]


@pytest.mark.parametrize(
    ("time", "says"),
    [
        (np.array([0.0, np.nan]), "row 2 has no time"),
        (np.array([np.inf, 0.0]), "row 1 has no time"),
        (np.array(["2024-01-01", "NaT"], dtype="datetime64[s]"), "row 2 has no time"),
        (np.array([1.7e18]), "name its unit"),
        (np.array([-1e12, 0.0]), r"reaches 1e\+12 s, which no clock shows"),
        (np.array([2**62]), "name its unit"),
    ],
)
def test_invalid_times_are_rejected(time: np.ndarray, says: str):
    with pytest.raises(InputError, match=says):
        stamps_of(time, PoseMapping())


def test_percentages_and_pulse_widths_map_exactly_to_0_and_1():
    percent = commands_of(np.array([[0.0, 30.0, 100.0]]), CommandMapping(scale=0.01))
    np.testing.assert_allclose(percent, [[0, 0.3, 1]], rtol=1e-15)
    for low, high in ((1000.0, 2000.0), (1100.0, 1900.0), (1094.0, 1941.0)):
        scale = 1 / (high - low)
        found = commands_of(
            np.array([[low, (low + high) / 2, high]]),
            CommandMapping(scale=scale, offset=-low * scale),
        )
        assert found[0, 0] == 0
        assert found[0, 2] == 1
        assert found[0, 1] == pytest.approx(0.5, abs=1e-12)
    reversed_ = commands_of(np.array([[0.0, 1.0]]), CommandMapping(scale=-1, offset=1))
    assert reversed_.tolist() == [[1.0, 0.0]]


def quaternions(yaw: np.ndarray) -> np.ndarray:
    """Quaternions x, y, z, w of a craft that rolls and pitches by a few degrees."""
    tilt = 0.05 * np.sin(3 * yaw)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, tilt, -tilt])).as_quat()


YAW = np.linspace(-1, 4, 200)
NAMES = ("qx", "qy", "qz", "qw")


@pytest.mark.parametrize(
    ("columns", "line"),
    [
        ((3, 0, 1, 2), 'order w, x, y, z.*{x = "qy", y = "qz", z = "qw", w = "qx"}'),
        ((1, 2, 3, 0), 'order x, y, z, w.*{x = "qw", y = "qx", z = "qy", w = "qz"}'),
    ],
)
def test_a_reordered_quaternion_is_recognised(columns, line: str):
    position = np.zeros((len(YAW), 2))
    logged = quaternions(YAW)[:, columns]
    with pytest.raises(InputError, match=f"would roll by up to .*{line}"):
        poses_of(position, logged, "quaternion", PoseMapping(), NAMES)
    # The line that the message shows is right.
    given = re.search(r"x = .*w = \"q.\"", line.replace("{", "").replace("}", ""))
    assert given is not None
    chosen = [NAMES.index(name) for name in re.findall(r"q[xyzw]", given[0])]
    yaw = poses_of(position, logged[:, chosen], "quaternion", PoseMapping())[:, 2]
    assert np.unwrap(yaw) == pytest.approx(YAW, abs=0.01)
    with pytest.raises(InputError, match="reorder its columns"):
        poses_of(position, logged, "quaternion", PoseMapping())


@pytest.mark.parametrize("mounted", ["identity", "upside down", "on its side"])
def test_a_rotated_mounting_is_not_taken_for_another_quaternion_order(mounted: str):
    angle = {"identity": 0, "upside down": np.pi, "on its side": np.pi / 2}[mounted]
    turned = Rotation.from_quat(quaternions(YAW)) * Rotation.from_euler("x", angle)
    poses_of(np.zeros((len(YAW), 2)), turned.as_quat(), "quaternion", PoseMapping(), NAMES)


def test_a_rotation_vector_is_axis_times_angle():
    turned = Rotation.from_quat(quaternions(YAW))
    found = poses_of(np.zeros((len(YAW), 2)), turned.as_rotvec(), "vector", PoseMapping())
    assert np.unwrap(found[:, 2]) == pytest.approx(YAW, abs=0.01)


PULSES = np.array([[900.0, 900.0], [1000.0, 1500.0], [1000.0, 2000.0]])


def test_a_disarmed_pulse_is_named_and_means_stopped():
    servo = {"neutral": 1000.0, "span": 1000.0}
    with pytest.raises(InputError, match=r"pulses of 900 .* 1 of 3 .*{disarmed = 900}"):
        commands_of(PULSES, CommandMapping(**servo))
    found = commands_of(PULSES, CommandMapping(**servo, disarmed=900))
    assert found.tolist() == [[0, 0], [0, 0.5], [0, 1]]


def test_several_disarmed_pulses_are_named():
    pulses = np.vstack([PULSES, [[850.0, 800.0]]])
    with pytest.raises(InputError, match=r"pulses of 800, 850, 900 .* 2 of 4 .* neutral one"):
        commands_of(pulses, CommandMapping(neutral=1000.0, span=1000.0))


def test_pulses_of_reversible_motors_are_not_called_disarmed():
    for pulses in ([[1400, 1400], [1300, 1600]], [[1000, 1000], [2000, 1500]], [[1400, 1500]]):
        found = commands_of(np.array(pulses, float), CommandMapping(neutral=1500, span=500))
        assert found.min() < 0
