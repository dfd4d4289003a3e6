"""A setting, declared once: Python, TOML files, campaigns and the command line are views of it."""

from __future__ import annotations

import builtins
import sys
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from functools import cache
from inspect import get_annotations
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import fits, misfit, unknown
from airpuck.boundary.numbers import Range


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


@dataclass(frozen=True)
class Declared:
    """A field of a settings object."""

    name: str
    #: Its type, without the `Setting`.
    kind: Any
    setting: Setting
    default: Any


class Settings:
    """Base of settings objects, which are frozen dataclasses: checks ranges and choices."""

    #: Heading of its options in the help of a command.
    HEADING: ClassVar[str] = "Settings"
    #: For files: an unknown key is an error.
    __pydantic_config__: ClassVar[Any] = {"extra": "forbid", "allow_inf_nan": False}

    def __post_init__(self) -> None:
        """Check every declared field."""
        for one in declared(type(self)):
            value = getattr(self, one.name)
            choices = choices_of(one.kind)
            if choices and value is not None and value not in choices:
                raise InputError(unknown(value, choices), field=one.name)
            if not fits(value, one.kind):
                raise InputError(misfit(value, one.kind), field=one.name)
            one.setting.check(value, one.name)


@cache
def declared(kind: type) -> tuple[Declared, ...]:
    """Return the fields of a settings class that carry a `Setting`, in declaration order."""
    hints: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        names = _Names(vars(sys.modules[base.__module__]))
        hints |= get_annotations(base, eval_str=True, locals=names)
    return tuple(_declared(kind, hints))


class _Names(dict[str, Any]):
    """The module's names; a type imported only for type checkers becomes Any."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _declared(kind: Any, hints: dict[str, Any]) -> Iterator[Declared]:
    for field in fields(kind):
        setting = setting_of(hints[field.name])
        if setting is not None:
            made = field.default_factory
            default = field.default if made is MISSING else made()
            yield Declared(field.name, undressed(hints[field.name]), setting, default)


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


def choices_of(annotation: Any) -> tuple[Any, ...]:
    """Return the values of the Literal in a type; empty if there is no Literal."""
    if get_origin(annotation) is Annotated:
        return choices_of(annotation.__origin__)
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next(filter(None, map(choices_of, get_args(annotation))), ())
