"""Hashes of what an item depends on: our code, the user's code, and files."""

from __future__ import annotations

import ast
import hashlib
import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import FOLDER_FILES, refused, sha256

#: Bytecode, which changes while code runs.
_CACHE = "__pycache__"
#: Folders of installed modules, which belong to the environment, not to the user's code.
_INSTALLED = tuple(Path(sysconfig.get_path(n)) for n in ("stdlib", "purelib", "platlib"))


@cache
def program(module: str = __name__) -> str:
    """Hash all files of this package, and of the package of a module that builds on it."""
    hashes = []
    for name in sorted({"airpuck", module.partition(".")[0]}):
        found = find_spec(name)
        assert found is not None and found.origin is not None
        folder = Path(found.origin).parent
        files = (f for f in folder.rglob("*") if f.is_file() and _CACHE not in f.parts)
        hashes.append(_of(folder, files))
    return "".join(hashes)


def of_file(path: str | os.PathLike[str]) -> str:
    """Hash a file."""
    if Path(path).is_dir():
        raise InputError("is a folder; a file is expected", file=path)
    return sha256(path)


def of_recording(path: str | os.PathLike[str]) -> str:
    """Hash a recording: a file, or all files of a folder."""
    folder = Path(path)
    return _of(folder, _files(folder)) if folder.is_dir() else sha256(folder)


def of_code(path: str | os.PathLike[str]) -> str:
    """Hash a Python file and the modules it imports, without installed ones."""
    first = Path(path).absolute()
    search = (str(first.parent), *sys.path)
    sources: set[Path] = set()
    waiting = {first}
    while waiting:
        sources |= waiting
        names = set().union(*map(_imports, waiting))
        waiting = {source for name in names for source in _sources(name, search)} - sources
    return _of(first.parent, sources)


def _imports(source: Path) -> set[str]:
    """Return the top-level names of the modules that a file imports."""
    try:
        tree = ast.parse(source.read_bytes())
    # Running the code will report the syntax error.
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return set()
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module)
    return {name.partition(".")[0] for name in names}


@cache
def _found(name: str, search: tuple[str, ...]) -> tuple[Path, ...]:
    """Return the file of a module, or the folders of a package, in a search path."""
    if name in sys.stdlib_module_names:
        return ()
    specification = PathFinder.find_spec(name, list(search))
    if specification is None:
        return ()
    # In a development install this package lies outside site-packages.
    places = tuple(map(Path, specification.submodule_search_locations or ()))
    return places or ((Path(specification.origin),) if specification.origin else ())


def _sources(name: str, search: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files of a module or package, unless it is installed."""
    for place in _found(name, search):
        installed = any(place.is_relative_to(folder) for folder in _INSTALLED)
        if installed or place == Path(airpuck.__file__).parent:
            continue
        yield from (f for f in _files(place) if f.suffix == ".py") if place.is_dir() else (place,)


def _files(folder: Path) -> Iterator[Path]:
    """Yield all files below a folder; raise InputError if there are too many."""
    seen = 0
    for place, folders, names in os.walk(folder):
        seen += len(names) + len(folders)
        if seen > FOLDER_FILES:
            remedy = "is it the right folder?"
            raise refused("contains too many files", FOLDER_FILES, remedy, file=folder)
        folders[:] = [name for name in folders if name != _CACHE]
        yield from (Path(place, name) for name in names)


def _of(folder: Path, files: Iterable[Path]) -> str:
    """Hash files with their names relative to a folder."""
    lines = [f"{os.path.relpath(file, folder)} {sha256(file)}" for file in sorted(files)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
