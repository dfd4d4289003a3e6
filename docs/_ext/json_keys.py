"""The reference of what `--json` writes, from the classes that declare it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

from file_formats import attribute_note, summary

import airpuck
import airpuck_hockey
from airpuck.boundary.results import Result

#: Command -> the results that it writes.
COMMANDS = {
    "identify": "Fit Verdict Strengths ModelStructure Evaluation",
    "identify-puck": "PuckFit",
    "evaluate": "Evaluation BetterFrom Verdict",
    "compare": "Evaluation FitMeasures ModelDifference Drift",
    "present": "Presentation Verdict",
    "resid": "ResidualTests FitMeasures PredictionBands",
    "faults": "Strengths",
    "check": "LayoutCheck",
    "track": "Tracked",
    "tune": "Tuned Followed",
    "design": "Design CandidateFlight",
    "plan": "Plan",
    "race": "Race",
    "preflight": "Preflight",
    "fly": "LoopTiming",
    "skills": "Skill",
    "export": "Written",
}


def page() -> str:
    """Describe every result."""
    lines = [
        "# JSON keys",
        "",
        "What `--json FILE` writes, class by class; `--json -` writes to standard output. `null` "
        "stands for a number that is unknown or infinite. The last part of a key is its unit.",
        "",
        "| command | writes |",
        "|---|---|",
    ]
    for command, kinds in COMMANDS.items():
        links = (f"[{kind}](#{kind.lower()})" for kind in kinds.split())
        lines.append(f"| `{command}` | {', '.join(links)} |")
    lines.append("")
    listed = (kind for kind in _results() if not kind.__name__.startswith("_"))
    for kind in sorted(listed, key=lambda one: one.__name__):
        lines += [f"## {kind.__name__}", "", summary(kind), "", "| key | meaning |", "|---|---|"]
        lines += [f"| {key} | {note} |".replace("$", "\\$") for key, note in _keys(kind)]
        also = (inspect.getdoc(kind.to_json) or "").split("\n\n")[1:2]
        if "to_json" in vars(kind) and also[:1] and also[0].startswith("Also"):
            lines += ["", " ".join(also[0].split()).replace("``", "`")]
        lines.append("")
    plain = Path(__file__).with_name("plain_json.txt").read_text(encoding="utf-8")
    lines += ["## Commands without a class of their own", "", plain]
    return "\n".join(lines)


def _results() -> Iterator[type[Result]]:
    for package in (airpuck, airpuck_hockey):
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "packaged" not in info.name:
                importlib.import_module(info.name)
    waiting = [Result]
    while waiting:
        for kind in waiting.pop().__subclasses__():
            waiting.append(kind)
            yield kind


def _keys(kind: type[Result]) -> Iterator[tuple[str, str]]:
    for word in kind.JSON.split():
        declared, _, entries = word.partition(":")
        key, _, path = declared.partition("=")
        *owners, name = (path or key).split(".")
        holder: Any = kind
        for owner in owners:
            holder = _type(holder, owner)
        note = attribute_note(holder, name) if inspect.isclass(holder) else ""
        listed = ", ".join(f"`{entry}`" for entry in entries.split(",")) if entries else ""
        yield f"`{key}`", note + (f" ({listed})" if listed else "")


def _type(holder: Any, name: str) -> Any:
    """Return the class of an attribute; None if it is not annotated with one."""
    try:
        hint = get_type_hints(holder).get(name)
    except (NameError, TypeError):
        return None
    return next(
        (k for k in (hint, *get_args(hint)) if inspect.isclass(k) and k is not type(None)), None
    )
