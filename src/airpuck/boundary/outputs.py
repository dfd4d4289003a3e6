"""Output files and folders: checked before the work begins, made from templates, replaced."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from airpuck.boundary.errors import InputError

#: Kinds of requested outputs. A new folder may exist if it is empty.
Output = Literal["file", "folder", "new folder"]


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it if the block succeeds.

    If the block fails or is interrupted, an existing file does not change.

    Parameters
    ----------
    path : path-like
        The final name.

    Yields
    ------
    Path
        The temporary name to write to; it has the same suffix.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    target = Path(path)
    temporary = target.parent / temporary_name(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def temporary_name(target: Path) -> str:
    """Return a temporary name for a file or folder, with its suffix.

    The name is known before the file exists, so no interruption can leave one behind. It is shorter
    than the system's limit, whatever the final name.
    """
    return f".{target.stem[:20]}-{os.urandom(4).hex()}{target.suffix}"


def without_home(text: str) -> str:
    """Replace the user's home folder by ~ in a path or an option, since it is private."""
    # Path.home() raises if there is no home. A user without an account has the root folder.
    home = os.path.expanduser("~").rstrip("/")  # noqa: PTH111
    return re.sub(f"(?<![^=]){re.escape(home)}(?=/|$)", "~", text) if home[:1] == "/" else text


def unwritable(path: str | os.PathLike[str], error: OSError) -> InputError:
    """Return the error for a failed write, such as on a full disk."""
    return InputError(f"cannot be written ({error.strerror or error})", file=path)


def check_output(
    path: str | os.PathLike[str], kind: Output = "file", *, field: str | None = None
) -> None:
    """Raise InputError before the work begins if a path cannot be written to."""
    target = Path(path).absolute()
    try:
        problem = _problem(target, kind)
    except OSError as error:
        problem = f"cannot be written ({error.strerror}); choose another place"
    if problem is not None:
        raise InputError(problem, file=path, field=field)


def _problem(target: Path, kind: Output) -> str | None:
    """Return why this kind of output cannot be written here, or None; may raise OSError."""
    there = next(folder for folder in (target, *target.parents) if os.path.lexists(folder))
    longest = os.pathconf(there if there.is_dir() else there.parent, "PC_NAME_MAX")
    if max(len(os.fsencode(part)) for part in target.parts) > longest:
        return f"has a name of more than {longest} bytes, the longest that the system allows"
    if os.path.realpath(target) == target.anchor:
        return "is the root folder; name a folder in it"
    if there == target:
        mode = target.lstat().st_mode if kind == "new folder" else target.stat().st_mode
        if kind == "new folder" and not (stat.S_ISDIR(mode) and not any(target.iterdir())):
            return "exists already; choose a new folder"
        if kind == "file" and stat.S_ISDIR(mode):
            return "is a folder; choose a file name"
        if kind == "file" and not stat.S_ISREG(mode):
            return "is not an ordinary file; choose another place"
        if kind == "file" and not os.access(target, os.W_OK):
            return "is write-protected; choose another place"
        if kind == "folder" and not stat.S_ISDIR(mode):
            return "is a file; choose a folder"
    with tempfile.TemporaryFile(dir=there.parent if there == target and kind == "file" else there):
        return None


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


def packaged_text(name: str) -> str:
    """Read a text file of the package."""
    return (resources.files("airpuck") / "packaged" / name).read_text("utf-8")


def rendered(template: str, **values: Any) -> str:
    """Fill in a template of the package for HTML, SVG or XML; values are escaped."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(packaged_text(template)).render(**values)
