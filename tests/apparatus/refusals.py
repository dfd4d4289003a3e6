"""Check that a hostile file is rejected in one line, with little memory and time."""

import contextlib
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError

GIB = 2**30


@contextlib.contextmanager
def little_memory(size: int = GIB) -> Iterator[None]:
    """Limit the additional memory of this process."""
    status = Path("/proc/self/status").read_text()
    used = 1024 * int(status.split("VmData:")[1].split()[0])
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (used + size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def refusal(read, *arguments, says: str, error: type[ValueError] = InputError) -> str:
    """Return the one-line rejection, produced within the resources of a small machine."""
    start = time.process_time()
    with pytest.raises(error, match=says) as caught, little_memory():
        read(*arguments)
    message = str(caught.value)
    assert message.isprintable()
    assert "memory" not in message
    assert time.process_time() - start < 10
    if error is InputError:
        assert str(arguments[0]) in message
    return message


def written(folder: Path, text: str | bytes, name: str = "a.toml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@contextlib.contextmanager
def rejected(*words: object, match: str | None = None, field: object = ...) -> Iterator[None]:
    """Check that an `InputError` has these words, matches the pattern and names the field."""
    with pytest.raises(InputError, match=match) as caught:
        yield
    assert field is ... or caught.value.field == field
    for word in words:
        assert str(word) in str(caught.value)
