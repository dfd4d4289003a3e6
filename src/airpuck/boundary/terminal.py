"""Text from files and names on its way to a terminal."""

from __future__ import annotations

import unicodedata

#: Line and paragraph separators break a line, too.
_BREAKS = ("Zl", "Zp")


def escaped(text: str) -> str:
    r"""Write control characters as \x1b: names in files and on the graph are not ours.

    A terminal obeys them. The same holds for characters that reverse or hide others, for what is no
    character, and for line breaks, since a name should not begin a line of its own.
    """
    return text if text.isascii() and text.isprintable() else "".join(map(_escaped, text))


def _escaped(character: str) -> str:
    category = unicodedata.category(character)
    unsafe = category.startswith("C") or category in _BREAKS
    return character.encode("unicode_escape").decode() if unsafe else character
