"""Commands as views of settings objects: each declared field of one becomes an option."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, is_dataclass, replace
from inspect import Parameter
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from typer import Option

from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Declared, Setting, Settings, declared, setting_of


@dataclass(frozen=True)
class FromFile:
    """Marks a settings object that a file may give; options next to it change single fields."""

    #: The option that names the file.
    option: str
    #: What the file is.
    help: str
    read: Callable[[Path], Any]


@dataclass(frozen=True)
class Without:
    """Marks a settings object some of whose fields the command sets itself."""

    fields: tuple[str, ...]


def viewed(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command in the form that Typer expects.

    A parameter whose type is a settings class becomes an option for each of its fields, under the
    heading of the class. A parameter whose type carries a `Setting` becomes that option.
    """
    signature = inspect.signature(command, eval_str=True)
    views = [_View.of(parameter) for parameter in signature.parameters.values()]

    @functools.wraps(command)
    def run(**given: Any) -> Any:
        with _as_typed(views):
            return command(**{view.name: view.value(given) for view in views})

    parameters = [parameter for view in views for parameter in view.parameters]
    run.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


@dataclass(frozen=True)
class _View:
    """A parameter of a command, and the parameters that replace it for Typer."""

    name: str
    parameters: tuple[Parameter, ...]
    #: Computes the value of the former from the values of the latter.
    value: Callable[[dict[str, Any]], Any]
    #: Option names of the fields.
    spelling: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, parameter: Parameter) -> _View:
        kind, marks = parameter.annotation, ()
        if get_origin(kind) is Annotated:
            kind, marks = kind.__origin__, kind.__metadata__
        if isinstance(kind, type) and issubclass(kind, Settings) and is_dataclass(kind):
            return cls._settings(parameter.name, kind, marks)
        setting = setting_of(parameter.annotation)
        if setting is not None:
            annotation = Annotated[_typed(kind), option(setting, parameter.name)]
            parameter = parameter.replace(annotation=annotation)
        name = parameter.name
        spelling = {} if setting is None else {name: _spelling(setting, name)}
        return cls(name, (_keyword(parameter),), lambda given: given[name], spelling)

    @classmethod
    def _settings(cls, name: str, kind: Any, marks: tuple[Any, ...]) -> _View:
        left_out = [f for mark in marks if isinstance(mark, Without) for f in mark.fields]
        shown = [one for one in declared(kind) if one.name not in left_out]
        file = next((mark for mark in marks if isinstance(mark, FromFile)), None)
        parameters = [_field(one, kind.HEADING, given=file is None) for one in shown]
        if file is not None:
            words = Option(
                file.option, metavar="FILE", help=file.help, rich_help_panel=kind.HEADING
            )
            parameters.append(_option(f"{name}_file", Annotated[Path | None, words], None))

        def value(given: dict[str, Any]) -> Any:
            fields = {one.name: given[one.name] for one in shown}
            path = given[f"{name}_file"] if file else None
            if file is None:
                return kind(**fields)
            base = kind() if path is None else file.read(path)
            return replace(base, **{key: v for key, v in fields.items() if v is not None})

        spelling = {one.name: _spelling(one.setting, one.name) for one in shown}
        return cls(name, tuple(parameters), value, spelling)


def option(setting: Setting, name: str, heading: str | None = None, default: Any = None) -> Any:
    """Return the option of a setting; `default` is for the help alone."""

    def check(context: Any, parameter: Any, value: Any) -> Any:
        if not context.resilient_parsing:
            setting.check(value, parameter.opts[0])
        return value

    # Typer puts strings in brackets: only for a default that is too long to show.
    short = f"{default:.3g}" if isinstance(default, float) else ""
    words = setting.help
    if setting.within is not None:
        words = f"{words.removesuffix('.')} ({setting.within})."
    return Option(
        *_spelling(setting, name).split("/"),
        metavar=setting.metavar,
        help=words,
        callback=check,
        rich_help_panel=setting.heading or heading,
        show_default=short if short and float(short) != default else True,
    )


def _field(one: Declared, heading: str, *, given: bool) -> Parameter:
    """Return the option of a field; without its default if a file may give the value."""
    setting, kind = one.setting, _typed(one.annotation.__origin__)
    if not given:
        setting = replace(setting, help=f"{setting.help}; by default {one.default:g}")
        kind = kind | None
    default = one.default if given else None
    annotation = Annotated[kind, option(setting, one.name, heading, default)]
    return _option(one.name, annotation, default)


def _option(name: str, annotation: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _keyword(parameter: Parameter) -> Parameter:
    return parameter.replace(kind=Parameter.KEYWORD_ONLY)


def _typed(kind: Any) -> Any:
    """Return the type to parse on the command line: the first of a union, or optional."""
    if get_origin(kind) not in (Union, UnionType):
        return kind
    first, *others = get_args(kind)
    return first | None if NoneType in others else first


def _spelling(setting: Setting, name: str) -> str:
    """Return an option's name, with its short form behind a slash."""
    return setting.option or f"--{name.replace('_', '-')}"


@contextmanager
def _as_typed(views: list[_View]) -> Iterator[None]:
    """Name fields of settings objects in errors as the command line spells them."""
    try:
        yield
    except InputError as error:
        spelling = {name: text for view in views for name, text in view.spelling.items()}
        if error.file is not None or error.field not in spelling:
            raise
        field = spelling[error.field].split("/")[0]
        raise InputError(error.problem, field=field) from error
