"""Each equation of the paper is where docs/method.md states, under the paper's label."""

import importlib
import re
from pathlib import Path

import airpuck

ROOT = Path(airpuck.__file__).parent
TABLE = (Path(__file__).parents[1] / "docs" / "method.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\|[^|]+\| `(\w+:\w+)` \| `([\w.]+)`", TABLE, re.MULTILINE)
LABELS = {label for label, _ in ROWS} | {"sec:results", "fig:hovercraft", "fig:overview"}
KINDS = "|".join(sorted({label.partition(":")[0] for label in LABELS}))
#: `eq. thrust_poly`, or any other label in full.
LABEL = re.compile(rf"\beq\. (\w+)|\b((?:{KINDS}):\w+)")


def labels_in(text: str) -> set[str]:
    return {f"eq:{equation}" if equation else other for equation, other in LABEL.findall(text)}


def test_the_table_of_equations_is_parsed():
    assert len(ROWS) >= 28


def text_of(name: str) -> str:
    """Docstrings of a function or class and of its module."""
    module, _, function = name.rpartition(".")
    here = importlib.import_module(module)
    return f"{here.__doc__}\n{getattr(here, function).__doc__}"


def test_each_equation_is_implemented_where_stated():
    assert not [(label, name) for label, name in ROWS if label not in labels_in(text_of(name))]


def test_only_labels_of_the_paper_are_cited():
    cited = {path: labels_in(path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")}
    assert not {str(path): unknown for path, names in cited.items() if (unknown := names - LABELS)}
