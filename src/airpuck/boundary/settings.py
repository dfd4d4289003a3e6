"""A setting, declared once: Python, TOML files, campaigns and the command line are views of it."""

from __future__ import annotations

import builtins
import os
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cache
from inspect import get_annotations
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

from airpuck.boundary.errors import InputError, either, unknown
from airpuck.boundary.numbers import Range
from airpuck.boundary.results import Changes


@cache
def _kinds() -> dict[Any, tuple[Any, str]]:
    """Return the types that fit a type, and words for it: a NumPy number is a number, too."""
    import numpy as np  # only where a value is checked: it would double the time of `--help`

    return {
        float: (Real, "a number"),
        int: (Integral, "a whole number"),
        bool: ((bool, np.bool_), "True or False"),
        str: (str, "a text"),
        type: (type, "a class"),
        os.PathLike: (os.PathLike, "a path"),
        np.ndarray: (np.ndarray, "an array"),
        Callable: (Callable, "a function"),
        Sequence: ((Sequence, np.ndarray), "a sequence"),
        tuple: ((Sequence, np.ndarray), "a sequence"),
        Iterable: (Iterable, "a sequence"),
        Mapping: (Mapping, "a mapping"),
    }


def fits(value: Any, hint: Any) -> bool:
    """Return whether a value fits an annotation; undecidable cases fit."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is typing.Annotated:
        return fits(value, inner[0])
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, str | int) and value in inner
    if origin in (None, type(None)):
        return value is None
    if origin in _kinds():
        kind, _ = _kinds()[origin]
        if not isinstance(value, kind) or (isinstance(value, bool) and origin in (int, float)):
            return False
        if origin in (Sequence, tuple):
            return _elements_fit(value, inner)
        return origin is not type or not inner or issubclass(value, inner)  # pyright: ignore
    if origin is Any or not isinstance(origin, type) or hasattr(origin, "array_type"):
        return True  # an array is converted, and its shape checked
    if getattr(origin, "_is_protocol", False) and not getattr(origin, "_is_runtime_protocol", 0):
        return True
    return isinstance(value, origin)


def _elements_fit(value: Any, inner: tuple[Any, ...]) -> bool:
    """Return whether all elements of a sequence are of a kind; text does not count."""
    if isinstance(value, str | bytes):
        return False
    if not inner:
        return True
    if hasattr(value, "shape"):
        return len(inner) == 1 or inner[-1] is ... or value.shape[:1] == (len(inner),)
    if len(inner) == 1 or inner[-1] is ...:
        return all(fits(one, inner[0]) for one in value)
    pairs = zip(value, inner, strict=False)
    return len(value) == len(inner) and all(fits(one, kind) for one, kind in pairs)


def misfit(value: Any, hint: Any) -> str:
    """Describe what an argument accepts."""
    names = [name for one in _alternatives(hint) for name in _names(one)]
    if names and isinstance(value, str):
        return unknown(value, names)
    kinds = [typing.get_args(o)[0] for o in _alternatives(hint) if typing.get_origin(o) is Sequence]
    entries = value if kinds and isinstance(value, list | tuple) else ()
    for entry in entries:
        if not any(fits(entry, kind) for kind in kinds):
            return f"must be {_words(hint)}, but contains {_shown(entry)}"
    return f"must be {_words(hint)}, not {_shown(value)}"


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the kinds that an annotation allows."""
    if typing.get_origin(hint) is typing.Annotated:
        hint = hint.__origin__
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


def _names(hint: Any) -> tuple[str, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) is Literal else ()


#: A sequence with fewer items than this is shown in messages.
_FEW = 10


def _words(hint: Any) -> str:
    """Describe a kind."""
    alternatives = _alternatives(hint)
    if len(alternatives) > 1:
        return either(dict.fromkeys(map(_words, alternatives)))
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is Literal:
        return either(map(repr, inner))
    if origin in (None, type(None)):
        return "None"
    if origin in (Sequence, tuple) and inner:
        kind, named = re.subn(r"^a ((?:whole )?number|text)$", r"\1s", _words(inner[0]))
        several = f"{len(inner)} {kind}" if named else f"{len(inner)} values: {kind}"
        return f"a sequence of {kind if len(inner) == 1 or inner[-1] is ... else several}"
    if origin is type and inner:
        return f"a subclass of {inner[0].__name__}"
    if origin in _kinds():
        return _kinds()[origin][1]
    return getattr(origin, "__name__", str(origin))


def _shown(value: object) -> str:
    """Show a short value; for others, the type."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    values = value if isinstance(value, tuple | list) and len(value) < _FEW else [value]
    simple = all(isinstance(one, str | bool | Real | None) for one in values)
    return repr(value) if simple and len(repr(value)) < 40 else f"a {type(value).__name__}"


@dataclass(frozen=True)
class Setting:
    """Metadata of a settings field, besides its type and default.

    It is written into the field's type, ``Annotated[float, Setting(…)]``. Pydantic then checks the
    range of the field.
    """

    #: A sentence for the help.
    help: str
    #: The allowed range of numbers.
    within: Range | None = None
    #: Placeholder for the value in the help, such as S for seconds.
    metavar: str | None = None
    #: Option name, if it differs from the field's name.
    option: str | None = None
    #: Heading of its option in the help, if it differs from the settings object's.
    heading: str | None = None
    #: Values for shell completion, if the type does not list them.
    complete: Callable[[], list[str]] | None = None
    #: Reads the value from the file that its option names.
    read: Callable[[Path], Any] | None = None

    def check(self, value: Any, field: str) -> None:
        """Raise InputError if a number, or one of several, is out of range."""
        if isinstance(value, (tuple, list)):
            for entry in value:
                self.check(entry, field)
        elif self.within is not None and value is not None:
            self.within.check(value, field)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Let pydantic check the range."""
        from pydantic_core.core_schema import no_info_after_validator_function

        def checked(value: Any) -> Any:
            self.check(value, "")
            return value

        return no_info_after_validator_function(checked, handler(source))


def check_value(value: Any, hint: Any, setting: Setting | None, field: str) -> None:
    """Raise InputError if a value does not fit its annotation or is out of its setting's range."""
    if not fits(value, hint):
        raise InputError(misfit(value, hint), field=field)
    if setting is not None:
        setting.check(value, field)


@dataclass(frozen=True)
class Declared:
    """A field of a settings object."""

    name: str
    #: Its type, without the `Setting`.
    kind: Any
    setting: Setting
    default: Any


class Settings(Changes):
    """Base of settings objects, which are frozen dataclasses: checks ranges and choices."""

    #: Heading of its options in the help of a command.
    HEADING: ClassVar[str] = "Settings"
    #: For files: an unknown key is an error.
    __pydantic_config__: ClassVar[Any] = {"extra": "forbid", "allow_inf_nan": False}

    def __post_init__(self) -> None:
        """Check every declared field."""
        for one in declared(type(self)):
            check_value(getattr(self, one.name), one.kind, one.setting, one.name)


@cache
def declared(kind: type) -> tuple[Declared, ...]:
    """Return the fields of a settings class that carry a `Setting`, in declaration order."""
    hints: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        names = _Names(vars(sys.modules[base.__module__]))
        hints |= get_annotations(base, eval_str=True, locals=names)
    found = []
    for field in fields(kind):
        if (setting := setting_of(hints[field.name])) is not None:
            made = field.default_factory
            default = field.default if made is MISSING else made()
            found.append(Declared(field.name, undressed(hints[field.name]), setting, default))
    return tuple(found)


class _Names(dict[str, Any]):
    """The module's names; a type imported only for type checkers becomes Any."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def setting_of(annotation: Any) -> Setting | None:
    """Return the `Setting` in a type, if there is one."""
    if get_origin(annotation) is not Annotated:
        optional = get_args(annotation) if type(None) in get_args(annotation) else ()
        return next(filter(None, map(setting_of, optional)), None)
    return next((m for m in annotation.__metadata__ if isinstance(m, Setting)), None)


def undressed(annotation: Any) -> Any:
    """Return a type without its `Setting`."""
    if get_origin(annotation) is Annotated:
        return annotation.__origin__
    first: Any = next(iter(get_args(annotation)), None)
    return first.__origin__ | None if get_origin(first) is Annotated else annotation
