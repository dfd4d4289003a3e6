"""Messages about hostile names and texts can be printed."""

import os

import pytest

from airpuck.boundary.errors import InputError, escaped


@pytest.mark.parametrize("name", ["\x1b[2J\x1b[31mred", "a\nb", "\u202eevil", "\udcff", "a\x00b"])
def test_errors_contain_printable_characters_only(name: str):
    error = InputError(f"has {name!s}", file=f"dir/{name}", field=name)
    assert str(error).isprintable()
    assert error.problem.isprintable()
    os.write(os.open(os.devnull, os.O_WRONLY), str(error).encode())


def test_only_unprintable_characters_are_escaped():
    assert escaped("γ [m/s²], 日本 ✓") == "γ [m/s²], 日本 ✓"
    assert escaped("\x1b[1m\tx\n") == r"\x1b[1m\tx\n"
    assert str(InputError("has a\n  line", file="a b")) == "a b: has a line"
    assert len(str(InputError("x" * 10**6, field="y" * 10**6))) < 5000
