from pathlib import Path

import numpy as np
import pytest

from airpuck import CommandMapping, InputError, Recording, RecordingMapping
from airpuck.preprocessing.quality import drop_disorder
from airpuck.recording.csv_table import CsvTable, read_rows
from airpuck.recording.mapping import read_mapping
from airpuck.recording.read import read_recording

from ..apparatus.refusals import rejected

N = 50
TIME = 0.02 * np.arange(N)
POSES = np.column_stack([0.3 * np.cos(TIME), 0.4 * np.sin(TIME), 2 * TIME])
COMMANDS = np.random.default_rng(2).integers(0, 100, (N, 4)) / 100
MAPPING = """
[pose]
file = "mocap.csv"
time = "t"
position = ["x", "y"]
orientation = "theta"
units = ["cm", "deg", "ms"]

[command]
file = "motors.csv"
time = "stamp"
units = ["ns"]
values = ["m1", "m2", "m3", "m4"]
scale = 0.001
offset = -1
"""


def mapping(path: Path, text: str = MAPPING) -> RecordingMapping:
    (path / "mapping.toml").write_text(text)
    return read_mapping(path / "mapping.toml")


def csv(names: str, *columns: np.ndarray, between: str = ",") -> str:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [names.replace(",", between), *(between.join(map(str, row)) for row in rows)]
    return "\n".join(lines) + "\n"


def mocap(**keys) -> str:
    x, y, yaw = POSES.T
    return csv(
        "frame,t,x,y,theta", np.arange(N), 1e3 * TIME, 100 * x, 100 * y, np.degrees(yaw), **keys
    )


def motors() -> str:
    stamps = (np.round(1e9 * TIME) + 17).astype(np.int64)
    return csv("stamp,m1,m2,m3,m4,mode", stamps, *(1000 + 1000 * COMMANDS.T), np.full(N, "auto"))


def folder(path: Path, pose: str | None = None, command: str | None = None) -> Path:
    (path / "mocap.csv").write_text(mocap() if pose is None else pose)
    (path / "motors.csv").write_text(motors() if command is None else command)
    return path


def assert_is_the_flight(recording: Recording, kept=slice(None)) -> None:
    pose, command = recording["pose"], recording["command"]
    np.testing.assert_allclose(pose.values, POSES[kept], atol=1e-12)
    assert pose.stamp_ns.tolist() == np.round(1e9 * TIME[kept]).astype(int).tolist()
    np.testing.assert_allclose(command.values, COMMANDS, atol=1e-12)
    assert command.stamp_ns.tolist() == (np.round(1e9 * TIME) + 17).astype(int).tolist()


def test_columns_units_scale_and_files_are_applied(tmp_path: Path):
    recording = read_recording(folder(tmp_path), mapping=mapping(tmp_path))
    assert_is_the_flight(recording)
    assert recording["command"].columns == ("m1", "m2", "m3", "m4")
    assert set(recording.hashes) == {"mocap.csv", "motors.csv"}
    assert recording.warnings == ()


@pytest.mark.parametrize("between", [";", "\t"])
def test_other_separators_are_recognised(tmp_path: Path, between: str):
    path = folder(tmp_path, mocap(between=between))
    assert_is_the_flight(read_recording(path, mapping=mapping(tmp_path)))


def test_propellers_select_their_columns_by_name(tmp_path: Path):
    command = motors().replace("m1,m2,m3,m4", "left,right,front,rear")
    text = MAPPING.replace('values = ["m1", "m2", "m3", "m4"]', 'propellers = ["rear", "left"]')
    found = read_recording(folder(tmp_path, command=command), mapping=mapping(tmp_path, text))
    assert found["command"].columns == ("rear", "left")
    np.testing.assert_allclose(found["command"].values, COMMANDS[:, [3, 0]], atol=1e-12)
    # Names that differ from the column names rename the columns, in order.
    text = MAPPING.replace("scale", 'propellers = ["a", "b", "c", "d"]\nscale')
    found = read_recording(folder(tmp_path), mapping=mapping(tmp_path, text))
    assert found["command"].columns == ("a", "b", "c", "d")


def test_one_file_may_hold_all_streams_with_blank_cells(tmp_path: Path):
    """A merged log: poses and commands at different times, blank where the other one is."""
    names = "time,x,y,qx,qy,qz,qw,u1,u2"
    rows = []
    for k, (t, (x, y, yaw), u) in enumerate(zip(TIME, POSES, COMMANDS, strict=True)):
        quaternion = f"0,0,{np.sin(yaw / 2)},{np.cos(yaw / 2)}"
        rows.append(f"{t},{x},{y},{quaternion},," if k % 2 else f"{t},,, ,,,,{u[0]},{u[1]}")
    (tmp_path / "log.csv").write_text("\n".join([names, *rows]) + "\n")
    text = """
[pose]
time = "time"
position = ["x", "y"]
orientation = { x = "qx", y = "qy", z = "qz", w = "qw" }
[command]
time = "time"
values = ["u1", "u2"]
"""
    found = read_recording(tmp_path / "log.csv", mapping=mapping(tmp_path, text))
    np.testing.assert_allclose(found["pose"].values, POSES[1::2], atol=1e-12)
    np.testing.assert_allclose(found["command"].values, COMMANDS[::2, :2])
    assert found["command"].stamp_ns[1] == 40_000_000
    assert found.warnings == ("blank poses left out: 25", "blank commands left out: 25")


def edited(text: str, line: int, column: int, value: str) -> str:
    lines = [row.split(",") for row in text.splitlines()]
    lines[line][column] = value
    return "\n".join(",".join(row) for row in lines) + "\n"


def at_times(times: list[str], name: str = "t", **more: list[str]) -> str:
    lines = [",".join([name, "x", "y", "theta", *more])]
    for k, time in enumerate(times):
        x, y, yaw = 100 * POSES[k, 0], 100 * POSES[k, 1], np.degrees(POSES[k, 2])
        lines.append(",".join(map(str, (time, x, y, yaw, *(texts[k] for texts in more.values())))))
    return "\n".join(lines) + "\n"


HEADER = "frame,t,x,y,theta\n"
#: Both coordinates move by a power of two, and their steps cancel each other.
DIAGONAL = csv(
    "t,x,y,theta", 1e3 * np.round(TIME, 1), *(0.125 * np.outer([1, -1, 0], np.arange(N)))
)


@pytest.mark.parametrize(
    ("pose", "text", "says"),
    [
        (edited(mocap(), 3, 4, "north"), MAPPING, "csv: theta: line 4: 'north' is not a number"),
        (edited(mocap(), 3, 1, "nan"), MAPPING, "mocap.csv: time: row 3 has no time"),
        (edited(mocap(), 3, 1, ""), MAPPING, "mocap.csv: t: line 4: '' is not a number"),
        (edited(mocap(), 3, 1, "1e30"), MAPPING, "which no clock shows"),
        (edited(mocap(), 0, 2, "y"), MAPPING, "csv: y: there are two columns of this name"),
        ("", MAPPING, "mocap.csv: is empty"),
        (mocap().split("\n", 1)[1], MAPPING, "csv: has no header: its first line must name"),
        ("\x00\x01\x02", MAPPING, "there is no such column"),
        (mocap()[: len(mocap()) // 2].replace(",", ";", 3), MAPPING, "has"),
        ("frame\n1\n", MAPPING, "t, x, y, theta: there is no such column"),
        (
            mocap(),
            MAPPING.replace('time = "t"\n', ""),
            r"^(?!.*header).*mocap\.csv: time: no column is named for the time; name columns"
            ".* out of frame, t, x, y, theta",
        ),
        (
            at_times([f"10:00:{t:09.6f}" for t in TIME]),
            MAPPING,
            "line 2: '10:00:00.000000' is not a number; write sec",
        ),
        # The index of a data frame has numbers, and is called by its place.
        (mocap().replace("frame,t", ",time"), MAPPING, "no such column.*column 1, time, x"),
        (
            HEADER + "".join(f"{k},{t},1,1,\n" for k, t in enumerate(TIME)),
            MAPPING,
            "no row has numbers in all of x, y, theta",
        ),
        (DIAGONAL, MAPPING, "lines 2 and 3, and .* times have lost digits"),
        *(
            (
                at_times([form % (1.7e9 + t) for t in TIME]),
                MAPPING.replace('"deg", "ms"', '"deg"'),
                r"lines \d+ and \d+.* times have lost digits",
            )
            for form in ("%.9g", "%.10g", "%.11g")
        ),
    ],
)
def test_errors_end_in_one_line(tmp_path: Path, pose: str, text: str, says: str):
    with pytest.raises(InputError, match=says):
        read_recording(folder(tmp_path, pose), mapping=mapping(tmp_path, text))


def test_all_missing_keys_are_named_at_once(tmp_path: Path):
    path = folder(tmp_path, "a,b\n1,2\n", "c,d\n1,2\n")
    with rejected(
        "mocap.csv: t, x, y, theta: there is no such column",
        'pose = {time = "...", position = ["...", "..."], orientation = "..."} out of a, b',
        "motors.csv: stamp, m1, m2, m3, m4: there is no such column",
        'command = {time = "...", values = ["...", ...]} out of c, d',
    ):
        read_recording(path, mapping=mapping(tmp_path))


def test_unknown_files_are_reported_with_a_mapping_to_write(tmp_path: Path):
    folder(tmp_path)
    with pytest.raises(InputError) as caught:
        read_recording(tmp_path)
    message = str(caught.value)
    assert "has no pose file" in message
    assert "add units" in message and "0.01 for percent" in message
    assert 'pose = {file = "...", time = "...", position' in message
    assert 'command = {file = "...", time = "...", values' in message
    assert "out of mocap.csv, motors.csv" in message
    with pytest.raises(InputError, match=r"a single CSV file; .* out of frame, t, x, y, theta"):
        read_recording(tmp_path / "mocap.csv")


def test_a_missing_file_named_by_the_mapping_is_reported(tmp_path: Path):
    folder(tmp_path)
    (tmp_path / "motors.csv").rename(tmp_path / "control.csv")
    with pytest.raises(InputError, match=r"has no command file \(motors.csv\)"):
        read_recording(tmp_path, mapping=mapping(tmp_path))


def test_order_and_duplicates_are_left_to_preprocessing(tmp_path: Path):
    lines = mocap().splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    lines.insert(9, lines[9])
    path = folder(tmp_path, "\n".join(lines) + "\n")
    pose = read_recording(path, mapping=mapping(tmp_path))["pose"]
    assert len(pose) == N + 1
    kept = drop_disorder(pose.stamp_ns / 1e9, pose.values, "pose")
    assert len(kept.time) == N - 1
    assert len(kept.warnings) == 2


def test_an_incomplete_last_line_is_ignored(tmp_path: Path):
    found = read_recording(folder(tmp_path, mocap().rstrip("\n")[:-30]), mapping=mapping(tmp_path))
    assert_is_the_flight(found, slice(None, N - 1))
    assert "mocap.csv is cut short" in found.warnings[0]


def test_the_authors_columns_can_be_given_another_unit(tmp_path: Path):
    head = "log_time_ns,header.stamp.sec,header.stamp.nanosec"
    (tmp_path / "my_pose.csv").write_text(
        f"{head},pose.orientation.yaw,pose.position.x,pose.position.y\n7,1,2,90,1500,-250\n"
    )
    (tmp_path / "my_control.csv").write_text(f"{head},motor_1,motor_2\n7,1,2,100,20\n")
    text = '[pose]\nunits = ["mm", "deg"]\n[command]\nscale = 0.01\nstart_s = 2\n'
    found = read_recording(tmp_path, mapping=mapping(tmp_path, text))
    np.testing.assert_allclose(found["pose"].values, [[1.5, -0.25, np.pi / 2]])
    assert found["pose"].stamp_ns.tolist() == [1_000_000_002]
    assert found["pose"].received_ns.tolist() == [7]
    assert found["command"].values.tolist() == [[1, 0.2]]
    assert found["command"].stamp_ns.tolist() == [3_000_000_002]


ONE_CELL = (
    MAPPING.partition("[command]")[0]
    + """
[command]
file = "motors.csv"
time = "t"
propellers = ["a", "b", "c", "d"]
"""
)
SWITCHES = np.random.default_rng(3).integers(0, 2, (N, 4))


def one_column(cells: list[str]) -> str:
    rows = zip(TIME.tolist(), cells, strict=True)
    return "\n".join(["t,value", *(f'{t},"{cell}"' for t, cell in rows)]) + "\n"


def read_cells(path: Path, cells: list[str], keys: str) -> Recording:
    folder(path, command=one_column(cells))
    return read_recording(path, mapping=mapping(path, ONE_CELL + keys))


@pytest.mark.parametrize(
    ("keys", "cell"),
    [
        ('values = ["value"]', lambda row: str(row.tolist())),
        ('values = ["value"]', lambda row: str(row)),
        ('values = ["value"]', lambda row: str(tuple(map(bool, row)))),
        (
            'values = ["value"]\nneutral = 1500\nspan = 400',
            lambda row: str((1500 + 400 * row).tolist()),
        ),
        (
            'values = ["value[4]", "value[1]", "value[2]", "value[0]"]',
            lambda row: str(row[[3, 1, 2, 1, 0]].tolist()),
        ),
        ('values = ["value"]\nbits = [0, 1, 2, 3]', lambda row: str(row @ [1, 2, 4, 8])),
        ('values = ["value"]\nbits = [0, 1, 2, 3]', lambda row: f"{float(row @ [1, 2, 4, 8])}"),
        ('values = ["value"]\nbits = [3, 2, 1, 0]', lambda row: "0b1" + "".join(map(str, row))),
        ('values = ["value"]\nbits = [12, 8, 4, 0]', lambda row: "0x" + "".join(map(str, row))),
        ('values = ["value"]\nbits = [52, 8, 4, 0]', lambda row: hex(row @ [2**52, 256, 16, 1])),
    ],
)
def test_all_commands_may_be_in_one_cell(tmp_path: Path, keys: str, cell):
    read = read_cells(tmp_path, [cell(row) for row in SWITCHES], keys)
    assert read["command"].columns == ("a", "b", "c", "d")
    np.testing.assert_array_equal(read["command"].values, SWITCHES)


@pytest.mark.parametrize("bad", [0, 7])
@pytest.mark.parametrize(
    ("keys", "good", "cell", "says"),
    [
        ("", "[1, 0, 1, 1]", "[1, x, 1, 1]", "is not a list of"),
        ("", "[1, 0, 1, 1]", "[" * 500, "is not a list of"),
        ("", "[1, 0, 1, 1]", "[1,,1,1,1]", "is not a list of"),
        ("", "[1, 0, 1, 1]", "[[1,0],[1,1]]", "is not a list of"),
        ("", "[1, 0, 1, 1]", "[" + "1," * 30_000 + "1]", "is not a list of"),
        ("bits = [0, 1, 2, 3]", "0x1", "0xzz", "is not a bit mask"),
        ("bits = [0, 1, 2, 3]", "0x1", "0x" + "f" * 100_000, "is not a bit mask"),
        ("bits = [0, 1, 2, 3]", "0x1", "-1", "is not a bit mask"),
        ("bits = [0, 1, 2, 3]", "0x1", "2.5", "is not a bit mask"),
        ("bits = [0, 1, 2, 3]", "0x1", "inf", "is not a bit mask"),
        ("bits = [0, 1, 2, 3]", "0x1", "9007199254740992", "is not a bit mask"),
    ],
)
def test_an_invalid_cell_is_named_by_file_line_and_column(
    tmp_path: Path, keys: str, good: str, cell: str, says: str, bad: int
):
    cells = [good] * N
    cells[bad] = cell
    with pytest.raises(InputError) as caught:
        read_cells(tmp_path, cells, f'values = ["value"]\n{keys}')
    message = str(caught.value)
    assert "motors.csv" in message
    assert "value" in message
    assert says in message
    assert len(message) < 400
    assert "\n" not in message
    if bad:
        assert f"line {bad + 2}:" in message


def test_lists_of_different_lengths_are_rejected(tmp_path: Path):
    with pytest.raises(InputError, match="line 4: '\\[1, 0, 1\\]' is not a list of 4 numbers"):
        read_cells(tmp_path, ["[1, 0, 1, 1]"] * 2 + ["[1, 0, 1]"] * (N - 2), 'values = ["value"]')


def test_an_entry_beyond_the_list_is_rejected(tmp_path: Path):
    values = 'values = ["value[0]", "value[1]", "value[2]", "value[4]"]'
    with pytest.raises(InputError, match=r"value has 4 entries, so there is no value\[4\]"):
        read_cells(tmp_path, ["[1, 0, 1, 1]"] * N, values)


def test_bits_need_one_value():
    masked = RecordingMapping(command=CommandMapping(bits=(0, 1, 2)))

    def read(commands):
        times = np.arange(3.0)
        return Recording.from_arrays(times, np.zeros((3, 3)), times, commands, mapping=masked)

    masks = read([[5], [2], [0]])
    assert masks["command"].values.tolist() == [[1, 0, 1], [0, 1, 0], [0, 0, 0]]
    for commands, says in (([[5, 2]] * 3, "one value"), ([[1], [-1], [0]], "row 2: -1 is not")):
        with pytest.raises(InputError, match=says):
            read(commands)


PUCK = """
[puck]
position = ["x", "y"]
interval = "dt"
origin_m = [1.0, 0.5]
units = ["cm"]
"""


def camera(path: Path, steps: list[str], places: list[str] | None = None) -> Path:
    """Write positions of a puck as a camera logs them: the time since the previous frame."""
    places = places or [f"{100 + k},{50 - k}" for k in range(len(steps))]
    rows = [f"{place},{step}" for place, step in zip(places, steps, strict=True)]
    file = path / "puck.csv"
    file.write_text("\n".join(["x,y,dt", *rows]) + "\n")
    return file


def test_positions_of_a_puck_need_neither_times_nor_angles(tmp_path):
    # The first row has no previous one; a blank row still counts its time.
    file = camera(tmp_path, ["", "0.01", "0.02", "0.01"], ["100,50", "101,49", ",", "103,47"])
    found = read_recording(file, mapping=mapping(tmp_path, PUCK), needs=("puck",))
    assert set(found.streams) == {"puck"}
    puck = found["puck"]
    np.testing.assert_allclose(
        puck.values[:, :2], [[0, 0], [0.01, -0.01], [0.03, -0.03]], atol=1e-12
    )
    assert np.isnan(puck.values[:, 2]).all()
    assert puck.stamp_ns.tolist() == [0, 10_000_000, 40_000_000]


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (["", "0.01", "-0.01"], "puck.csv: dt: row 3 is negative"),
        (["", "0.01", ""], "dt"),
        (["", "0.01", "soon"], "dt"),
        (["", "0.01", "nan"], "row 3 has no time"),
        (["", "0.01", "inf"], "row 3 has no time"),
        (["", "1e308", "1e308"], "row 3 has no time"),
        (["", "0.01", "1e305"], "which no clock shows"),
    ],
)
def test_negative_and_non_numeric_intervals_are_rejected(tmp_path, steps, words):
    file = camera(tmp_path, steps)
    with rejected(words):
        read_recording(file, mapping=mapping(tmp_path, PUCK), needs=("puck",))


def test_intervals_need_a_unit(tmp_path):
    text = PUCK.replace('["cm"]', '["cm", "ms"]')
    file = camera(tmp_path, ["", "10", "2.5"])
    found = read_recording(file, mapping=mapping(tmp_path, text), needs=("puck",))
    assert found["puck"].stamp_ns.tolist() == [0, 10_000_000, 12_500_000]


def test_a_puck_file_without_a_mapping_states_what_to_write(tmp_path):
    with pytest.raises(InputError, match=r"puck = \{time = .*position = .*\} out of x, y, dt"):
        read_recording(camera(tmp_path, ["0", "0.01"]), needs=("puck",))


def test_time_and_interval_exclude_each_other(tmp_path):
    with pytest.raises(InputError, match="time and interval exclude each other"):
        mapping(tmp_path, '[pose]\ntime = "t"\ninterval = "dt"\n')


def test_intervals_and_origin_also_apply_to_poses_of_a_craft(tmp_path):
    x, y, yaw = POSES.T
    steps = np.full(N, 0.02)
    file = tmp_path / "mocap.csv"
    file.write_text(csv("dt,x,y,theta", steps, x + 0.5, y - 0.25, yaw))
    text = (
        '[pose]\nfile = "mocap.csv"\ninterval = "dt"\nposition = ["x", "y"]\n'
        'orientation = "theta"\norigin_m = [0.5, -0.25]\n'
    )
    found = read_recording(tmp_path, mapping=mapping(tmp_path, text), needs=("pose",))
    np.testing.assert_allclose(found["pose"].values, POSES, atol=1e-12)
    np.testing.assert_allclose(np.diff(found["pose"].stamp_ns), 20_000_000)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_tables_in_spreadsheet_encodings_are_read(tmp_path: Path, encoding: str):
    folder(tmp_path)
    for name in ("mocap.csv", "motors.csv"):
        text = (tmp_path / name).read_text().replace(",", "\t")
        (tmp_path / name).write_text(text, encoding=encoding)
    assert_is_the_flight(read_recording(tmp_path, mapping=mapping(tmp_path)))


@pytest.mark.parametrize(
    ("between", "end"), [("T", ""), (" ", ""), ("T", "Z"), ("T", "+00:00"), (" ", "+00:00")]
)
def test_times_may_be_iso_dates(tmp_path: Path, between: str, end: str):
    start = np.datetime64("2025-03-04T10:00:00", "ns")
    dates = [str(start + np.timedelta64(round(1e9 * t), "ns")) for t in TIME]
    text = at_times([date.replace("T", between) + end for date in dates])
    recording = read_recording(folder(tmp_path, text), mapping=mapping(tmp_path))
    expected = start.astype(np.int64) + np.round(1e9 * TIME).astype(np.int64)
    assert recording["pose"].stamp_ns.tolist() == expected.tolist()


def test_unnamed_columns_are_ignored(tmp_path: Path):
    text = mocap().replace("\n", ",,\n")
    assert_is_the_flight(read_recording(folder(tmp_path, text), mapping=mapping(tmp_path)))


@pytest.mark.parametrize("lost", ["nan", "NaN", "", "null", "N/A"])
def test_rows_without_position_or_orientation_are_ignored(tmp_path: Path, lost):
    rows = mocap().splitlines()
    for row, cells in ((5, (2, 3, 4)), (6, (2,)), (7, (4,))):
        fields = rows[row].split(",")
        for cell in cells:
            fields[cell] = lost
        rows[row] = ",".join(fields)
    text = "\n".join(rows) + "\n"
    recording = read_recording(folder(tmp_path, text), mapping=mapping(tmp_path))
    assert_is_the_flight(recording, np.delete(np.arange(N), [4, 5, 6]))
    assert recording.warnings == ("blank poses left out: 3",)


@pytest.mark.parametrize(
    "text",
    [
        mocap(between=";").replace(".", ","),
        HEADER + mocap().removeprefix(HEADER).replace("\n", ",\n"),
        "# flown by A. Pilot, on a Tuesday; dry floor\n" + mocap(),
        "#" + mocap(),
        mocap().replace("\n20,", "\n" + HEADER + "20,"),
    ],
    ids=["decimal commas", "a last comma", "a comment", "a header of NumPy", "two headers"],
)
def test_notations_used_by_common_programs_are_read(tmp_path: Path, text: str):
    assert_is_the_flight(read_recording(folder(tmp_path, text), mapping=mapping(tmp_path)))


def test_an_upper_case_suffix_is_recognised(tmp_path: Path):
    (tmp_path / "LOG.CSV").write_text(csv("t,m1,x", TIME, COMMANDS[:, 0], POSES[:, 0]))
    with pytest.raises(InputError, match="is a single CSV file"):
        read_recording(tmp_path / "LOG.CSV")


@pytest.mark.parametrize("each", [2, 3])
def test_poses_stamped_simultaneously_by_a_client_are_read(tmp_path: Path, each: int):
    looks = 1e3 * (TIME[np.arange(N) // each * each] + 1.23e-3)
    recording = read_recording(
        folder(tmp_path, at_times([f"{look:.4f}" for look in looks])), mapping=mapping(tmp_path)
    )
    np.testing.assert_allclose(recording["pose"].values, POSES, atol=1e-12)


@pytest.mark.parametrize("stated", ["rate_hz = 50", 'stamps = "exact"'])
def test_stated_stamps_override_the_check_of_their_digits(tmp_path: Path, stated: str):
    text = at_times([f"{1e3 * round(t, 1):.0f}" for t in TIME])
    with pytest.raises(InputError, match="lost digits"):
        read_recording(folder(tmp_path, text), mapping=mapping(tmp_path))
    chosen = MAPPING.replace("[command]", f"{stated}\n[command]")
    assert len(read_recording(tmp_path, mapping=mapping(tmp_path, chosen))["pose"]) == N


@pytest.mark.filterwarnings("error")
def test_dates_may_have_a_utc_offset(tmp_path: Path):
    texts = ["2024-03-05T16:00:00.5+02:00", "2024-03-05T14:00:01Z"]
    found = CsvTable(tmp_path / "a.csv", {"t": texts}, [2, 3], ()).times("t", exact=True)
    since = found - np.datetime64("2024-03-05T14:00:00", "ns")
    assert (since / np.timedelta64(1, "ms")).tolist() == [500.0, 1000.0]


@pytest.mark.parametrize(("text", "ends"), [("a", False), ("a\n", True), ("a\n\0", True)])
def test_even_the_shortest_files_are_split_into_cells(tmp_path: Path, text: str, ends: bool):
    (tmp_path / "a.csv").write_text(text)
    rows = read_rows(tmp_path / "a.csv")
    assert (rows.cells[0], rows.ends) == (["a"], ends)


def of_two_bodies(column: str, names: tuple[str, str], shift: float = 0.0) -> str:
    """A row for each frame and body; the wand's come first, at the same times or earlier."""
    lines = [f"t,{column},x,y,theta"]
    for k in range(N):
        x, y, yaw = 100 * POSES[k, 0], 100 * POSES[k, 1], np.degrees(POSES[k, 2])
        lines.append(f"{1e3 * (TIME[k] - shift)},{names[0]},7,{k},9")
        lines.append(f"{1e3 * TIME[k]},{names[1]},{x},{y},{yaw}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("shift", [0.0, 0.01])
@pytest.mark.parametrize(
    ("column", "names"),
    [("body", ("wand", "puck")), ("thing", ("wand", "puck")), ("id", "12"), ("rb", "12")],
)
def test_a_body_in_a_table_is_selected_by_name(tmp_path: Path, column: str, names, shift: float):
    text = of_two_bodies(column, names, shift)
    chosen = MAPPING.replace("[command]", f'body = "{names[1]}"\n[command]')
    recording = read_recording(folder(tmp_path, text), mapping=mapping(tmp_path, chosen))
    assert_is_the_flight(recording)
    other = chosen.replace(f'body = "{names[1]}"', 'body = "craft"')
    match = "names no rigid bodies" if column == "thing" else f"rigid bodies {names[0]}, {names[1]}"
    with pytest.raises(InputError, match=f"pose.body: .*{match}"):
        read_recording(tmp_path, mapping=mapping(tmp_path, other))
    if column != "thing":
        with pytest.raises(InputError, match=f"rigid bodies {names[0]}, {names[1]}; choose one"):
            read_recording(tmp_path, mapping=mapping(tmp_path))
    elif not shift:
        with pytest.raises(InputError, match="rows of several bodies are mixed"):
            read_recording(tmp_path, mapping=mapping(tmp_path))


def test_counter_and_status_columns_do_not_name_bodies(tmp_path: Path):
    ids, states = [str(k) for k in range(N)], ["ok"] * 20 + ["moved"] * 30
    text = at_times([str(1e3 * t) for t in TIME], id=ids, label=states)
    assert_is_the_flight(read_recording(folder(tmp_path, text), mapping=mapping(tmp_path)))
