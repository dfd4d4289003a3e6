"""PX4 logs, written by their specification."""

import struct

import numpy as np
import pytest

from airpuck import InputError, read_mapping, read_recording

from ..apparatus.bags import ULOG_COMMANDS, ULOG_POSES, ulog, write_ulog


def test_motion_capture_and_motors_are_found(tmp_path):
    recording = read_recording(ulog(tmp_path / "a.ulg"))
    pose, command = recording["pose"], recording["command"]
    np.testing.assert_allclose(pose.values[:, :2], ULOG_POSES[:, :2], atol=1e-6)
    turned = np.exp(1j * (pose.values[:, 2] - ULOG_POSES[:, 2]))
    np.testing.assert_allclose(turned, 1.0, atol=1e-6)
    np.testing.assert_allclose(command.values, ULOG_COMMANDS, atol=1e-7)
    # Measured and received; motors have one time.
    assert (pose.stamp_ns[3], pose.received_ns[3]) == (30_000_000, 30_900_000)
    assert command.stamp_ns[3] == 30_050_000


def test_a_mapping_may_name_other_topics(tmp_path):
    heading = [struct.pack("<QQ4f", 10_000 * k, 10_000 * k, 0.1 * k, 0, 0, 0.5) for k in range(9)]
    fields = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float heading;"
    motors = [struct.pack("<Q2f", 10_000 * k, 0.25, 0.5) for k in range(9)]
    topics = {
        "vehicle_local_position": (fields, heading),
        "my_motors": ("uint64_t timestamp;float[2] duty;", motors),
    }
    (tmp_path / "m.toml").write_text(
        '[topics]\npose = "/fmu/out/vehicle_local_position"\ncommand = "/my_motors"\n'
        '[command]\ntime = "timestamp"\nunits = ["us"]\nvalues = ["duty[1]", "duty[0]"]\n'
    )
    path = write_ulog(tmp_path / "a.ulg", topics)
    recording = read_recording(path, mapping=read_mapping(tmp_path / "m.toml"))
    np.testing.assert_allclose(recording["pose"].values[8], (0.8, 0.0, -0.5), atol=1e-6)
    np.testing.assert_array_equal(recording["command"].values[0], (0.5, 0.25))
    with pytest.raises(InputError, match="actuator_motors: there is no such topic; choose from"):
        read_recording(path)
    for setting in ("file", "interval"):
        (tmp_path / "m.toml").write_text(f'[pose]\n{setting} = "x"\n')
        with pytest.raises(InputError, match=rf"pose\.{setting}: is a PX4 log"):
            read_recording(path, mapping=read_mapping(tmp_path / "m.toml"))


@pytest.mark.parametrize(
    "fields",
    [
        "uint64_t timestamp;float[999999999] x;",
        "uint64_t timestamp;" + "float[60] x;" * 60,
        "a[900] a;a[900] b;",
    ],
)
def test_formats_that_expand_too_far_are_rejected(tmp_path, fields):
    path = write_ulog(tmp_path / "a.ulg", {"a": (fields, [])})
    with pytest.raises(InputError, match="too many fields"):
        read_recording(path)


@pytest.mark.parametrize("length", [57, 60, 90])
def test_damaged_definitions_are_rejected(tmp_path, length):
    # pyulog never ends on these.
    path = ulog(tmp_path / "a.ulg")
    path.write_bytes(path.read_bytes()[:length] + bytes(40))
    with pytest.raises(InputError, match=r"not a readable PX4 log|no such topic"):
        read_recording(path)


def test_a_file_that_is_not_a_log_is_rejected(tmp_path):
    (tmp_path / "a.ulg").write_bytes(b"ULog" + bytes(100))
    with pytest.raises(InputError, match="is not a readable PX4 log"):
        read_recording(tmp_path / "a.ulg")


_OUTPUTS = "uint64_t timestamp;float[4] output;"


def outputs(*values: float) -> list[bytes]:
    return [struct.pack("<Q4f", 10_000 * k, *values) for k in range(9)]


def test_another_instance_of_a_topic_can_be_named(tmp_path):
    whole = ulog(tmp_path / "whole.ulg").read_bytes()
    assert whole
    poses = [
        struct.pack("<QQ7fB", 10_000 * k, 10_000 * k, 0.1 * k, 0, 0, 1, 0, 0, 0, 1)
        for k in range(9)
    ]
    fields = "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;uint8_t f;"
    path = write_ulog(
        tmp_path / "a.ulg",
        {
            "vehicle_visual_odometry": (fields, poses),
            "actuator_outputs[1]": (_OUTPUTS, outputs(1250, 1500, 900, 900)),
            "actuator_outputs": (_OUTPUTS, outputs(900, 900, 900, 900)),
        },
    )
    for name, expected in (("actuator_outputs", (0, 0)), ("actuator_outputs[1]", (0.25, 0.5))):
        (tmp_path / "m.toml").write_text(
            f'[topics]\ncommand = "{name}"\n[command]\ntime = "timestamp"\nunits = ["us"]\n'
            'values = ["output[0]", "output[1]"]\nneutral = 1000\nspan = 1000\ndisarmed = 900\n'
        )
        recording = read_recording(path, mapping=read_mapping(tmp_path / "m.toml"))
        np.testing.assert_array_equal(recording["command"].values[0], expected)
        assert any("several actuator_outputs" in text for text in recording.warnings) == (
            name == "actuator_outputs"
        )


_LOCAL = (
    "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float heading;"
    "uint8_t xy_valid;"
)


def local(valid: list[int]) -> list[bytes]:
    return [
        struct.pack("<QQ4fB", 10_000 * k, 10_000 * k, 0.1 * k, 0, 0, 0.5, seen)
        for k, seen in enumerate(valid)
    ]


def test_positions_marked_invalid_by_px4_are_ignored(tmp_path):
    motors = [struct.pack("<Q4f", 10_000 * k, 0.25, 0.5, 0.5, 0.5) for k in range(9)]
    topics = {
        "vehicle_local_position": (_LOCAL, local([0, 0, 1, 1, 1, 1, 1, 1, 1])),
        "actuator_motors": ("uint64_t timestamp;float[4] control;", motors),
    }
    recording = read_recording(write_ulog(tmp_path / "a.ulg", topics))
    np.testing.assert_allclose(recording["pose"].values[0], (0.2, 0.0, -0.5), atol=1e-6)
    assert recording.warnings == ("blank poses left out: 2",)
    topics["vehicle_local_position"] = _LOCAL, local([0] * 9)
    with pytest.raises(InputError, match=r"local_position: contains no horizontal position"):
        read_recording(write_ulog(tmp_path / "a.ulg", topics))


def test_a_topic_with_horizontal_positions_takes_precedence(tmp_path):
    fields = "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;uint8_t f;"
    nan = float("nan")
    blind = [
        struct.pack("<QQ7fB", 10_000 * k, 10_000 * k, nan, nan, 0, 1, 0, 0, 0, 1) for k in range(9)
    ]
    motors = [struct.pack("<Q4f", 10_000 * k, 0.25, 0.5, 0.5, 0.5) for k in range(9)]
    topics = {
        "vehicle_odometry": (fields, blind),
        "vehicle_local_position": (_LOCAL, local([1] * 9)),
        "actuator_motors": ("uint64_t timestamp;float[4] control;", motors),
    }
    assert len(read_recording(write_ulog(tmp_path / "a.ulg", topics))["pose"]) == 9
