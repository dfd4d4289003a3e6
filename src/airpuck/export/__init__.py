"""Models and controllers for other tools: one module for each kind of export.

Entry points: `kinds.write`; functions that return objects: `casadi.functions`, `mjcf.xml`,
`holohover.params_json`, `holohover.params_yaml`, `matlab.parameters`.
"""

from importlib import import_module

from airpuck.export.kinds import KINDS, ExportKind, Subject, Written, refuse_effects, write

__all__ = ["KINDS", "ExportKind", "Subject", "Written", "refuse_effects", "write"]


def __getattr__(name: str) -> object:
    """Import the module of a kind at its first use, as in `airpuck.export.casadi.functions`."""
    if name not in KINDS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")
