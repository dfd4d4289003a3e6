"""Escaping of text from files and names before it reaches a terminal."""

from __future__ import annotations


def escaped(text: str) -> str:
    r"""Write control characters as \x1b: names in files and on the graph are untrusted.

    A terminal obeys them. Characters that reverse or hide others, invalid characters and line
    breaks are escaped as well, since a name must not begin a new line.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
