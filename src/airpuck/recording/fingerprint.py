"""The fingerprint of a file, by which results are traced back to their data."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from airpuck.boundary.errors import InputError


def sha256(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file's content."""
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError("there is no such file", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
