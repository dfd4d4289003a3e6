import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, Recording, Stream
from airpuck.recording.conversion import yaw_of
from airpuck.recording.csv_folder import write_csv
from airpuck.recording.mapping import Topics
from airpuck.recording.read import read_recording

from ..apparatus.bags import SIX, flight
from ..apparatus.examples import examples
from ..apparatus.refusals import rejected

POSE = "optitrack_drone_pose.csv"
COMMAND = "drone_control.csv"
POSE_LINES = [
    "log_time_ns,header.stamp.sec,header.stamp.nanosec,"
    "pose.orientation.yaw,pose.position.x,pose.position.y",
    "1709651570790106321,1709651570,788520097,-0.4870394931199614,-0.0370602607,0.0019214153",
    "1709651570793755081,1709651570,792686700,-0.48612218209846003,-0.0371639728,0.0018630027",
]
COMMAND_LINES = [
    "log_time_ns,header.stamp.nanosec,header.stamp.sec,motor_1,motor_2",
    "1709651571230207968,230122873,1709651571,0.1311,0.03",
    "1709651571240210144,240126811,1709651571,0.1413,1",
    "1709651571250210144,250126811,1709651571,nan,-inf",
]


def folder(path: Path, pose=POSE_LINES, command=COMMAND_LINES, end: str = "\n") -> Path:
    (path / POSE).write_text("\n".join(pose) + end)
    (path / COMMAND).write_text("\n".join(command) + end)
    return path


def test_columns_are_found_by_name_and_times_to_the_nanosecond(tmp_path: Path):
    recording = read_recording(folder(tmp_path))
    pose, command = recording["pose"], recording["command"]
    # These differ in digits that a float64 of seconds or nanoseconds does not hold.
    assert pose.stamp_ns.tolist() == [1709651570788520097, 1709651570792686700]
    assert pose.received_ns.tolist() == [1709651570790106321, 1709651570793755081]
    assert pose.values[0].tolist() == [-0.0370602607, 0.0019214153, -0.4870394931199614]
    assert command.columns == ("motor_1", "motor_2")
    assert command.values[:2].tolist() == [[0.1311, 0.03], [0.1413, 1]]
    assert np.isnan(command.values[2, 0])
    assert command.values[2, 1] == -np.inf
    assert set(recording.hashes) == {POSE, COMMAND}
    assert recording.warnings == ()


def test_columns_may_be_in_any_order_with_extra_ones(tmp_path: Path):
    rows = [line.split(",") for line in POSE_LINES]
    shuffled = [",".join(["text" if i else "note", *row[::-1]]) for i, row in enumerate(rows)]
    expected = read_recording(folder(tmp_path))
    assert read_recording(folder(tmp_path, pose=shuffled))["pose"] == expected["pose"]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.rstrip(b"\n"),
        lambda text: text + b"\n",
        lambda text: b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"),
    ],
)
def test_other_line_and_file_endings_are_read(tmp_path: Path, change):
    expected = read_recording(folder(tmp_path)).streams
    for name in (POSE, COMMAND):
        (tmp_path / name).write_bytes(change((tmp_path / name).read_bytes()))
    assert read_recording(tmp_path).streams == expected


def test_all_columns_are_commands_unless_some_are_named_motor(tmp_path: Path):
    lines = [COMMAND_LINES[0].replace("motor_1", "left").replace("motor_2", "lift.fan")]
    command = read_recording(folder(tmp_path, command=lines + COMMAND_LINES[1:]))["command"]
    assert command.columns == ("left", "lift.fan")
    # Beside columns that are called so, others are no commands.
    lines = [f"{line},{extra}" for line, extra in zip(COMMAND_LINES, "mabo", strict=True)]
    command = read_recording(folder(tmp_path, command=lines))["command"]
    assert command.columns == ("motor_1", "motor_2")
    with pytest.raises(InputError, match="has no column of a motor"):
        none = [",".join(line.split(",")[:3]) for line in COMMAND_LINES]
        read_recording(folder(tmp_path, command=none))


def test_references_without_stamps_are_read(tmp_path: Path):
    lines = ["log_time_ns,v_x,v_y,w_z,x,y,yaw", "1700589581517869741,0.1,0.2,0.3,1.0,0.5,1.5"]
    (folder(tmp_path) / "control_state_ref.csv").write_text("\n".join(lines))
    reference = read_recording(tmp_path)["reference"]
    assert reference.values.tolist() == [[1.0, 0.5, 1.5, 0.1, 0.2, 0.3]]
    assert reference.stamp_ns.tolist() == reference.received_ns.tolist() == [1700589581517869741]


def test_the_written_quaternion_has_the_same_yaw(tmp_path: Path):
    recording = flight()
    write_csv(recording, tmp_path / "out")
    file = tmp_path / "out" / POSE
    names = file.read_text().partition("\n")[0].split(",")
    rows = np.loadtxt(
        file,
        delimiter=",",
        skiprows=1,
        usecols=[names.index(f"pose.orientation.{axis}") for axis in ("x", "y", "z", "w")],
    )
    turned = np.angle(np.exp(1j * (yaw_of(*rows.T) - recording["pose"].values[:, 2])))
    assert np.abs(turned).max() < 1e-12


def test_a_quaternion_replaces_a_missing_yaw(tmp_path: Path):
    header = POSE_LINES[0].replace("pose.orientation.yaw", "pose.orientation.w")
    pose = [
        f"{header},pose.orientation.x,pose.orientation.y,pose.orientation.z",
        f"1,2,3,{np.cos(1.1)!r},0.25,0.75,0,0,{np.sin(1.1)!r}".replace("np.float64", ""),
    ]
    pose[1] = pose[1].replace("(", "").replace(")", "")
    values = read_recording(folder(tmp_path, pose=pose))["pose"].values
    assert values[0] == pytest.approx([0.25, 0.75, 2.2], abs=1e-15)


def test_files_named_after_other_topics_are_found(tmp_path: Path):
    folder(tmp_path)
    expected = read_recording(tmp_path).streams
    (tmp_path / POSE).rename(tmp_path / "mocap_puck.csv")
    (tmp_path / POSE).mkdir()
    with pytest.raises(InputError, match="has no pose file"):
        read_recording(tmp_path)
    assert read_recording(tmp_path, topics=Topics(pose="/mocap/puck")).streams == expected
    (tmp_path / "mocap_puck.csv").rename(tmp_path / "my_pose_2.csv")
    assert read_recording(tmp_path).streams == expected


def test_references_are_not_mistaken_for_commands(tmp_path: Path):
    expected = read_recording(folder(tmp_path)).streams
    (tmp_path / COMMAND).rename(tmp_path / "puck_control.csv")
    (tmp_path / "puck_control_state_ref.csv").write_text("log_time_ns,x\n")
    assert read_recording(tmp_path).streams == expected


def test_several_possible_pose_files_are_reported(tmp_path: Path):
    folder(tmp_path)
    for name in ("pose_a.csv", "pose_b.csv"):
        (tmp_path / name).write_bytes((tmp_path / POSE).read_bytes())
    read_recording(tmp_path)
    (tmp_path / POSE).unlink()
    with pytest.raises(InputError, match=r"pose_a\.csv, pose_b\.csv"):
        read_recording(tmp_path)


def test_unordered_and_duplicated_rows_are_kept(tmp_path: Path):
    pose = [POSE_LINES[0], POSE_LINES[2], POSE_LINES[1], POSE_LINES[1]]
    stamps = read_recording(folder(tmp_path, pose=pose))["pose"].stamp_ns.tolist()
    assert stamps == [1709651570792686700, 1709651570788520097, 1709651570788520097]
    alone = read_recording(folder(tmp_path, pose=POSE_LINES[:1]))
    with pytest.raises(InputError, match=r"the pose stream is empty; .* another topic"):
        alone["pose"]


def test_an_incomplete_last_line_is_ignored_with_a_warning(tmp_path: Path):
    pose = [*POSE_LINES, POSE_LINES[1][:40]]
    recording = read_recording(folder(tmp_path, pose=pose, end=""))
    assert len(recording["pose"]) == 2
    (warning,) = recording.warnings
    assert POSE in warning
    assert "(4)" in warning


def change(line: int, column: str, text: str) -> list[str]:
    rows = [row.split(",") for row in POSE_LINES]
    rows[line][rows[0].index(column)] = text
    return [",".join(row) for row in rows]


X, SEC, LOG = "pose.position.x", "header.stamp.sec", "log_time_ns"


@pytest.mark.parametrize(
    ("pose", "field", "says"),
    [
        (change(0, X, "x"), X, "there is no such column"),
        (change(0, "header.stamp.nanosec", "ns"), "header.stamp.nanosec", "no such column"),
        (change(2, X, "fast"), X, "line 3: 'fast' is not a number"),
        (change(2, SEC, "1709651570.0"), SEC, "line 3: '1709651570.0' is not a whole number"),
        (change(2, SEC, "nan"), SEC, "line 3: 'nan' is not a whole number"),
        (change(2, LOG, "1.7e18"), LOG, "is not a whole number"),
        (change(2, LOG, "9" * 30), LOG, "beyond 64 bits"),
        (change(2, SEC, "1709651570788520097"), SEC, "are they nanoseconds?"),
        (change(0, X, SEC), SEC, "two columns of this name"),
        ([*POSE_LINES[:2], POSE_LINES[2] + ",1"], None, "line 3 has 7 fields, the header has 6"),
        ([*POSE_LINES[:2], "1,2,3", POSE_LINES[2]], None, "line 3 has 3 fields"),
        ([""], None, "is empty"),
        (["", "", ""], None, "is empty"),
        (
            [line.replace(",", "|") for line in POSE_LINES],
            "header.stamp.sec, header.stamp.nanosec, pose.position.x, pose.position.y, "
            "pose.orientation.yaw",
            "no such column",
        ),
    ],
)
def test_errors_name_file_column_and_line(
    tmp_path: Path, pose: list[str], field: str | None, says: str
):
    with rejected(tmp_path / POSE, says, field=field):
        read_recording(folder(tmp_path, pose=pose))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x89MCAP0\r\n" + bytes(range(256)), b""])
def test_a_file_that_is_not_text_is_rejected(tmp_path: Path, content: bytes):
    (folder(tmp_path) / POSE).write_bytes(content)
    with pytest.raises(InputError, match=r"is not UTF-8 text|is empty"):
        read_recording(tmp_path)


@examples(200)
@given(cut=st.integers(0, len("\n".join(POSE_LINES))), junk=st.binary(max_size=6))
def test_a_file_cut_anywhere_is_read_or_rejected(cut: int, junk: bytes):
    with tempfile.TemporaryDirectory() as name:
        path = folder(Path(name))
        (path / POSE).write_bytes("\n".join(POSE_LINES).encode()[:cut] + junk)
        try:
            recording = read_recording(path)
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert len(recording.streams["pose"]) <= 2 + junk.count(b"\n") + junk.count(b"\r")


def test_a_written_folder_round_trips_exactly(tmp_path: Path):
    made = flight()
    # References with stamps of their own, and numbers that are not finite.
    given = made["reference"]
    moved = Stream(given.stamp_ns - 5, given.received_ns, given.values, given.columns)
    made["command"].values[3] = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e308]
    write_csv(Recording({**made.streams, "reference": moved}, ""), tmp_path / "moved")
    assert read_recording(tmp_path / "moved").streams == {**made.streams, "reference": moved}
    write_csv(made, tmp_path / "csv")
    recording = read_recording(tmp_path / "csv")
    assert recording.streams == made.streams
    assert (tmp_path / "csv" / POSE).is_file()
    assert (tmp_path / "csv" / "control_state_ref.csv").is_file()


def test_only_an_empty_folder_is_written_to(tmp_path: Path):
    (tmp_path / "precious").touch()
    with pytest.raises(InputError, match="exists already"):
        write_csv(flight(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]
    (tmp_path / "empty").mkdir()
    write_csv(flight(), tmp_path / "empty")
    assert list((tmp_path / "empty").iterdir())


def test_the_authors_files_are_read(experiments: Path):
    path = experiments / "2024_03_05-16_12_50_sysid_h1_blue"
    recording = read_recording(path)
    pose, command = recording["pose"], recording["command"]
    assert recording.source == str(path / path.name)
    assert len(pose) == 14623
    assert len(command) == 6066
    assert command.columns == SIX
    assert pose.stamp_ns[0] == 1709651570788520097
    assert pose.received_ns[0] == 1709651570790106321
    assert command.values[1].tolist() == [
        0.141373410820961,
        0.03,
        0.03,
        0.19099931418895721,
        0.17826981842517853,
        0.03,
    ]
    # The authors' yaw is the one of their quaternions, which have single precision.
    quaternion = np.genfromtxt(
        path / path.name / POSE, delimiter=",", skip_header=1, usecols=(8, 9, 10, 7)
    )
    assert np.abs(yaw_of(*quaternion.T) - pose.values[:, 2]).max() < 1e-15
    # An independent reader for every number.
    table = np.genfromtxt(
        path / path.name / POSE, delimiter=",", skip_header=1, usecols=(11, 12, 6)
    )
    assert np.array_equal(pose.values, table)


def test_the_authors_closed_loop_flights_are_read(data: Path):
    recording = read_recording(data / "control_experiment" / "data_M4")
    reference = recording["reference"]
    assert reference.values[:, :3].tolist() == [
        [0, 0, 0],
        [1.0, 0.3, 1.5],
        [0.5, -0.3, -1.0],
        [0, 0, 0],
    ]
    assert np.diff(reference.received_ns[1:]) / 1e9 == pytest.approx([2, 2], abs=0.01)


def test_the_authors_files_round_trip_through_our_format(tmp_path: Path, experiments: Path):
    recording = read_recording(experiments / "2024_03_05-16_12_50_sysid_h1_blue")
    write_csv(recording, tmp_path / "csv")
    assert read_recording(tmp_path / "csv").streams == recording.streams
