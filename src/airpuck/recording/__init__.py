"""Reading and writing what a lab has.

Entry points: `torch_archive.read_authors_experiment`, `topics.Topics`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airpuck.recording.bag_writer import write_bag
    from airpuck.recording.csv_folder import write_csv
    from airpuck.recording.dataset import dataset_folder, fetch, verify
    from airpuck.recording.read import read_recording
    from airpuck.recording.stream import Recording, Stream
    from airpuck.recording.topics import Topics, read_topics
    from airpuck.recording.torch_archive import read_authors_experiment

#: Public name -> the module that defines it.
_HOME = {
    "Recording": "stream",
    "Stream": "stream",
    "Topics": "topics",
    "dataset_folder": "dataset",
    "fetch": "dataset",
    "read_authors_experiment": "torch_archive",
    "read_recording": "read",
    "read_topics": "topics",
    "verify": "dataset",
    "write_bag": "bag_writer",
    "write_csv": "csv_folder",
}

__all__ = [
    "Recording",
    "Stream",
    "Topics",
    "dataset_folder",
    "fetch",
    "read_authors_experiment",
    "read_recording",
    "read_topics",
    "verify",
    "write_bag",
    "write_csv",
]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use (PEP 562)."""
    if name in _HOME:
        return getattr(importlib.import_module(f"airpuck.recording.{_HOME[name]}"), name)
    raise AttributeError(f"module 'airpuck.recording' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
