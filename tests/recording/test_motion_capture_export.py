"""Exports of a known motion, written in the layouts that both makers document."""

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airpuck import CommandMapping, InputError, PoseMapping, RecordingMapping
from airpuck.recording.read import read_recording

from ..apparatus.refusals import rejected

N = 40
TIME = np.arange(N) / 100
#: In our axes: x, y [m], yaw [rad], with some tilt as well.
POSES = np.column_stack([0.4 * np.sin(TIME), 0.3 * TIME, 5 * TIME - 1])
HEIGHT = 0.02 + 0.001 * TIME
ROTATION = Rotation.from_euler("ZYX", np.column_stack([POSES[:, 2], 0.05 * TIME, -0.04 * TIME]))
#: From our axes to Motive's: x, up, and towards us.
TO_MOTIVE = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
COMMANDS = "t,m1,m2\n" + "".join(f"{t},0.5,0.25\n" for t in TIME)
COMMAND = CommandMapping(file="motors.csv", time="t", values=("m1", "m2"))


def motive(
    *,
    rotation: str = "Quaternion",
    unit: str = "Millimeters",
    bodies: tuple[str, ...] = ("puck",),
    labels: bool = False,
    lost: tuple[int, ...] = (),
    types: tuple[str, str] = ("Rigid Body", "Marker"),
) -> str:
    """The export of bodies that all move alike, each 1 m further along x, then a marker."""
    turned = Rotation.from_matrix(TO_MOTIVE @ ROTATION.as_matrix() @ TO_MOTIVE.T)
    axes = "XYZW" if rotation == "Quaternion" else "XYZ"
    if rotation == "Quaternion":
        angles = turned.as_quat()
    else:
        angles = turned.as_euler(rotation, degrees=True)[:, np.argsort(list(rotation))]
    size = {"Meters": 1, "Centimeters": 100, "Millimeters": 1000}[unit]
    columns, data = [], []
    for number, name in enumerate(bodies):
        position = np.column_stack([POSES[:, 0] + number, HEIGHT, -POSES[:, 1]]) * size
        columns += [(types[0], name, "Rotation", axis) for axis in axes]
        columns += [(types[0], name, "Position", axis) for axis in "XYZ"]
        columns += [(types[0], name, "Mean Marker Error", "")]
        data += [angles, position, np.full((N, 1), 0.1)]
    columns += [(types[1], f"{bodies[0]}:Marker1", "Position", axis) for axis in "XYZ"]
    data += [np.ones((N, 3))]
    table = np.hstack(data)
    about = (
        f"Format Version,1.23,Take Name,Take 1,Take Notes,,Capture Frame Rate,100.000000,"
        f"Export Frame Rate,100.000000,Total Exported Frames,{N},Rotation Type,{rotation},"
        f"Length Units,{unit},Coordinate Space,Global"
    )
    head = ["Type", "Name", ""] if labels else ["", "", ""]
    lines = [about, ""]
    kinds, names, parts, last = zip(*columns, strict=True)
    lines.append(",".join(["", head[0], *kinds]))
    lines.append(",".join(["", head[1], *names]))
    lines.append(
        ",".join(["", "ID" if labels else "", *(f'"{k:032X}"' for k in range(len(names)))])
    )
    if labels:
        lines.append(",".join(["", "Parent", *("" for _ in names)]))
    lines.append(",".join(["", "", *parts]))
    lines.append(",".join(["Frame", "Time (Seconds)", *last]))
    for frame, (time, row) in enumerate(zip(TIME, table, strict=True)):
        cells = ["" for _ in row] if frame in lost else [f"{number:.9f}" for number in row]
        lines.append(",".join([str(frame), f"{time:.6f}", *cells]))
    return "\n".join(lines) + "\n"


def qualisys(
    *, bodies: tuple[str, ...] = ("puck",), lost: tuple[int, ...] = (), nothing: str = "0.00000"
) -> str:
    """A 6D export: mm and degrees; the rotation matrix column by column; rows end in a tab."""
    named = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    header, data = ["Frame", "Time"], []
    for number, name in enumerate(bodies):
        header += [f"{name} X", *named[1:]]
        matrices = ROTATION.as_matrix().transpose(0, 2, 1).reshape(N, 9)
        position = np.column_stack([POSES[:, 0] + number, POSES[:, 1], HEIGHT]) * 1000
        angles = ROTATION.as_euler("XYZ", degrees=True)
        data += [position, angles, np.full((N, 1), 0.2), matrices]
    lines = [
        f"NO_OF_FRAMES\t{N}",
        "NO_OF_CAMERAS\t8",
        f"NO_OF_BODIES\t{len(bodies)}",
        "FREQUENCY\t100",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2024-03-05, 16:12:50\t22107.99179716",
        "DATA_INCLUDED\t6D",
        "\t".join(["BODY_NAMES", *bodies]),
        "\t".join([*header, ""]),
    ]
    for frame, row in enumerate(np.hstack(data)):
        cells = [nothing] * len(row) if frame in lost else [f"{number:.5f}" for number in row]
        lines.append("\t".join([str(frame + 1), f"{TIME[frame]:.5f}", *cells, ""]))
    return "\r\n".join(lines) + "\r\n"


def read(folder: Path, name: str, text: str, command: CommandMapping = COMMAND, **pose):
    (folder / name).write_bytes(text.encode("utf-8-sig" if name.endswith("csv") else "utf-8"))
    (folder / "motors.csv").write_text(COMMANDS)
    return read_recording(
        folder, mapping=RecordingMapping(pose=PoseMapping(**pose), command=command)
    )


def assert_is_the_motion(recording, *, kept=slice(None), shift: float = 0.0, off: float = 1e-8):
    pose = recording["pose"]
    np.testing.assert_allclose(pose.values[:, 0], POSES[kept, 0] + shift, atol=off)
    np.testing.assert_allclose(pose.values[:, 1], POSES[kept, 1], atol=off)
    turned = np.angle(np.exp(1j * (pose.values[:, 2] - POSES[kept, 2])))
    assert np.abs(turned).max() < max(off, 1e-7)
    assert np.abs(pose.stamp_ns - 1e9 * TIME[kept]).max() < 600
    assert len(recording["command"]) == N


@pytest.mark.parametrize("labels", [False, True])
@pytest.mark.parametrize("unit", ["Meters", "Centimeters", "Millimeters"])
def test_a_motive_export_is_read(tmp_path: Path, unit: str, labels: bool):
    found = read(tmp_path, "take.csv", motive(unit=unit, labels=labels))
    assert_is_the_motion(found)
    assert found.warnings == ()
    assert set(found.hashes) == {"take.csv", "motors.csv"}


@pytest.mark.parametrize("order", ["".join(order) for order in permutations("XYZ")])
def test_a_motive_export_with_euler_angles_is_read(tmp_path: Path, order: str):
    assert_is_the_motion(read(tmp_path, "take.csv", motive(rotation=order)), off=1e-7)


def test_frames_without_the_body_are_skipped(tmp_path: Path):
    lost = (0, 7, 8, 39)
    kept = np.delete(np.arange(N), lost)
    found = read(tmp_path, "take.csv", motive(lost=lost))
    assert_is_the_motion(found, kept=kept)
    assert found.warnings == ("blank poses left out: 4",)
    (tmp_path / "take.csv").unlink()
    # Five digits of a rotation matrix.
    assert_is_the_motion(read(tmp_path, "take.tsv", qualisys()), off=2e-5)
    for nothing in ("0.00000", "", "NULL"):
        found = read(tmp_path, "take.tsv", qualisys(lost=lost, nothing=nothing))
        assert_is_the_motion(found, kept=kept, off=2e-5)
        assert found.warnings == ("blank poses left out: 4",)


@pytest.mark.parametrize(("name", "write"), [("take.csv", motive), ("take_6D.tsv", qualisys)])
def test_several_rigid_bodies_are_named(tmp_path: Path, name: str, write):
    text = write(bodies=("puck", "mallet", "corner"))
    with rejected(
        "contains the rigid bodies puck, mallet, corner; choose one", 'pose = {body = "puck"}'
    ):
        read(tmp_path, name, text)
    assert_is_the_motion(read(tmp_path, name, text, body="mallet"), shift=1.0, off=2e-5)
    with pytest.raises(InputError, match=r"pose\.body: contains the rigid bodies puck, mallet"):
        read(tmp_path, name, text, body="rink")


def test_the_mapping_overrides_the_export(tmp_path: Path):
    # Exported with z up, which is an option; Motive's header does not state it.
    keys = {"axes": "Z-up", "units": ("cm",), "start_s": 5.0}
    found = read(tmp_path, "take.csv", motive(unit="Meters"), **keys)
    pose = found["pose"]
    np.testing.assert_allclose(pose.values[:, 0], POSES[:, 0] / 100, atol=1e-9)
    np.testing.assert_allclose(pose.values[:, 1], HEIGHT / 100, atol=1e-9)
    assert pose.stamp_ns[0] == 5 * 10**9


def test_the_export_file_itself_may_be_given(tmp_path: Path):
    (tmp_path / "take.csv").write_text(motive())
    (tmp_path / "motors.csv").write_text(COMMANDS)
    found = read_recording(tmp_path / "take.csv", mapping=RecordingMapping(command=COMMAND))
    assert_is_the_motion(found)
    with pytest.raises(InputError, match="contains only poses; name the file of the commands"):
        read_recording(tmp_path / "take.csv")


def cut(text: str, line: int) -> str:
    return "\n".join(text.splitlines()[:line]) + "\n"


def test_an_incomplete_last_line_is_ignored(tmp_path: Path):
    found = read(tmp_path, "take.csv", motive()[:-30])
    assert_is_the_motion(found, kept=np.arange(N - 1))
    assert "cut short" in found.warnings[0]


@pytest.mark.parametrize("write", [motive, qualisys])
def test_damaged_exports_are_read_or_rejected_in_one_line(tmp_path: Path, write):
    text = write()
    rng = np.random.default_rng(4)
    for _ in range(150):
        broken = list(text)
        for place in rng.integers(0, len(text), 3):
            broken[place] = rng.choice(list('",\t\n;0eX-'))
        try:
            read(tmp_path, "take.csv", "".join(broken[: rng.integers(1, len(text))]))
        except InputError as error:
            assert "\n" not in str(error)


def vicon(
    *,
    title: str = "Objects",
    unit: tuple[str, str] = ("rad", "mm"),
    bodies: tuple[str, ...] = ("puck",),
    quaternion: bool = False,
    one_title: bool = False,
    lost: tuple[int, ...] = (),
) -> str:
    """The export of bodies that move alike, each 1 m further along x."""
    turned = ROTATION.as_quat() if quaternion else ROTATION.as_rotvec(degrees=unit[0] == "deg")
    axes = ["RX", "RY", "RZ", "RW"][: turned.shape[1]]
    size = {"mm": 1000, "cm": 100, "m": 1}[unit[1]]
    titles, names, units, data = ["", ""], ["Frame", "Sub Frame"], ["", ""], []
    for number, body in enumerate(bodies):
        both = f"{body}:{body}"
        first = both if one_title else f"Global Angle {both}"
        titles += [first] + [""] * (len(axes) - 1)
        titles += ["" if one_title else f"Global Translation {both}", "", ""]
        names += [*axes, "TX", "TY", "TZ"]
        units += [unit[0]] * len(axes) + [unit[1]] * 3
        position = np.column_stack([POSES[:, 0] + number, POSES[:, 1], HEIGHT]) * size
        data += [turned, position]
    lines = [title, "100", *map(",".join, (titles, names, units))]
    for k, row in enumerate(np.hstack(data)):
        cells = [""] * len(row) if k in lost else [f"{value:.9f}" for value in row]
        lines.append(",".join([str(k + 1), "0", *cells]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("made", "pose"),
    [
        ({}, {}),
        ({"title": "Segments", "unit": ("deg", "m")}, {}),
        ({"quaternion": True, "one_title": True}, {}),
        ({"bodies": ("puck", "wand")}, {"body": "puck"}),
        ({"bodies": ("wand", "puck"), "one_title": True}, {"body": "puck", "origin_m": (1, 0)}),
    ],
)
def test_vicon_exports_are_read(tmp_path: Path, made, pose):
    poses = read(tmp_path, "take.csv", vicon(**made), **pose)["pose"]
    assert poses.stamp_ns.tolist() == np.round(1e9 * TIME).astype(int).tolist()
    assert poses.values == pytest.approx(POSES, abs=1e-6)


def test_other_sections_of_a_vicon_export_are_ignored(tmp_path: Path):
    more = "\nTrajectories\n100\n,,puck:one,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,1,2,3\n"
    recording = read(tmp_path, "take.csv", vicon(lost=(3, 4)) + more)
    assert recording["pose"].values == pytest.approx(np.delete(POSES, [3, 4], axis=0), abs=1e-6)
    assert recording.warnings == ("blank poses left out: 2",)


def test_large_rotations_in_a_vicon_export_keep_their_order(tmp_path: Path):
    tilted = vicon().replace("RX", "RU").replace("RZ", "RX").replace("RU", "RZ")
    poses = read(tmp_path, "take.csv", tilted)["pose"].values
    vectors = ROTATION.as_rotvec()[:, ::-1]
    yaw = Rotation.from_rotvec(vectors).as_euler("ZYX")[:, 0]
    assert poses[:, 2] == pytest.approx(yaw, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "pose", "says"),
    [
        (cut(motive(), 1), {}, "has no row Frame, Time"),
        (cut(motive(), 5), {}, "has no row Frame, Time"),
        (cut(qualisys(), 8), {}, "has no row Frame, Time"),
        (motive(types=("Bone", "Marker")), {}, "contains no rigid body"),
        (
            motive().replace("Length Units,Millimeters", "Length Units,Feet"),
            {},
            "is Feet, not one of",
        ),
        (motive().replace("Length Units,Millimeters,", ""), {}, "Length Units: is missing"),
        (motive(rotation="XYZ").replace("Type,XYZ", "Type,ABC"), {}, "has no rotation type"),
        (motive().replace("Position", "Place"), {}, "has no column Position X, Position Y"),
        (qualisys().replace("Rot[8]", "Rot[9]"), {}, r"has no column Rot\[8\]"),
        (qualisys().replace("puck X", "puck"), {}, "contains no rigid body"),
        (motive().replace("0.100000,", "soon,"), {}, "line 18: 'soon' is not a number"),
        (motive() + "40,0.4,1,2\n", {}, "line 48 has 4 fields"),
        (vicon(bodies=("puck", "wand")), {}, "contains the rigid bodies puck, wand; choose one"),
        (vicon(), {"body": "wand"}, r"pose\.body: contains the rigid bodies puck"),
        (vicon(), {"time": "Frame"}, "is a Vicon export, whose rate gives the times"),
        (vicon().replace("\n100\n", "\nfast\n"), {}, "is a Vicon export without its rate"),
        (vicon().replace("TX", "UX"), {}, "has no column TX"),
        (vicon().replace("RY", "UY"), {}, "has no column RY"),
        (vicon(quaternion=True).replace("RW,", "").replace("RY", "UY"), {}, "has no column RY"),
        (vicon().replace("rad,mm,mm,mm", "rad"), {}, "is a Vicon export without the units"),
        (vicon().replace("Sub Frame", "Part"), {}, "has no row Frame, Sub Frame"),
        ("Objects\n", {}, "has no row Frame, Sub Frame"),
    ],
)
def test_errors_end_in_one_line(tmp_path: Path, text: str, pose, says: str):
    with rejected(str(tmp_path / "take.csv"), match=says):
        read(tmp_path, "take.csv", text, **pose)
