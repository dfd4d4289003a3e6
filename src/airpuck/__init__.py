"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

Data flow::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Public names are imported on first use, so that ``import airpuck`` is fast.
"""

from __future__ import annotations

from airpuck.boundary.public import public_names

_public, __dir__ = public_names(__name__, __file__, checked=True)


def __getattr__(name: str) -> object:
    """Import a public name at its first use (PEP 562)."""
    if name == "__version__":
        return _version()
    if name == "export":
        from importlib import import_module

        return import_module("airpuck.export")
    try:
        return _public(name)
    except AttributeError:
        if name.startswith("__"):
            raise
        from airpuck.boundary.extensions import moved

        return moved(name)


def _version() -> str:
    """Return the installed version, which comes from the tag."""
    from importlib import metadata  # takes as long to import as the rest of this module

    try:
        return metadata.version("airpuck")
    except metadata.PackageNotFoundError:
        return "0+unknown"
