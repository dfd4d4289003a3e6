"""Names out of a file, fit to be shown in an error's one line."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

_LONGEST = 80


def one_line(text: str) -> str:
    """Return a text from a file such that it stays on one line, and short."""
    short = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    return short if short.isprintable() else repr(short)


def listing(names: Iterable[str], most: int = 12) -> str:
    """List names from a file."""
    rest = iter(names)
    shown = [one_line(name) for name in islice(rest, most)]
    more = sum(1 for _ in rest)
    return ", ".join([*shown, f"{more} more"] if more else shown) or "none"
