"""Caches expensive objects once per session, for all workers."""

import fcntl
import functools
import hashlib
import pickle
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import ParamSpec, TypeVar

P, T = ParamSpec("P"), TypeVar("T")

#: Folder of this session, the same for all its workers; without one each process makes its own.
folder: Path | None = None


def once(make: Callable[P, T]) -> Callable[P, T]:
    """Cache the results of a function: in memory, and in a file for other workers.

    The first worker that needs a result computes it; others wait for the file.
    """

    @functools.cache
    @functools.wraps(make)
    def kept(*arguments: Hashable, **named: Hashable) -> T:
        if folder is None:
            return make(*arguments, **named)  # pyright: ignore
        asked = f"{make.__module__}.{make.__qualname__}{arguments!r}{named!r}"
        file = folder / f"{hashlib.sha256(asked.encode()).hexdigest()}.pickle"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not file.exists():
                made = make(*arguments, **named)  # pyright: ignore
                file.write_bytes(pickle.dumps(made))
                return made
        return pickle.loads(file.read_bytes())

    return kept  # pyright: ignore
