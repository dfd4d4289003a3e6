"""What others add: entry points of other distributions, and users' code, named FILE.py:NAME.

`UserCode` is the boundary around everything that a user's code does.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TypeVar

from airpuck.boundary.errors import InputError, explained, nearest, unknown

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Returned = TypeVar("Returned")

#: Groups of entry points, which any distribution may use: kinds of actuators
#: (`ActuatorKind`), commands (functions), effects (`Effect`),
#: kinds of export (`ExportKind`), kinds of campaign items (`Item`), laws (`Law`), and opponents on
#: the graph.
Group = Literal[
    "airpuck.actuators",
    "airpuck.commands",
    "airpuck.effects",
    "airpuck.exports",
    "airpuck.items",
    "airpuck.laws",
    "airpuck.opponents",
]
_TYPES = ["Game", "Intention", "Level", "Player", "PuckFilter", "Rules", "Tactic", "View"]
_TOOLS = ["contestant", "identify_puck", "league", "match", "skills"]
_PLAYING = ["identify-puck", "league", "match", "play", "play-live", "skills", "watch-match"]
#: What airpuck-hockey adds, so that a name without it leads there: public names by group, and the
#: names that `airpuck` itself had.
HOCKEY: Mapping[str, Sequence[str]] = {
    "airpuck.commands": _PLAYING,
    "airpuck.exports": ["gym-hockey"],
    "airpuck.items": ["match"],
    "airpuck.opponents": ["easy", "medium", "hard", "page"],
    "airpuck": [*_TOOLS, *_TYPES],
}

#: Former public names, with their replacement.
_FORMER = {"fly_fleet": "airpuck.TwinBatch", "Adam": "studies/adam.py"}
_FORMER |= {"select_model": "airpuck.study", "Selection": "airpuck.Study"}


@cache
def added(group: Group) -> Mapping[str, EntryPoint]:
    """Return what installed distributions add to a group, by name."""
    from importlib import metadata  # takes long to import, and few commands need it

    return {entry.name: entry for entry in metadata.entry_points(group=group)}


def loaded(group: Group, name: str, use: Callable[[Any], Any] = lambda found: found) -> Any:
    """Import what a distribution adds to a group, and use it; if that fails, name the source."""
    if name not in added(group):
        raise InputError(_needs_hockey(name))
    entry = added(group)[name]
    try:
        return use(entry.load())
    except Exception as error:
        source = entry.dist.name if entry.dist else entry.value
        problem = f"{source} adds {name}, but it cannot be used ({type(error).__name__}: {error})"
        raise InputError(f"{problem}; upgrade or uninstall {source}") from error


def named(name: str, ours: Mapping[str, Returned], group: Group, **place: Any) -> Returned:
    """Return the object with a name, of ours or of another distribution; else raise InputError."""
    if name in ours:
        return ours[name]
    if name in (*added(group), *HOCKEY.get(group, ())):
        return loaded(group, name)
    raise InputError(unknown(name, dict.fromkeys([*ours, *added(group)])), **place)


def moved(name: str, known: Sequence[str]) -> Any:
    """Return a name that moved from `airpuck` to airpuck-hockey; see `HOCKEY`."""
    # `from airpuck import …` would replace an AttributeError by one without a remedy.
    imports = sys._getframe(2).f_code.co_name == "_handle_fromlist"
    told = name in HOCKEY["airpuck"] or name in _FORMER  # others may be modules
    kind = ImportError if imports and told else AttributeError
    if name not in HOCKEY["airpuck"]:
        remedy = f"; use {_FORMER[name]}" if name in _FORMER else nearest(name, known)
        raise kind(f"module 'airpuck' has no attribute {name!r}{remedy}")
    try:
        return getattr(importlib.import_module("airpuck_hockey"), name)
    except ModuleNotFoundError as error:
        if error.name != "airpuck_hockey":
            raise
        raise kind(_needs_hockey(f"airpuck.{name}")) from None


def _needs_hockey(name: str) -> str:
    """Return the problem, and what to install, for a name that airpuck-hockey adds."""
    return f"{name} is part of airpuck-hockey, which is not installed: pip install airpuck-hockey"


class UserCode:
    """A class, or another callable, in a user's Python file; creating this object runs the file.

    `run` calls its code, so that none of its exceptions ends this process, and its printed output
    does not mix with our results.
    """

    def __init__(self, name: str, option: str) -> None:
        path, _, self._attribute = name.rpartition(":")
        self._path, self._option = Path(path), option
        #: FILE.py:NAME.
        self.name = name
        if self._path.suffix != ".py" or not self._attribute:
            example = f"such as my_{option.strip('-')}.py:Mine"
            raise InputError(f"must be FILE.py:NAME, {example}, not {name!r}", field=option)
        if self._path.is_dir():
            raise InputError("is a folder; a file is expected", file=path, field=option)
        if not self._path.is_file():
            raise InputError("there is no such file", file=path, field=option)
        #: The class.
        self.kind = self.run("cannot be imported", self._imported)
        if not callable(self.kind):
            raise InputError(f"has no class {self._attribute!r}", file=path, field=option)

    def run(self, what: str, function: Callable[..., Returned], *given: Any) -> Returned:
        """Call a user's function; redirect its printed output to standard error.

        Any exception becomes an `InputError` that begins with `what` and names file and line.
        """
        try:
            with redirect_stdout(sys.stderr):
                return function(*given)
        # Catches `sys.exit`, too.
        except BaseException as error:
            if _is_signal(error):
                raise
            if isinstance(error, InputError) and error.file == self.name:
                raise
            line = self._line(error)
            where = f"line {line}: {what}" if line else what
            raise self._error(f"{where}: {_described(error)}") from error

    def refuse(self, problem: str) -> NoReturn:
        """Raise an `InputError` that names the class."""
        raise self._error(problem)

    def _error(self, problem: str) -> InputError:
        return InputError(problem, file=self.name, field=self._option)

    def _imported(self) -> Any:
        """Run the file and return the named callable."""
        specification = importlib.util.spec_from_file_location(
            f"user_{self._path.stem}", self._path
        )
        assert specification is not None and specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        # Dataclasses and pickles of the file look up their module by name.
        sys.modules[specification.name] = module
        # Modules beside the file can be imported; appended at the end, so that none hides an
        # installed one.
        folder = str(self._path.absolute().parent)
        if folder not in sys.path:
            sys.path.append(folder)
        specification.loader.exec_module(module)
        return getattr(module, self._attribute, None)

    def _line(self, error: BaseException) -> int | None:
        """Return the line of the file at which an exception was raised, if any."""
        path = self._path.absolute()
        if isinstance(error, SyntaxError) and error.filename and Path(error.filename) == path:
            return error.lineno
        frames = traceback.walk_tb(error.__traceback__)
        lines = [line for frame, line in frames if Path(frame.f_code.co_filename) == path]
        return lines[-1] if lines else None


def users_class(name: str, option: str) -> Any:
    """Import the class FILE.py:NAME or MODULE:NAME; a file runs once, so that its class remains."""
    path, _, attribute = name.rpartition(":")
    if path and not path.endswith(".py"):
        kinds, problem = (ImportError, AttributeError), "cannot be imported: {error}"
        with explained(kinds, problem, file=name, field=option):
            return getattr(importlib.import_module(path), attribute)
    return _in_file(name, option, Path(path).stat().st_mtime_ns if Path(path).is_file() else 0)


@cache
def _in_file(name: str, option: str, _changed: int) -> Any:
    return UserCode(name, option).kind


def with_code(name: str | os.PathLike[str], option: str) -> tuple[Any, tuple[Any, ...]]:
    """Split ``file.toml+FILE.py:NAME`` into the file and the classes that its reader names."""
    path, _, sources = str(name).partition(".toml+")
    if not sources or Path(name).exists():
        return name, ()
    return f"{path}.toml", tuple(users_class(one, option) for one in sources.split("+"))


def _is_signal(error: BaseException) -> bool:
    """Return whether Ctrl-C or SIGTERM raised this exception, and not the user's own code.

    Commands raise a subclass of KeyboardInterrupt, and their worker processes ignore Ctrl-C; only
    Python's own handler raises the class itself.
    """
    if type(error) is KeyboardInterrupt:
        return signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return isinstance(error, KeyboardInterrupt)


def _described(error: BaseException) -> str:
    """Describe an exception, whose own description may fail."""
    try:
        text = str(error)
    except BaseException:
        text = "its message cannot be read"
    if isinstance(error, InputError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
