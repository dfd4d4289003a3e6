import numpy as np
import pytest

from airpuck import CommandMapping, InputError, PoseMapping, Recording, RecordingMapping

TIME = 0.01 * np.arange(20)
POSES = np.column_stack([0.1 * TIME, -0.2 * TIME, 3 * TIME])
COMMANDS = np.random.default_rng(1).uniform(0, 1, (10, 4))


def test_arrays_become_a_recording():
    recording = Recording.from_arrays(TIME, POSES, TIME[::2], COMMANDS, propellers=list("abcd"))
    assert np.array_equal(recording["pose"].values, POSES)
    assert recording["pose"].stamp_ns.tolist() == [10**7 * k for k in range(20)]
    assert np.array_equal(recording["command"].values, COMMANDS)
    assert recording["command"].columns == ("a", "b", "c", "d")
    assert recording.warnings == ()


def test_lists_and_integers_are_accepted():
    recording = Recording.from_arrays([0, 1], [[0, 0, 0], [1, 2, 3]], [0, 1], [[0, 1], [1, 0]])
    assert recording["pose"].values.tolist() == [[0, 0, 0], [1, 2, 3]]
    assert recording["command"].stamp_ns.tolist() == [0, 10**9]
    assert recording["command"].columns == ("value_1", "value_2")


def test_quaternions_units_axes_and_scale_are_applied():
    half = POSES[:, 2] / 2
    none = np.zeros(20)
    poses = np.column_stack(
        [1e3 * POSES[:, 0], none, -1e3 * POSES[:, 1], none, np.sin(half), none, np.cos(half)]
    )
    mapping = RecordingMapping(
        pose=PoseMapping(units=("mm",), axes="Y-up"), command=CommandMapping(scale=0.01)
    )
    found = Recording.from_arrays(TIME, poses, TIME[::2], 100 * COMMANDS, mapping=mapping)
    np.testing.assert_allclose(found["pose"].values, POSES, atol=1e-15)
    np.testing.assert_allclose(found["command"].values, COMMANDS, rtol=1e-14)


def test_columns_of_a_data_frame_are_accepted():
    pandas = pytest.importorskip("pandas")
    log = pandas.DataFrame(POSES, columns=["x", "y", "yaw"])
    log["when"] = pandas.Timestamp("2024-03-05 16:12:50.123456789") + pandas.to_timedelta(TIME, "s")
    log = log.join(pandas.DataFrame(COMMANDS, index=range(0, 20, 2), columns=list("abcd")))
    names = list("abcd")
    found = Recording.from_arrays(
        log["when"], log[["x", "y", "yaw"]], log["when"], log[names], propellers=names
    )
    assert np.array_equal(found["pose"].values, POSES)
    assert np.array_equal(found["command"].values, COMMANDS)
    assert found["pose"].stamp_ns[0] == 1_709_655_170_123_456_789
    assert found.warnings == ("blank commands left out: 10",)


def test_rows_of_nan_are_dropped():
    poses = POSES.copy()
    poses[[3, 4, 11]] = np.nan
    poses[6, 1] = np.nan
    found = Recording.from_arrays(TIME, poses, TIME[::2], COMMANDS)
    assert len(found["pose"]) == 16
    assert np.isfinite(found["pose"].values).all()
    assert found.warnings == ("blank poses left out: 3", "blank poses left out: 1")


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ((TIME, POSES[:, :2], TIME[::2], COMMANDS), "poses: has 2 columns"),
        ((TIME[:5], POSES, TIME[::2], COMMANDS), r"poses: have the shape \(20, 3\)"),
        ((TIME, POSES, TIME, COMMANDS), r"commands: have the shape \(10, 4\) and their times"),
        ((TIME, POSES, TIME[::2], COMMANDS[:, 0]), r"commands: have the shape \(10,\)"),
        ((TIME, [["a", "b", "c"]] * 20, TIME[::2], COMMANDS), "poses: are not numbers"),
        ((["noon"] * 20, POSES, TIME[::2], COMMANDS), "poses: are not numbers"),
        ((TIME, [[1, 2, 3], [4]], TIME[::2], COMMANDS), "poses: are not numbers"),
        ((TIME * np.nan, POSES, TIME[::2], COMMANDS), "row 1 has no time"),
        ((TIME + 1.7e18, POSES, TIME[::2], COMMANDS), "which no clock shows"),
    ],
)
def test_inconsistent_arrays_are_rejected(arrays, says: str):
    with pytest.raises(InputError, match=says) as caught:
        Recording.from_arrays(*arrays, source="my log")
    assert str(caught.value).startswith("my log: ")


def test_inconsistent_propellers_are_rejected():
    with pytest.raises(InputError, match="names 2 propellers for 4 values"):
        Recording.from_arrays(TIME, POSES, TIME[::2], COMMANDS, propellers=("a", "b"))


def test_streams_are_iterable_and_convert_to_tables():
    recording = Recording.from_arrays(TIME, POSES, TIME[::2], COMMANDS)
    poses = recording["pose"]
    np.testing.assert_allclose(poses.time, TIME, atol=1e-12)
    time, x, y, yaw = list(poses)[3]
    assert (time, [x, y, yaw]) == (pytest.approx(0.03), POSES[3].tolist())
    table = poses.to_pandas()
    assert list(table) == ["x_m", "y_m", "yaw_rad"]
    np.testing.assert_array_equal(table.to_numpy(), POSES)
    assert table.index[3].value == 30_000_000  # ns
    assert list(recording) == ["pose", "command"]
    assert "puck" not in recording and "pose" in recording
    assert repr(poses) == "Stream(20 of x_m, y_m, yaw_rad in 0.2 s)"
