"""TOML files and atomic replacement."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Fraction, Section, read_toml, write_toml
from airpuck.boundary.outputs import replacing


class Example(Section):
    mass_kg: float
    rows: tuple[tuple[float, ...], ...] = ()
    share: Fraction | tuple[Fraction, ...] = 1.0
    either: tuple[float, ...] | tuple[tuple[float, ...], ...] = ()


def test_missing_file(tmp_path):
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
    with pytest.raises(InputError, match=message) as error:
        read_toml(path, Example)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


class Nested(Section):
    example: Example
    other: Example = Example(mass_kg=3.0)


def test_a_file_laid_over_a_base_changes_what_it_names(tmp_path):
    path, base = tmp_path / "one.toml", Nested(example=Example(mass_kg=1.0, rows=((1.0,), (2.0,))))
    path.write_text("[example]\nrows = [[3.0]]")
    expected = Example(mass_kg=1.0, rows=((3.0,),))
    assert read_toml(path, Nested, base=base) == base.model_copy(update={"example": expected})
    for text, field in (("[example]\nmass = 1.0", "example.mass"), ("example = 1.0", "example")):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_toml(path, Nested, base=base)
        assert caught.value.field == field


def test_not_text(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"is not UTF-8 text .*; save it as UTF-8"):
        read_toml(path, Example)


@given(st.lists(st.lists(st.floats(-1e15, 1e15), max_size=4), max_size=4))
def test_floats_read_back_bit_equal(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("toml") / "example.toml"
    write_toml(path, {"mass_kg": 0.1, "rows": rows}, header="two\nlines")
    content = read_toml(path, Example)
    assert [list(row) for row in content.rows] == rows
    assert all(
        math.copysign(1, a) == math.copysign(1, b)
        for mine, theirs in zip(content.rows, rows, strict=True)
        for a, b in zip(mine, theirs, strict=True)
    )


def test_rows_are_written_as_rows(tmp_path):
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


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"), replacing(tmp_path / "file" / "x"):
        pass
