"""Display of results in notebooks."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any


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
