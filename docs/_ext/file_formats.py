"""The reference of file formats, from the schemas that check the files."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from functools import cache, cached_property
from typing import Any, NamedTuple, get_args

import pydantic
from numpydoc.docscrape import ClassDoc
from sphinx.pycode import ModuleAnalyzer

from airpuck.boundary.files import Section
from airpuck.boundary.results import plain
from airpuck.boundary.settings import Setting, Settings, declared
from airpuck.campaigns.campaign import KINDS, Spec
from airpuck.control.lqr import LQRSettings
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import _SetPointsFile
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning, default_tuning
from airpuck.craft.table import AirHockey
from airpuck.craft.vehicle import Vehicle
from airpuck.model.quantities import QUANTITIES
from airpuck.model.sections import ModelFile
from airpuck.planning.plan import _PlanFile
from airpuck.recording.mapping import RecordingMapping
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck_hockey.matches.match import Match


class Format(NamedTuple):
    """A kind of file."""

    title: str
    use: str
    schema: type
    #: Packaged values that a file overrides key by key.
    base: Any = None
    #: The table that the schema describes; by default the whole file.
    table: str = ""


FORMATS = (
    Format("Mapping file", "`--mapping`, `read_mapping`", RecordingMapping),
    Format("Vehicle file", "`--vehicle`, `read_vehicle`", Vehicle),
    Format("Model file", "`read_model`", ModelFile),
    Format("Controller tuning", "`--tuning`, `read_tuning`", Tuning, default_tuning()),
    *(
        Format(
            f"Controller tuning: law {one.law}", "`--tuning`", one, default_tuning().of(one),
            f"law.{one.law}",
        )
        for one in (LQRSettings, PredictiveSettings)
    ),
    Format("Table file", "`--table`, `read_table`", AirHockey, AirHockey()),
    Format(
        "Settings of the twin", "`--twin`, `read_twin_settings`", TwinSettings,
        default_twin_settings(),
    ),
    Format("Set points", "`--setpoints`", _SetPointsFile),
    Format("Plan of an excitation", "`--plan` of `excite`", ExcitationPlan, ExcitationPlan()),
    Format("Time-optimal plan", "`fly --plan`, `race`, `read_plan`", _PlanFile),
    Format("Campaign", "`campaign`", Spec),
    *(Format(f"Campaign: kind {name}", "`campaign`", kind) for name, kind in KINDS.items()),
    Format("Campaign: kind match", "`campaign`, with airpuck-hockey", Match),
)  # fmt: skip


def page() -> str:
    """Return the page of all formats."""
    lines = [
        "# File formats",
        "",
        "All are TOML. An unknown key is an error. The last part of a key is its unit: `delay_s` "
        "is in seconds. A file that overrides packaged values may leave out any key.",
        "",
    ]
    seen: dict[type, str] = {}
    for one in FORMATS:
        seen[one.schema] = f"the [{one.title.lower()}](#{one.title.lower().replace(' ', '-')})"
        lines += [f"## {one.title}", "", f"{summary(one.schema)} Used by {one.use}.", ""]
        lines += _tables(one, one.schema, one.table, one.base, seen)
    return "\n".join(lines)


def _tables(
    file: Format, schema: type, name: str, base: Any, seen: dict[type, str]
) -> Iterator[str]:
    """Describe a table's own keys, then the tables in it; a schema used twice only once."""
    below, rows, note = [], [], ""
    for key, kind, default in _fields(schema):
        sections = list(_sections(kind))
        value = default if base is None else getattr(base, key)
        path = f"{name}.{key}".lstrip(".")
        mark = f"`[[{path}]]`" if str(kind).startswith("tuple") else f"`[{path}]`"
        below += [(path, mark, section, value) for section in sections]
        # A comment also covers the keys below it that have none.
        note = _note(schema, key) or note
        if not sections:
            rows.append((f"`{key}`", _values(schema, key), _shown(value), note))
        elif _note(schema, key):
            rows.append((mark, "", "" if value is not ... else "required", note))
    if rows:
        yield from ("| key | values | default | meaning |", "|---|---|---|---|")
        for row in rows:
            yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
        yield ""
    for path, mark, section, value in below:
        if section in seen:
            yield from (f"{mark}: the same keys as {seen[section]}.", "")
            continue
        seen[section] = f"{mark} of the {file.title.lower()}"
        yield from (f"{mark}: {summary(section)}", "")
        yield from _tables(file, section, path, value if isinstance(value, section) else None, seen)


def summary(schema: type) -> str:
    """Return the first sentence of a class's own docstring, without labels of the paper."""
    text = inspect.cleandoc(vars(schema).get("__doc__") or "").partition("\n\n")[0]
    return " ".join(re.sub(r" \(\w+:\w+\)", "", text).replace("``", "`").split())


def _fields(schema: type) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, type and default of each key; without a default `...`."""
    if issubclass(schema, pydantic.BaseModel):
        for key, field in schema.model_fields.items():
            required = ... if field.is_required() else field.get_default(call_default_factory=True)
            yield field.alias or key, field.annotation, required
    else:
        for one in declared(schema):
            yield one.name, one.kind, one.default


def _sections(kind: Any) -> Iterator[type[Section]]:
    """Yield the tables in a type."""
    if inspect.isclass(kind) and issubclass(kind, Section):
        yield kind
    for inner in get_args(kind):
        yield from _sections(inner)


def _setting(schema: type, key: str) -> Setting | None:
    """Return what a settings class, or a section that inherits from one, declares of a key."""
    fields = declared(schema) if issubclass(schema, Settings) else ()
    return next((one.setting for one in fields if one.name == key), None)


def _note(schema: type, key: str) -> str:
    """Return what the source says of a key, in a comment `#:` or its class's Attributes."""
    if setting := _setting(schema, key):
        return setting.help
    if found := attribute_note(schema, key):
        return found
    return next((q.meaning for q in QUANTITIES if key in (q.key, *q.settings)), "")


def attribute_note(holder: type, key: str) -> str:
    """Return what the source of a class says of an attribute or property."""
    for one in holder.__mro__:
        if not one.__module__.startswith("airpuck"):
            continue
        comments = ModuleAnalyzer.for_module(one.__module__).find_attr_docs()
        found = comments.get((one.__name__, key)) or _attributes(one).get(key)
        if found is None and isinstance(vars(one).get(key), (property, cached_property)):
            found = [(inspect.getdoc(vars(one)[key]) or "").partition("\n\n")[0]]
        if found:
            return " ".join(" ".join(found).split()).replace("``", "`")
    return ""


@cache
def _attributes(holder: type) -> dict[str, list[str]]:
    """Return the section Attributes of a class."""
    found = ClassDoc(holder, config={"show_class_members": False})["Attributes"]
    return {name.strip(): one.desc for one in found for name in one.name.split(",")}


def _values(schema: type, key: str) -> str:
    """Return the type and the range of a key, from its JSON schema or its setting."""
    setting = _setting(schema, key)
    if setting is not None and setting.within is not None:
        return f"{setting.within.low:g} to {setting.within.high:g}"
    whole = _json_schema(schema)
    return _type(whole["properties"][key], whole.get("$defs", {}))


@cache
def _json_schema(schema: type) -> dict[str, Any]:
    return pydantic.TypeAdapter(schema).json_schema(mode="validation")


def _type(one: dict[str, Any], tables: dict[str, Any]) -> str:
    """Write a JSON schema in a few words."""
    if "$ref" in one:
        return _type(tables[one["$ref"].rpartition("/")[2]], tables)
    if "enum" in one or "const" in one:
        return " or ".join(f"`{json.dumps(v)}`" for v in one.get("enum") or [one["const"]])
    if several := one.get("anyOf") or one.get("oneOf"):
        known = (_type(inner, tables) for inner in several if inner.get("type") != "null")
        return " or ".join(dict.fromkeys(known))
    if one.get("type") == "array":
        inner = one.get("items") or next(iter(one.get("prefixItems", ())), {})
        count = one.get("maxItems") if one.get("maxItems") == one.get("minItems") else ""
        return f"list of {count or ''} {_type(inner, tables)}".replace("  ", " ")
    names = {"object": "table", "integer": "whole number", "boolean": "`true` or `false`"}
    ends = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = [f"{sign} {one[name]:g}" for name, sign in ends.items() if name in one]
    kind = one.get("type", "")
    return ", ".join(filter(None, [names.get(kind, kind), *limits]))


def _shown(value: Any) -> str:
    """Write a default as TOML does."""
    if value is ...:
        return "required"
    return f"`{json.dumps(plain(value))}`" if value not in (None, "", (), {}) else ""
