"""Results: classes declare their JSON fields, notebooks show frames, findings have a remedy."""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from html import escape
from operator import attrgetter
from textwrap import shorten
from typing import Any, ClassVar, Literal, get_args


def html_table(title: str, headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Write a small table; numbers are rounded to five digits, None and nan become empty cells."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return (
        f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )


def _cell(value: Any) -> str:
    """Write one cell; numbers are right-aligned."""
    if value is None or value != value:
        return "<td></td>"
    if isinstance(value, (int, float)):
        return f'<td style="text-align: right">{value:.5g}</td>'
    return f'<td style="text-align: left">{escape(str(value))}</td>'


def frame(rows: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return labelled rows as a pandas DataFrame, or unchanged if pandas is not installed."""
    found = {label: dict(row) for label, row in rows.items()}
    if importlib.util.find_spec("pandas") is None:
        return found
    import pandas

    return pandas.DataFrame.from_dict(found, orient="index")


#: Longest text of an object, and of one figure in it: the first that fits is used [characters].
_LONGEST, _WIDTHS = 400, (160, 100, 60, 40, 25, 16)
#: More numbers than this are described by their range; other lists end after as many entries.
_FEW = 8


class Brief:
    """Base of what public functions return: shown in at most 400 characters.

    Each word of `SHOWN` is a figure: ``loss``, or ``delay_s=model.delay`` if the name adds a unit.
    Without it, results show their JSON, settings what differs from their defaults, and other
    objects their public attributes.
    """

    SHOWN: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Set the text, so that dataclasses keep it."""
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            setattr(cls, "__repr__", cls.__repr__)  # noqa: B010

    def __repr__(self) -> str:
        return brief(self)


class Changes(Brief):
    """Base of settings, which all have defaults: shown by what differs from them."""


def brief(self: Any, figures: Mapping[str, Any] | None = None) -> str:
    """Write an object's figures, by default those of `Brief`, on one line."""
    found = (figures or _figures(self)).items()
    texts = {key: _text(value) for key, value in found if value is not None}
    written = ""
    for width in _WIDTHS:
        words = (f"{key}={shorten(text, width, placeholder='…')}" for key, text in texts.items())
        written = f"{type(self).__name__}({', '.join(words)})"
        if len(written) <= _LONGEST:
            break
    return shorten(written, _LONGEST, placeholder=" …)")


def _figures(shown: Any) -> Mapping[str, Any]:
    """Return an object's figures by name; see `Brief`."""
    if names := getattr(shown, "SHOWN", "").split():
        words = ((word.split("=")[0], word.split("=")[-1]) for word in names)
        # An object whose constructor failed lacks some.
        return {k: attrgetter(p)(shown) for k, p in words if hasattr(shown, p.split(".")[0])}
    with suppress(AttributeError):  # has none, or is half-made
        return shown.to_json()
    if hasattr(shown, "model_dump"):
        return shown.model_dump(exclude_defaults=True)
    usual = vars(type(shown)()).items() if isinstance(shown, Changes) else ()
    return {k: v for k, v in vars(shown).items() if k[0] != "_" and (k, v) not in usual}


def _text(value: Any) -> str:
    """Write a value; only the range of many numbers."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_text(one)}' for key, one in value.items())}}}"
    if hasattr(value, "tolist") or isinstance(value, (list, tuple)):
        with suppress(TypeError, ValueError):
            return _range(value)
        value = getattr(value, "tolist", lambda: value)()
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        more = [f"{len(value)} in all"] if len(value) > _FEW else []
        return f"[{', '.join([*map(_text, value[:_FEW]), *more])}]"
    if type(value).__repr__ is object.__repr__:
        return type(value).__name__
    return getattr(value, "__qualname__", " ".join(repr(value).partition(" at 0x")[0].split()))


def _range(values: Any) -> str:
    """Write sizes and range of many numbers; ValueError or TypeError for anything else."""
    import numpy as np  # where it exists anyway, or for lists

    found = np.asarray(values, dtype=float)
    if found.size <= _FEW:
        raise ValueError("few")
    least, most = (ufunc.reduce(found, axis=None) for ufunc in (np.fmin, np.fmax))  # without NaN
    return f"{'×'.join(map(str, found.shape))} values from {least:.3g} to {most:.3g}"


class Result(Brief):
    """Base of results; its `to_json` returns the fields that a class declares in `JSON`.

    Each word of `JSON` is a field: ``loss``, or ``delay_s=model.delay`` if the key adds a unit or
    the value belongs to an attribute. ``rmse:x_m,y_m`` names the entries of an array.
    """

    JSON: ClassVar[str] = ""

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Returns
        -------
        dict
            Values that JSON can represent; None replaces a number that is not finite.
        """
        figures = {}
        for word in self.JSON.split():
            declared, _, entries = word.partition(":")
            key, _, path = declared.partition("=")
            value = plain(attrgetter(path or key)(self))
            if entries and value is not None:
                value = dict(zip(entries.split(","), value, strict=True))
            figures[key] = value
        return figures


def plain(value: Any) -> Any:
    """Convert arrays, results, paths and non-finite numbers to values that JSON can represent."""
    if hasattr(value, "tolist"):  # NumPy's types, which this package does not import
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if hasattr(value, "to_json"):
        return value.to_json()
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value


#: Kinds of causes, in the order in which causes have consequences: a wrong clock looks like wrong
#: motors, wrong motors like missing physics, and never the other way round. ``poses`` that do not
#: come or are useless; ``table``: its slope, or the craft's place on it; ``clock``: clocks and
#: time stamps; ``units``, ``axes`` and ``signs`` of poses and commands; ``order`` of the motors'
#: columns or sockets; ``layout``: positions and directions of the vehicle file; ``mass``: mass,
#: inertia and radius; ``actuator``: weak, dead, reversed; ``physics`` that the model lacks;
#: ``change`` during the recording; ``excitation``: too little of it; ``control``: the controller
#: does not settle.
CauseKind = Literal[
    "poses",
    "table",
    "clock",
    "units",
    "axes",
    "signs",
    "order",
    "layout",
    "mass",
    "actuator",
    "physics",
    "change",
    "excitation",
    "control",
]
#: Kinds that make a recording suspect: whatever is learned from it is wrong.
SUSPECT: tuple[CauseKind, ...] = ("clock", "units", "axes", "signs", "order")


@dataclass(frozen=True)
class Finding(Result):
    """Something that is wrong.

    Attributes
    ----------
    kind : str
        Kind of the cause, one of `CauseKind`.
    cause : str
        What is wrong: a sentence without its full stop, such as "The poses are stamped 80 ms late".
    evidence : str
        What shows it, with a number.
    remedy : str
        What to do: a sentence, or the line to write into a file.
    """

    JSON = "kind cause evidence remedy"

    kind: CauseKind
    cause: str
    evidence: str = ""
    remedy: str = ""

    @property
    def suspect(self) -> bool:
        """Whether nothing that is learned from the recording can be right."""
        return self.kind in SUSPECT

    @property
    def sentence(self) -> str:
        """The finding in words."""
        shown = f"{self.cause} ({self.evidence})" if self.evidence else self.cause
        return f"{shown}." + (f" {self.remedy}" if self.remedy else "")


def by_cause(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings in the order of their causes, each once."""
    kinds = get_args(CauseKind)
    return tuple(sorted(dict.fromkeys(findings), key=lambda one: kinds.index(one.kind)))
