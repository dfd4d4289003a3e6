"""A class of the user's own, named FILE.py:NAME."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError


def load_class(name: str, option: str) -> Callable[..., Any]:
    """Import a class, or another callable, from a Python file; this runs the file."""
    path, _, attribute = name.rpartition(":")
    file = Path(path)
    if file.suffix != ".py" or not attribute:
        raise InputError("give FILE.py:NAME, such as my_pilot.py:Spring", field=option)
    if not file.is_file():
        raise InputError("there is no such file", file=file, field=option)
    specification = importlib.util.spec_from_file_location(f"user_{file.stem}", file)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    # Dataclasses and pickles of the file look themselves up.
    sys.modules[specification.name] = module
    try:
        specification.loader.exec_module(module)
    # Whatever goes wrong in a user's file is for the user to mend.
    except Exception as error:
        raise InputError(
            f"cannot be imported: {type(error).__name__}: {error}", file=file, field=option
        ) from error
    found = getattr(module, attribute, None)
    if not callable(found):
        raise InputError(f"has no class {attribute!r}", file=file, field=option)
    return found
