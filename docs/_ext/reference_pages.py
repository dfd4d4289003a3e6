"""Sphinx extension: reference pages that are generated from the package itself."""

from __future__ import annotations

import inspect
import os
import re
import sys
from pathlib import Path
from typing import Any

import file_formats
import json_keys
from sphinx.pycode import ModuleAnalyzer

import airpuck
import airpuck_hockey
from airpuck import extend

#: Folders beside docs/ whose Markdown files are pages of the site.
_OUTSIDE = ("studies", "benchmarks", "examples")
_LINK = re.compile(r"\]\(([^)\s#:]+)(#[^)\s]*)?\)")
#: A line that only links a table becomes the table.
_TABLE = re.compile(r"^\[[^\]]+\]\((\.\./docs/tables/\w+\.md)\)$", re.MULTILINE)
#: The stub file of the names for those who extend airpuck.
_STUB = Path(extend.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
#: A group of names in a stub file: title, meaning, imports.
_STUB_GROUP = re.compile(r"^# ([^:\n]+): (.+\.)\n((?:(?!#).*\n)+)", re.MULTILINE)
#: What the examples use; tests/test_docstring_examples.py runs them.
_SHARED = """Examples begin with:

```python
import airpuck
import airpuck_hockey
import numpy as np

model = airpuck.read_model("paper:M3")
recording = airpuck.excite(model, 10.0, seed=1)
trajectory = airpuck.preprocess(recording)
fit = airpuck.identify(trajectory, "M0")
```"""
#: Functions of `airpuck.export`, whose kinds are modules of their own.
_EXPORTS = (
    "write",
    "casadi.functions",
    "holohover.params_json",
    "holohover.params_yaml",
    "matlab.parameters",
    "mjcf.xml",
)


def setup(app: Any) -> dict[str, Any]:
    """Generate the pages before Sphinx reads the sources."""
    app.connect("builder-inited", _write)
    app.connect("source-read", _relink)
    return {"parallel_read_safe": True}


def _write(app: Any) -> None:
    """Write the pages whose content has changed, and remove those that are no longer there."""
    folder = Path(app.srcdir) / "reference"
    pages = {"api.md": _contents(), "commands.md": _commands(), "files.md": file_formats.page()}
    pages["json.md"] = json_keys.page()
    pages |= {f"python_{name}.rst": _members(name, names) for name, names in _groups().items()}
    pages["python_export.rst"] = _exports()
    pages["python_extend.rst"] = _extensions()
    pages |= _outside(Path(app.srcdir))
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _outside(docs: Path) -> dict[str, str]:
    """Copy the pages beside docs/, by their names on the site."""
    pages = {}
    for folder in _OUTSIDE:
        for path in (docs.parent / folder).rglob("*.md"):
            place = path.relative_to(docs.parent)
            text = _TABLE.sub(r"```{include} \1\n```", path.read_text(encoding="utf-8"))
            text = text.replace("{include} ../docs/", "{include} ../")
            pages[_site_name(place)] = _moved(text, place.parent, Path("docs/reference"))
    return pages


def _site_name(place: Path) -> str:
    """Name the page that shows a file beside docs/."""
    return "_".join(place.parts)


def _moved(text: str, home: Path, now: Path) -> str:
    """Rewrite the links of a page that is shown in another folder, relative to the project."""

    def link(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(home / match[1]))
        if target.suffix == ".md" and target.parts[0] in _OUTSIDE:
            target = Path("docs/reference") / _site_name(target)
        return f"]({os.path.relpath(target, now)}{match[2] or ''})"

    return _LINK.sub(link, text)


def _relink(app: Any, page: str, source: list[str]) -> None:
    """Redirect links to pages that exist only on the site."""
    if not page.startswith("reference/"):
        home = Path("docs") / Path(page).parent
        source[0] = _moved(source[0], home, home)


def _groups() -> dict[str, list[str]]:
    """Group the public names by package, with the names of `airpuck_hockey` last."""
    groups: dict[str, list[str]] = {}
    for name in dir(airpuck):
        home = getattr(getattr(airpuck, name), "__module__", "airpuck.report.plot")
        groups.setdefault(home.split(".")[1], []).append(f"airpuck.{name}")
    hockey = [f"airpuck_hockey.{name}" for name in dir(airpuck_hockey)]
    return dict(sorted(groups.items())) | {"air_hockey": hockey}


def _public(name: str) -> Any:
    """Return a public object by its full name."""
    package, _, own = name.rpartition(".")
    return getattr(sys.modules[package], own)


def _contents() -> str:
    """List the public names with their first sentences."""
    lines = [
        "# Python reference",
        "",
        "All names are attributes of `airpuck`, those for air hockey of `airpuck_hockey`.",
        "",
        _SHARED,
        "",
    ]
    for package, names in _groups().items():
        lines += [f"## {package}", "", "| | |", "|---|---|"]
        lines += [f"| {{py:obj}}`{name}` | {_sentence(name)} |" for name in names]
        lines.append("")
    lines += ["## export", "", "See [the functions of `airpuck.export`](python_export.rst).", ""]
    lines += [
        "## extend",
        "",
        "See [the names for those who extend airpuck](python_extend.rst).",
        "",
    ]
    pages = [f"python_{package}" for package in (*_groups(), "export", "extend")]
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", *pages, "```", ""])


def _sentence(name: str) -> str:
    """Return the first sentence of a public object's docstring, for a cell of a table."""
    sentence = (inspect.getdoc(_public(name)) or "").partition("\n\n")[0]
    return " ".join(sentence.split()).replace("|", "\\|")


def _members(package: str, names: list[str]) -> str:
    """Document the public names of a package."""
    module = names[0].rpartition(".")[0]
    lines = [f"{package}", "=" * len(package), "", f".. currentmodule:: {module}", ""]
    return "\n".join(lines + [line for name in names for line in _documented(name)])


def _documented(name: str) -> list[str]:
    """Return the directive that documents a public object."""
    found = _public(name)
    if inspect.isclass(found):
        return [f".. autoclass:: {name}", "   :members:", ""]
    if inspect.ismodule(found):
        return [f".. automodule:: {found.__name__}", "   :members:", ""]
    if inspect.isroutine(found):
        return [f".. autofunction:: {name}", ""]
    # Autodoc would describe its type, not what the comment at its definition says.
    own = name.rpartition(".")[2]
    home = re.findall(rf"from (\S+) import (?:(?!from)[^#])*?\b{own} as", _STUB)[0]
    said = ModuleAnalyzer.for_module(home).find_attr_docs()["", own]
    return [f".. py:data:: {name}", "", *(f"   {line}" for line in said), ""]


def _extensions() -> str:
    """Document the names of `airpuck.extend`, by the groups of its stub file."""
    lines = ["extend", "======", "", (extend.__doc__ or "").partition("\n\nNames by")[0], ""]
    for title, meaning, body in _STUB_GROUP.findall(_STUB):
        lines += [title, "-" * len(title), "", f"{meaning[0].upper()}{meaning[1:]}", ""]
        for name in re.findall(r"\b(\w+) as \1\b", body):
            lines += _documented(f"airpuck.extend.{name}")
    return "\n".join(lines)


def _exports() -> str:
    """Document the functions of the package `export`."""
    lines = ["export", "======", ""]
    for name in _EXPORTS:
        lines += [f".. autofunction:: airpuck.export.{name}", ""]
    return "\n".join(lines)


def _commands() -> str:
    """Describe every command with all its options."""
    from airpuck.cli.app import known_commands

    lines = [
        "# Command reference",
        "",
        "`airpuck COMMAND --help` prints the same; rare options are under `--help-all`.",
        "",
    ]
    for name, command in known_commands().items():
        help_text = inspect.cleandoc(command.help or "")
        lines += [f"## airpuck {name}", "", help_text, ""]
        rows = [row for parameter in command.params if (row := _row(parameter))]
        if rows:
            lines += ["| option | value | default | meaning |", "|---|---|---|---|", *rows, ""]
    return "\n".join(lines)


def _row(parameter: Any) -> str | None:
    """Return the row of an argument or option; None for those without help."""
    text = " ".join((getattr(parameter, "help", "") or "").split())
    if not text:
        return None
    option = parameter.param_type_name == "option"
    shown = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    choices = getattr(getattr(parameter, "type_descriptor", None), "choices", None) or ()
    value = parameter.metavar or " | ".join(map(str, choices))
    value = f"`{value}`" if value else ""
    given = parameter.default
    plain = isinstance(given, str | float | tuple | Path) and not isinstance(given, bool)
    default = " ".join(map(str, given)) if isinstance(given, tuple) else str(given)
    default = f"`{default}`" if option and plain and default else ""
    default = "required" if option and parameter.required else default
    cells = (shown, value, default, text) if option else (value, "", "", text)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
