"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

Data flow::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Public names are imported on first use, so that ``import airpuck`` is fast.
"""

from __future__ import annotations

import ast
import importlib
import inspect
from pathlib import Path
from typing import Any

#: Public name -> its module, as the stub file declares them for type checkers.
_HOME = {
    alias.name: statement.module
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    if isinstance(statement, ast.ImportFrom) and statement.module
    for alias in statement.names
}
__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use (PEP 562)."""
    if name == "plot":  # a module is not an attribute of its package before it is imported
        return importlib.import_module("airpuck.report.plot")
    if name == "export":
        return importlib.import_module("airpuck.export")
    if name == "__version__":
        return _version()
    if name in _HOME:
        public = getattr(importlib.import_module(_HOME[name]), name)
        if inspect.isfunction(public):
            from airpuck.boundary.arguments import checked

            public = checked(public)
        globals()[name] = public
        return public
    raise AttributeError(f"module 'airpuck' has no attribute {name!r}")


def _version() -> str:
    """Return the installed version, which comes from the tag."""
    from importlib import metadata  # takes as long to import as the rest of this module

    try:
        return metadata.version("airpuck")
    except metadata.PackageNotFoundError:
        return "0+unknown"


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(_HOME)
