"""The one error that is meant for a user."""

from __future__ import annotations

import os


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
    """

    def __init__(
        self, problem: str, *, file: str | os.PathLike[str] | None = None, field: str | None = None
    ) -> None:
        self.problem = problem
        self.file = None if file is None else os.fspath(file)
        self.field = field
        where = ": ".join(part for part in (self.file, field) if part)
        super().__init__(f"{where}: {problem}" if where else problem)
