"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

Data flow::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Public names are imported on first use, so that ``import airpuck`` is fast.
"""

from __future__ import annotations

#: Public name -> its module.
_HOME: dict[str, str] = {}
#: Former public names, with their replacement.
_FORMER = {"fly_fleet": "airpuck.TwinBatch", "Adam": "studies/adam.py"}


def _home() -> dict[str, str]:
    """Return the modules of public names, which the stub file declares for type checkers."""
    if not _HOME:
        # Imported here, since the command line installs its signal handler after this module.
        import ast
        from pathlib import Path

        tree = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
        for statement in tree.body:
            if isinstance(statement, ast.ImportFrom) and statement.module:
                _HOME.update(
                    dict.fromkeys((alias.name for alias in statement.names), statement.module)
                )
    return _HOME


def __getattr__(name: str) -> object:
    """Import a public name at its first use (PEP 562)."""
    if name == "__all__":
        return sorted(_home())
    if name.startswith("__") and name != "__version__":
        raise AttributeError(f"module 'airpuck' has no attribute {name!r}")
    import importlib
    import inspect

    if name == "plot":  # a module is not an attribute of its package before it is imported
        return importlib.import_module("airpuck.report.plot")
    if name == "export":
        return importlib.import_module("airpuck.export")
    if name == "__version__":
        return _version()
    if name in _home():
        public = getattr(importlib.import_module(_home()[name]), name)
        if inspect.isfunction(public):
            from airpuck.boundary.arguments import checked

            public = checked(public)
        globals()[name] = public
        return public
    remedy = f"; use {_FORMER[name]}" if name in _FORMER else ""
    raise AttributeError(f"module 'airpuck' has no attribute {name!r}{remedy}")


def _version() -> str:
    """Return the installed version, which comes from the tag."""
    from importlib import metadata  # takes as long to import as the rest of this module

    try:
        return metadata.version("airpuck")
    except metadata.PackageNotFoundError:
        return "0+unknown"


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(_home())
