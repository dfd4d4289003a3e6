"""Damaged files of every kind are read, or rejected in one line."""

from pathlib import Path

import pytest

from ..apparatus.fuzz import fuzz, kinds, table

KINDS = list(kinds(Path("/")))


def assert_good(cases: int, first: int = 0) -> str:
    tallies = fuzz(KINDS, cases, first)
    failures = [f"{name} {text}" for name, tally in tallies.items() for text in tally.failures]
    assert not failures, "\n".join(failures[:5])
    assert all(sum(tally.outcomes.values()) == cases for tally in tallies.values())
    # If damage were always or never detected, only one path would be tested. Of six kinds
    # one damaged file in twenty can be read.
    assert sum(tally.outcomes["read"] > 0 for tally in tallies.values()) >= len(KINDS) - 6
    assert sum(tally.outcomes["refused"] > 0 for tally in tallies.values()) >= len(KINDS) - 1
    return table(tallies)


@pytest.mark.parametrize("kind", ["mcap", "data.pt"])
def test_damaged_recordings_are_read_or_rejected(kind):
    (tally,) = fuzz([kind], 10).values()
    assert not tally.failures, tally.failures[0]
    assert sum(tally.outcomes.values()) == 10


@pytest.mark.slow
def test_damaged_files_are_read_or_rejected():
    assert_good(30)


@pytest.mark.study
def test_a_hundred_thousand_damaged_files_are_read_or_rejected():
    print(assert_good(100_000 // len(KINDS) + 1, first=1000))
