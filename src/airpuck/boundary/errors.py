"""The one error class intended for users, texts for unknown names, and escaping for terminals."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial
from typing import Any

#: Libraries may repeat a whole file in their messages.
_LONGEST = 2000
#: Number of names that are listed.
_LISTED = 12
#: Number of characters shown of a name that is too long.
_SHOWN = 60
#: Former names of arguments.
_FORMER = {"regulator": "law"}


class InputError(ValueError):
    """An input cannot be used; the message says how to fix it.

    The command line prints the message as one line and exits with status 2. Any other exception is
    a bug in this package.

    Parameters
    ----------
    problem : str
        The problem and its remedy, without a final full stop.
    file : path-like, optional
        The file or folder concerned.
    field : str, optional
        The column, key, topic or option concerned.

    Notes
    -----
    All three may contain text from a file. They are put on one line and escaped: a name must not
    move the cursor, colour the terminal or reverse the direction of text.

    Examples
    --------
    >>> try:
    ...     airpuck.read_model("model.txt")
    ... except airpuck.InputError as error:
    ...     print(error)
    model.txt: there is no such file
    """

    def __init__(
        self, problem: str, *, file: str | os.PathLike[str] | None = None, field: str | None = None
    ) -> None:
        self.problem = shortened(escaped(" ".join(problem.split())), _LONGEST)
        self.file = None if file is None else escaped(os.fspath(file))
        self.field = None if field is None else shortened(escaped(field), _LONGEST)
        where = ": ".join(part for part in (self.file, self.field) if part)
        super().__init__(f"{where}: {self.problem}" if where else self.problem)


@contextmanager
def about(
    file: str | os.PathLike[str] | None, field: str | Callable[[str], str] | None = None
) -> Iterator[None]:
    """Add the file, if it is known, to an InputError, and the field as the user calls it.

    `field` is the user's name for it, or a function from the error's name to the user's.
    """
    try:
        yield
    except InputError as error:
        named = (field(error.field or "") if callable(field) else field) or error.field
        raise InputError(error.problem, file=error.file or file, field=named) from error


@contextmanager
def explained(
    kinds: type[Exception] | tuple[type[Exception], ...],
    problem: str,
    *,
    file: str | os.PathLike[str] | None = None,
    field: str | None = None,
) -> Iterator[None]:
    """Turn errors of these kinds into an InputError, and let an InputError pass.

    ``{error}`` in `problem` stands for the error; for one of the operating system, for its reason.
    """
    try:
        yield
    except InputError:
        raise
    except kinds as error:
        reason = str(getattr(error, "strerror", None) or error)
        raise InputError(problem.replace("{error}", reason), file=file, field=field) from error


#: Imports what may not be installed; raises InputError, which says how to install it.
installed = partial(explained, ImportError)


def shortened(text: str, most: int = 80) -> str:
    """Shorten text from a file for a message; `InputError` escapes it."""
    return text if len(text) <= most else f"{text[:most]}..."


def listing(names: Iterable[str]) -> str:
    """List names from a file; beyond twelve they are only counted."""
    shown = [shortened(name) for name in names]
    if len(shown) > _LISTED:
        shown[_LISTED:] = [f"{len(shown) - _LISTED} more"]
    return ", ".join(shown) or "none"


def escaped(text: str) -> str:
    r"""Write control characters as \x1b: names in files and on the graph are untrusted.

    A terminal obeys them. Characters that reverse or hide others, invalid characters and line
    breaks are escaped as well, since a name must not begin a new line.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def unknown(name: Any, known: Iterable[Any]) -> str:
    """Return an error text for an unknown name: the known names, and the nearest of them."""
    names, shown = list(known), repr(name)
    shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}…"
    return f"must be {either(map(repr, names))}, not {shown}{nearest(name, names)}"


def nearest(name: Any, known: Iterable[Any]) -> str:
    """Return the end of an error text that suggests the nearest name; empty if none is near."""
    now = _FORMER.get(name, name) if isinstance(name, str) else ()
    near = get_close_matches(repr(now), map(repr, known), 1)
    return f"; did you mean {near[0]}?" if near else ""


def check_known(name: Any, known: Collection[Any], problem: str, **place: Any) -> None:
    """Raise InputError with the nearest known name, unless the name is known."""
    if name not in known:
        raise InputError(problem + nearest(name, known), **place)


def either(words: Iterable[str]) -> str:
    """Join alternatives: 1, 2 or 3."""
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last
