"""The one error that is meant for a user."""

from __future__ import annotations

import os

from airpuck.boundary.terminal import escaped

#: Libraries may repeat a whole file in their messages.
_LONGEST = 2000


class InputError(ValueError):
    """An input cannot be used; the message says what to do about it.

    The command line prints the message as one line and exits with status 2. Any other exception is
    a mistake of this package.

    Parameters
    ----------
    problem : str
        What is wrong and what to do about it, without a final full stop.
    file : path-like, optional
        The file or folder concerned.
    field : str, optional
        The column, key, topic or option concerned.

    Notes
    -----
    All three may hold text from a file. They are kept on one line, and escaped: a name must not be
    able to move the cursor, to colour the terminal or to turn the direction of text.
    """

    def __init__(
        self, problem: str, *, file: str | os.PathLike[str] | None = None, field: str | None = None
    ) -> None:
        self.problem = _shortened(escaped(" ".join(problem.split())))
        self.file = None if file is None else escaped(os.fspath(file))
        self.field = None if field is None else _shortened(escaped(field))
        where = ": ".join(part for part in (self.file, self.field) if part)
        super().__init__(f"{where}: {self.problem}" if where else self.problem)


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
