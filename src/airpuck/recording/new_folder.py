"""A folder that is either there whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from airpuck.boundary.errors import InputError


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary name beside `path`, and move that folder there when the block ends well."""
    target = Path(path).absolute()
    if target.exists() or target.is_symlink():
        raise InputError("exists already; give another name or remove it", file=path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shelter = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=path) from error
    try:
        yield shelter / target.name
        (shelter / target.name).rename(target)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=path) from error
    finally:
        shutil.rmtree(shelter, ignore_errors=True)
