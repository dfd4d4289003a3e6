"""Hostile texts: TOML, JSON, YAML and tables."""

import subprocess
import sys
from pathlib import Path

import pytest

from airpuck.boundary.limits import (
    CELLS,
    COLUMNS,
    DEPTH,
    KEYS,
    ROW_LENGTH,
    TEXT_BYTES,
    VALUES,
    csv_rows,
)
from airpuck.boundary.parsing import load_json, load_toml, load_yaml
from airpuck.recording.read import read_recording

from ..apparatus.bags import rosbags_folder
from ..apparatus.refusals import refusal, written


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
    ],
    ids=lambda value: value[:20] if len(value) < 30 else f"{value[:10]}-{len(value)}",
)
def test_hostile_toml(tmp_path: Path, text: str, says: str):
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
def test_hostile_json(tmp_path: Path, text: str, says: str):
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
def test_hostile_yaml(tmp_path: Path, text: str, says: str):
    refusal(load_yaml, written(tmp_path, text, "a.yaml"), says=says)


def test_a_hostile_summary_does_not_keep_a_bag_from_being_read(tmp_path: Path):
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
def test_hostile_tables(tmp_path: Path, text: str | bytes, says: str):
    path = written(tmp_path, text, "a.csv")
    refusal(lambda path: list(csv_rows(path)), path, says=says)


def test_a_table_of_very_many_cells(tmp_path: Path):
    row = "1," * (COLUMNS - 1) + "1\n"
    path = written(tmp_path, row * (CELLS // COLUMNS + 1), "a.csv")
    refusal(lambda path: sum(1 for _ in csv_rows(path)), path, says="cells")


@pytest.mark.parametrize("read", [load_toml, load_json, load_yaml])
def test_an_endless_device(read):
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


def test_running_out_of_memory_is_one_line(tmp_path: Path):
    # Use long numbers: for short ones the allocator keeps finding gaps, slowly, for minutes.
    written(tmp_path, "a,b\n" + f"{'1' * 3000},2\n" * 16_000, "control.csv")
    command = [sys.executable, "-c", NO_MEMORY, str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert "needs more memory" in said
    assert str(tmp_path) in said
    assert said.count("\n") == 1
