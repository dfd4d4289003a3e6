"""Commands as views of settings objects: each declared field becomes an option."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, is_dataclass, replace
from inspect import Parameter
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from typer import Exit, Option

from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Declared, Setting, Settings, declared, setting_of, undressed
from airpuck.cli.output import output_for


@dataclass(frozen=True)
class FromFile:
    """Marks a settings object that a file may define; options override single fields of it."""

    #: The option that names the file.
    option: str
    #: Description of the file.
    help: str
    read: Callable[[Path], Any]


@dataclass(frozen=True)
class Without:
    """Marks a settings object some of whose fields the command sets itself."""

    fields: tuple[str, ...]


def viewed(
    command: Callable[..., Any], rare: Sequence[str] = (), shared: Mapping[str, Any] | None = None
) -> Callable[..., Any]:
    """Return a command in the form that Typer expects.

    A parameter whose type is a settings class becomes an option for each of its fields, under the
    heading of the class. A parameter whose type carries a `Setting` becomes that option. The result
    has the `declared` options by name, for its `airpuck.cli.app.Command`; `rare` names those that
    the help shows on request only. The function does not take the `shared` options, which its
    output obeys.
    """
    signature = inspect.signature(command, eval_str=True)
    views = [_View.of(parameter) for parameter in signature.parameters.values()]

    @functools.wraps(command)
    def run(settings_file: Path | None = None, help_all: bool = False, **given: Any) -> Any:
        with _as_typed(options), output_for(**given):
            return command(**{view.name: view.value(given) for view in views})

    parameters = [parameter for view in views for parameter in view.parameters]
    options = {
        name: replace(one, rare=name in rare)
        for view in views
        for name, one in view.options.items()
    }
    own = {one.name for one in parameters}
    parameters += [_option(k, kind, None) for k, kind in (shared or {}).items() if k not in own]
    if rare:
        assert options.keys() >= set(rare), f"{command.__name__}: no such rare options"
        parameters += [_option("settings_file", _SETTINGS_FILE, None)]
        parameters += [_option("help_all", _HELP_ALL, False)]
    run.declared = options  # pyright: ignore
    run.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


def _read_settings(context: Any, _parameter: Any, path: Path | None) -> Path | None:
    """Read the options that are not typed from a file; its keys are their long names."""
    if path is not None and not context.resilient_parsing:
        import pydantic

        from airpuck.boundary.files import Section, read_toml

        options, fields = context.command.declared, dict[str, Any]()
        for name, one in options.items():
            fields[name] = (Annotated[one.kind, one.setting], pydantic.Field(None, alias=one.key))
        schema = pydantic.create_model("Options", __base__=Section, **fields)
        model = "truth" if context.info_name == "excite" else "as the first argument"
        schema.MOVED = {"regulator": "law", "model": model}
        context.default_map = read_toml(path, schema).model_dump(exclude_unset=True)
    return path


def _show_all(context: Any, _parameter: Any, value: bool) -> bool:
    """Print the help with its rare options, and end."""
    if value and not context.resilient_parsing:
        context.meta[ALL_OPTIONS] = True
        context.get_help()
        raise Exit
    return value


#: In the context of a command: whether its help shows rare options.
ALL_OPTIONS = "airpuck.all_options"
_SETTINGS_FILE = Annotated[
    Path | None,
    Option(
        "--settings",
        metavar="FILE",
        is_eager=True,
        callback=_read_settings,
        help="TOML file of options; its keys are the long names of options, with _ for -.",
    ),
]
_HELP_ALL = Annotated[
    bool,
    Option("--help-all", is_eager=True, callback=_show_all, help="Also show the rarer options."),
]


@dataclass(frozen=True)
class OptionView:
    """An option of a command, as declared."""

    #: Type of its value, without the `Setting`.
    kind: Any
    setting: Setting
    #: As typed, with its short form after a slash.
    spelling: str
    #: Whether the help shows it on request only.
    rare: bool = False

    @classmethod
    def of(cls, setting: Setting, name: str, kind: Any) -> OptionView:
        """Return the option of a setting of a type."""
        return cls(Path | None if setting.read else _first(kind), setting, _spelling(setting, name))

    @property
    def typed(self) -> Any:
        """The type for Typer, which does not support lists of tuples."""
        return list[str] | None if self.row else self.kind

    @property
    def key(self) -> str:
        """Its key in a file."""
        return self.spelling.split("/")[0].lstrip("-").replace("-", "_")

    @property
    def row(self) -> int:
        """Numbers per occurrence of a repeated option; 0 for other options."""
        return len(get_args(_entry(self.kind)))


@dataclass(frozen=True)
class _View:
    """A parameter of a command, and the parameters that replace it for Typer."""

    name: str
    parameters: tuple[Parameter, ...]
    #: Computes the value of the former from the values of the latter.
    value: Callable[[dict[str, Any]], Any]
    options: dict[str, OptionView]

    @classmethod
    def of(cls, parameter: Parameter) -> _View:
        kind, marks, name = parameter.annotation, (), parameter.name
        if get_origin(kind) is Annotated:
            kind, marks = kind.__origin__, kind.__metadata__
        if isinstance(kind, type) and issubclass(kind, Settings) and is_dataclass(kind):
            return cls._settings(name, kind, marks)
        setting = setting_of(parameter.annotation)
        options = {}
        if setting is not None:
            options[name] = OptionView.of(setting, name, undressed(parameter.annotation))
            annotation = Annotated[options[name].typed, option(setting, name)]
            parameter = parameter.replace(annotation=annotation)
        parameter = parameter.replace(kind=Parameter.KEYWORD_ONLY)
        return cls(name, (parameter,), lambda given: _read(given, name, setting), options)

    @classmethod
    def _settings(cls, name: str, kind: Any, marks: tuple[Any, ...]) -> _View:
        left_out = [f for mark in marks if isinstance(mark, Without) for f in mark.fields]
        shown = [one for one in declared(kind) if one.name not in left_out]
        shown.sort(key=lambda one: one.default is not MISSING)  # required options first
        file = next((mark for mark in marks if isinstance(mark, FromFile)), None)
        parameters = [_field(one, kind.HEADING, given=file is None) for one in shown]
        if file is not None:
            words = Option(
                file.option, metavar="FILE", help=file.help, rich_help_panel=kind.HEADING
            )
            parameters.append(_option(f"{name}_file", Annotated[Path | None, words], None))

        def value(given: dict[str, Any]) -> Any:
            fields = {one.name: _read(given, one.name, one.setting) for one in shown}
            path = given[f"{name}_file"] if file else None
            if file is None:
                return kind(**fields)
            base = kind() if path is None else file.read(path)
            return replace(base, **{key: v for key, v in fields.items() if v is not None})

        options = {one.name: OptionView.of(one.setting, one.name, one.kind) for one in shown}
        return cls(name, tuple(parameters), value, options)


def option(setting: Setting, name: str, heading: str | None = None, default: Any = None) -> Any:
    """Return the option of a setting; `default` is for the help alone."""

    # Typer evaluates annotations of each option's callback whenever it starts: half of its time.
    def check(context, parameter, value):
        if not context.resilient_parsing:
            setting.check(value, parameter.opts[0])
        return value

    # Typer puts a string in brackets; use one only for a number with too many digits.
    short = f"{default:.3g}" if isinstance(default, float) else ""
    words = setting.help
    if setting.within is not None:
        words = f"{words.removesuffix('.')} ({setting.within})."
    return Option(
        *re.split("/(?!--no-)", _spelling(setting, name)),
        metavar=setting.metavar,
        help=words,
        callback=check,
        autocompletion=setting.complete,
        rich_help_panel=setting.heading or heading or None,
        show_default=short if short and float(short) != default else True,
    )


def _read(given: dict[str, Any], name: str, setting: Setting | None) -> Any:
    """Return the value of an option; of an option that names a file, its content."""
    value = given[name]
    return setting.read(value) if setting and setting.read and value is not None else value


def _field(one: Declared, heading: str, *, given: bool) -> Parameter:
    """Return the option of a field, without a default if a file may set it."""
    setting, kind = one.setting, OptionView.of(one.setting, one.name, one.kind).typed
    if not given:
        setting = replace(setting, help=f"{setting.help}; by default {one.default:g}")
        kind = kind | None
    default = one.default if given else None
    annotation = Annotated[kind, option(setting, one.name, heading, default)]
    return _option(one.name, annotation, Parameter.empty if default is MISSING else default)


def _option(name: str, annotation: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _first(kind: Any) -> Any:
    """Return the type that can be typed: the first of a union, and None if it is optional."""
    if get_origin(kind) not in (Union, UnionType):
        return kind
    first, *others = get_args(kind)
    return first | None if NoneType in others else first


def _entry(kind: Any) -> Any:
    """Return the tuple in a list of tuples; None for other types."""
    listed = next((k for k in (kind, *get_args(kind)) if get_origin(k) is list), None)
    entry = get_args(listed)[0] if listed else None
    return entry if get_origin(entry) is tuple else None


def _spelling(setting: Setting, name: str) -> str:
    """Return an option's spelling, with another one after a slash."""
    return setting.option or f"--{name.replace('_', '-')}"


@contextmanager
def _as_typed(options: dict[str, OptionView]) -> Iterator[None]:
    """Name fields of settings objects in errors as the command line spells them."""
    try:
        yield
    except InputError as error:
        if error.file is not None or error.field not in options:
            raise
        field = options[error.field].spelling.split("/")[0]
        raise InputError(error.problem, field=field) from error
