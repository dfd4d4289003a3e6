"""TOML files and atomic replacement."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import (
    Fraction,
    Section,
    load_json,
    load_toml,
    load_yaml,
    read_toml,
    write_toml,
)
from airpuck.boundary.limits import (
    CELLS,
    COLUMNS,
    DEPTH,
    KEYS,
    ROW_LENGTH,
    TEXT_BYTES,
    VALUES,
    csv_rows,
    sha256,
)
from airpuck.boundary.outputs import replacing
from airpuck.recording.read import read_recording

from ..apparatus.bags import rosbags_folder
from ..apparatus.refusals import refusal, rejected, written


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 100_000, "nested"),
        ("a = " + "[" * (DEPTH + 1) + "]" * (DEPTH + 1), "nested"),
        ("a = " + "{b=" * 3000 + "1" + "}" * 3000, "nested"),
        (".".join("a" * 50_000) + " = 1", "nested"),
        ("[" + ".".join(["a"] * 50_000) + "]", "nested"),
        ('"a" . ' * 1000 + "b = 1", "nested"),
        ("".join(f"k{i} = 1\n" for i in range(KEYS + 1)), "keys"),
        ("".join(f"[t{i}]\n" for i in range(KEYS + 2)), "keys"),
        ("a = [" + "1," * (VALUES + 1) + "]", "values"),
        ("a = " + "9" * 5000, "digits"),
        ("a = " + "9" * 4000, "64 bits"),
        ("a = 0x" + "f" * 17, "64 bits"),
        ("#" * (TEXT_BYTES + 1), "too long"),
        ("'" * 999_999, "not valid TOML"),
        ('"""' * 300_000, "not valid TOML"),
        ("a" * 1_000_000, "not valid TOML"),
        ('a = "\x1b[2J"', "not valid TOML"),
        (b"\xff\xfe\x00", "is not UTF-8 text .*; save it as UTF-8"),
    ],
    ids=lambda value: f"{value[:20]!r}" if len(value) < 40 else f"{value[:10]!r}-{len(value)}",
)
def test_hostile_toml_is_rejected(tmp_path: Path, text: str | bytes, says: str):
    refusal(load_toml, written(tmp_path, text), says=says)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a":' * 100_000, "nested"),
        ('{"a":' + "[" * 500 + "]" * 500 + "}", "nested"),
        ('{"a": ' + "9" * 5000 + "}", "digits"),
        ("{" + ",".join(f'"{i}": 1' for i in range(KEYS + 1)) + "}", "keys"),
        ("[1]", "object"),
        ("\xff", "not valid JSON"),
    ],
)
def test_hostile_json_is_rejected(tmp_path: Path, text: str, says: str):
    refusal(load_json, written(tmp_path, text, "a.json"), says=says)


#: Each line repeats the one above three times.
REPEATED = "".join(f"a{i + 1}: &a{i + 1} [*a{i}, *a{i}, *a{i}]\n" for i in range(25))
MERGED = "".join(f"k{i}: &k{i} {{<<: [*a, *a]}}\n" for i in range(9))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: b\n" * 4_000_000, "too long"),
        ("[" * 2_000, "nested"),
        ("a: &a [1,1]\n" + MERGED, "merges"),
        ("a0: &a0 [1]\n" + REPEATED, "values"),
        ("a: &a [*a]\n", "nested"),
        ("a: " + "9" * 5000, "digits"),
        ("a: !!python/object/apply:os.system [ls]", "not valid YAML"),
    ],
    ids=lambda value: f"{value[:8]!r}-{len(value)}",
)
def test_hostile_yaml_is_rejected(tmp_path: Path, text: str, says: str):
    refusal(load_yaml, written(tmp_path, text, "a.yaml"), says=says)


def test_a_bag_with_a_hostile_summary_can_be_read(tmp_path: Path):
    rosbags_folder(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text("a: b\n" * 4_000_000)
    assert len(read_recording(tmp_path / "bag")["pose"]) == 5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (",".join(map(str, range(COLUMNS + 1))) + "\n", "columns"),
        ("a," * 1_000_000 + "\n", "too long a line"),
        ("a" * (ROW_LENGTH + 1), "too long a line"),
        ('"\n",' * (ROW_LENGTH // 3), "too long a line"),
        ('a\n"' + "x\n" * 200_000, "field larger"),
        (b"a,b\n\xff\xfe\n", "not UTF-8 text"),
    ],
    ids=lambda value: f"{value[:5]!r}-{len(value)}",
)
def test_hostile_tables_are_rejected(tmp_path: Path, text: str | bytes, says: str):
    path = written(tmp_path, text, "a.csv")
    refusal(lambda path: list(csv_rows(path)), path, says=says)


def test_a_table_with_too_many_cells_is_rejected(tmp_path: Path):
    row = "1," * (COLUMNS - 1) + "1\n"
    path = written(tmp_path, row * (CELLS // COLUMNS + 1), "a.csv")
    refusal(lambda path: sum(1 for _ in csv_rows(path)), path, says="cells")


@pytest.mark.parametrize("read", [load_toml, load_json, load_yaml])
def test_an_endless_device_is_rejected(read):
    refusal(read, Path("/dev/zero"), says="too long")


#: Runs in a separate process: the tests' own may have allocated and freed any amount before.
NO_MEMORY = """
import sys
from pathlib import Path
from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import MIB
from airpuck.recording.read import read_recording
from tests.apparatus.refusals import little_memory

with little_memory(20 * MIB):
    try:
        read_recording(Path(sys.argv[1]))
    except InputError as error:
        print(error)
"""


def test_running_out_of_memory_ends_in_one_line(tmp_path: Path):
    # Use long numbers: for short ones the allocator keeps finding gaps, slowly, for minutes.
    written(tmp_path, "a,b\n" + f"{'1' * 3000},2\n" * 16_000, "control.csv")
    command = [sys.executable, "-c", NO_MEMORY, str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert "needs more memory" in said
    assert str(tmp_path) in said
    assert said.count("\n") == 1


class Example(Section):
    mass_kg: float
    rows: tuple[tuple[float, ...], ...] = ()
    share: Fraction | tuple[Fraction, ...] = 1.0
    either: tuple[float, ...] | tuple[tuple[float, ...], ...] = ()


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_toml(tmp_path / "none.toml", Example)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass_kg = ", "not valid TOML"),
        ("mass_kg = 'heavy'", "mass_kg: must be a valid number"),
        ("mass_kg = nan", "mass_kg: must be a finite number"),
        ("", "mass_kg: is required"),
        ("mass_kg = 1.0\nmas = 2", "mas: is not a known key"),
        ("mas_kg = 1.0", "mas_kg: is not a known key"),
        ("mass_kg = 1.0\nrows = 2.0", r"rows: must be a list in brackets, \[ \]"),
        ("mass_kg = 1.0\nshare = 2.0", "toml: share: must be less than or equal to 1"),
        ("mass_kg = 1.0\nshare = 'a'", "toml: share: must be a valid number"),
        ("mass_kg = 1.0\neither = 2.0", "toml: either: must be a list in brackets"),
        ("mass_kg = 1.0\nrows = [[1.0], ['x']]", r"rows\.1\.0"),
    ],
)
def test_errors_name_file_and_field(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with rejected(str(path), match=message):
        read_toml(path, Example)


class Nested(Section):
    example: Example
    other: Example = Example(mass_kg=3.0)


def test_an_overlay_changes_only_the_fields_that_it_names(tmp_path):
    path, base = tmp_path / "one.toml", Nested(example=Example(mass_kg=1.0, rows=((1.0,), (2.0,))))
    path.write_text("[example]\nrows = [[3.0]]")
    expected = Example(mass_kg=1.0, rows=((3.0,),))
    assert read_toml(path, Nested, base=base) == base.model_copy(update={"example": expected})
    for text, field in (("[example]\nmass = 1.0", "example.mass"), ("example = 1.0", "example")):
        path.write_text(text)
        with rejected(field=field):
            read_toml(path, Nested, base=base)


@given(st.lists(st.lists(st.floats(-1e15, 1e15), max_size=4), max_size=4))
def test_floats_round_trip_exactly(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("toml") / "example.toml"
    write_toml(path, {"mass_kg": 0.1, "rows": rows}, header="two\nlines")
    content = read_toml(path, Example)
    assert [list(row) for row in content.rows] == rows
    assert all(
        math.copysign(1, a) == math.copysign(1, b)
        for mine, theirs in zip(content.rows, rows, strict=True)
        for a, b in zip(mine, theirs, strict=True)
    )


def test_rows_are_written_one_per_line(tmp_path):
    path = tmp_path / "example.toml"
    write_toml(path, {"rows": [[1.0, 2.0], [3.0, 4.0]], "names": ["a, b", "[c]"]})
    assert "    [1.0, 2.0],\n    [3.0, 4.0],\n" in path.read_text()
    import tomllib

    assert tomllib.loads(path.read_text())["names"] == ["a, b", "[c]"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_created_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"), replacing(tmp_path / "file" / "x"):
        pass


def test_hashes_match_the_example_of_the_standard(tmp_path: Path):
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1.
    assert sha256(tmp_path / "abc") == (
        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    )


def test_hashing_a_folder_or_a_missing_file_raises(tmp_path: Path):
    with pytest.raises(InputError, match="cannot be read"):
        sha256(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        sha256(tmp_path / "nowhere")
