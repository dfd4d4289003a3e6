"""Files of recordings: hashes, atomically created folders, names in messages."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import check_output, temporary_name, unwritable

_LONGEST = 80


def sha256(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file, which traces results back to their data."""
    try:
        if not stat.S_ISREG(Path(path).stat().st_mode):
            raise InputError("cannot be read (it is not a regular file)", file=path)
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError("there is no such file", file=path) from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read ({reason})", file=path) from error


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary name beside `path`, and rename that folder to `path` on success.

    The folder must be new or empty.
    """
    check_output(path, "new folder")
    target = Path(path).absolute()
    shelter = target.parent / temporary_name(target)
    try:
        shelter.mkdir(parents=True)
        yield shelter / target.name
        (shelter / target.name).rename(target)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        shutil.rmtree(shelter, ignore_errors=True)


def shortened(text: str) -> str:
    """Shorten text from a file for a message; `InputError` escapes it."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def listing(names: Iterable[str], most: int = 12) -> str:
    """List names from a file; beyond `most` they are only counted."""
    shown = [shortened(name) for name in names]
    if len(shown) > most:
        shown[most:] = [f"{len(shown) - most} more"]
    return ", ".join(shown) or "none"


def several_recordings(found: Iterable[Path], folder: Path) -> InputError:
    """Return the error for a folder from which one recording must be chosen."""
    names = listing(path.name for path in found)
    return InputError(f"contains several recordings; choose one of {names}", file=folder)


def chosen_body(
    names: Iterable[str],
    body: str,
    path: str | os.PathLike[str] | None = None,
    stream: str = "pose",
) -> str:
    """Return the rigid body to read: the only one, or the one named in the mapping."""
    found = list(dict.fromkeys(names))
    if body in found:
        return body
    if len(found) == 1 and not body:
        return found[0]
    if not found:
        raise InputError("names no rigid bodies; leave out body", file=path, field=f"{stream}.body")
    raise InputError(
        f"contains the rigid bodies {listing(found)}; choose one in the mapping, as in "
        f'{stream} = {{body = "{shortened(found[0])}"}}',
        file=path,
        field=f"{stream}.body" if body else None,
    )
