"""Public names of a module, which its stub file declares; each is imported at its first use."""

from __future__ import annotations

from collections.abc import Callable


def public_names(
    module: str, file: str, *, checked: bool = False
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a module (PEP 562).

    The stub file declares the names for type checkers, too. `checked` functions check the types of
    their arguments.
    """
    #: Module of each name, and its name there.
    homes: dict[str, tuple[str, str]] = {}

    def listed() -> list[str]:
        if not homes:
            # Imported here, since the command line installs its signal handler after this module.
            import ast
            from pathlib import Path

            for statement in ast.parse(Path(file).with_suffix(".pyi").read_text("utf-8")).body:
                if isinstance(statement, ast.ImportFrom) and statement.module:
                    for alias in statement.names:
                        homes[alias.asname or alias.name] = statement.module, alias.name
        return sorted(homes)

    def found(name: str) -> object:
        # Not even `__all__`, with which `help` of the module would print every class in full.
        if name.startswith("__") or name not in listed():
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        import importlib
        import inspect
        import sys

        module_name, own = homes[name]
        home = importlib.import_module(module_name)
        if not hasattr(home, own):  # a module is not an attribute of its package before its import
            importlib.import_module(f"{module_name}.{own}")
        public = getattr(home, own)
        if checked and inspect.isfunction(public):
            from airpuck.boundary.arguments import checked as checking

            public = checking(public)
        setattr(sys.modules[module], name, public)
        return public

    return found, listed
