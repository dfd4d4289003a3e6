"""Results as JSON: each class declares its fields, and one function converts all values."""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from html import escape
from operator import attrgetter
from typing import Any, ClassVar


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


class Result:
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
