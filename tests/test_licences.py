"""The repository holds only what the project wrote itself."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OURS = "the airpuck authors"
#: A line that claims a copyright: the word or sign, and a year; or who holds it.
CLAIM = re.compile(
    r"(?i)(copyright|©|\(c\)).{0,20}\b(19|20)\d\d\b"
    r"|\bcopyright\s*(\(c\)|©)|©\s*\w|SPDX-FileCopyrightText|all rights reserved"
)


def claims(text: str) -> list[str]:
    """Return the lines that claim somebody else's copyright."""
    return [line for line in text.splitlines() if CLAIM.search(line) and OURS not in line]


@pytest.mark.parametrize(
    "line",
    [
        "Copyright (c) 2022 Jane Doe",
        " * Copyright 2012-2023 Some Association",
        "(C) 1999 Jane Doe",
        "/* © Jane Doe */",
        "Copyright © Jane Doe",
        "// SPDX-FileCopyrightText: Jane Doe",
        "All rights reserved.",
    ],
)
def test_copyright_lines_are_recognised(line):
    assert claims(line) == [line]


def test_no_file_contains_a_foreign_copyright():
    words = ["git", "ls-files", "-z"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("needs the git repository")
    names = [name for name in listed.stdout.split("\0") if name]
    assert "LICENSE" in names
    found = {}
    for name in names:
        path = ROOT / name
        if path == Path(__file__) or not path.is_file():
            continue
        content = path.read_bytes()
        binary = b"\0" in content
        if not binary and (lines := claims(content.decode("utf-8", errors="replace"))):
            found[name] = lines
    assert not found
