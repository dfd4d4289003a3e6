"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

The way of the data::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Public names are imported where they are used, so that ``import airpuck`` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from airpuck.errors import InputError
    from airpuck.recording.stream import Recording, Stream
    from airpuck.trajectory import Span, Trajectory, read_trajectory
    from airpuck.vehicle import Vehicle, default_vehicle, read_vehicle

#: Public name -> the module that defines it.
_HOME = {
    "InputError": "airpuck.errors",
    "Recording": "airpuck.recording.stream",
    "Stream": "airpuck.recording.stream",
    "Span": "airpuck.trajectory",
    "Trajectory": "airpuck.trajectory",
    "read_trajectory": "airpuck.trajectory",
    "Vehicle": "airpuck.vehicle",
    "default_vehicle": "airpuck.vehicle",
    "read_vehicle": "airpuck.vehicle",
}

__all__ = [
    "InputError",
    "Recording",
    "Span",
    "Stream",
    "Trajectory",
    "Vehicle",
    "default_vehicle",
    "read_trajectory",
    "read_vehicle",
]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use (PEP 562)."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'airpuck' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
