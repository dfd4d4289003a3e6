"""Text from files and names on its way to a terminal."""

from __future__ import annotations


def escaped(text: str) -> str:
    r"""Write control characters as \x1b: names in files and on the graph are not ours.

    A terminal obeys them. Characters that reverse or hide others, invalid characters and line
    breaks are escaped as well, since a name should not begin a line of its own.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
