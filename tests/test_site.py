"""The documentation's site builds without a warning: no dead link, no undocumented public name."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import airpuck
import airpuck.extend
from airpuck.cli.app import known_commands

DOCS = Path(__file__).parents[1] / "docs"
#: Lines that people write in docs/; details belong beside the studies.
MOST_LINES = 5_999


@pytest.mark.slow
def test_the_site_builds_without_warnings(tmp_path):
    # A copy, since pages are generated into it; the notebooks run in `make docs` only.
    shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns("_build", "reference"))
    for folder in ("examples", "studies", "benchmarks", "packages"):
        shutil.copytree(DOCS.parent / folder, tmp_path / folder)
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", "site"],
        cwd=tmp_path,
        env={**os.environ, "AIRPUCK_DOCS_NOTEBOOKS": "off"},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    pages = "".join(path.read_text() for path in (tmp_path / "site").rglob("*.html"))
    names = {f"airpuck.{name}" for name in dir(airpuck)} - {"airpuck.plot"}  # a module
    assert not {name for name in names if f'id="{name}"' not in pages}
    assert 'id="airpuck.report.plot.thrust"' in pages
    assert pages.count('id="airpuck.extend.') >= len(dir(airpuck.extend)) - 3  # three are modules
    loaded = re.findall(r"<(?:script|img|link|iframe)[^>]*(?:src|href)=\"https?://[^>]*", pages)
    assert not loaded  # a page needs no other host when it is viewed
    formulas = (tmp_path / "site" / "method.html").read_text()
    assert '<div class="formula" tabindex="0"><math' in formulas
    assert (tmp_path / "site" / "_static" / "STIXTwoMath-Regular.ttf").exists()


def texts(source: str) -> set[str]:
    """All strings of a module; `…` stands for what an f-string inserts."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            parts = (p.value if isinstance(p, ast.Constant) else "…" for p in node.values)
            found.add("".join(map(str, parts)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def test_messages_quoted_in_troubleshooting_exist():
    page = (DOCS / "troubleshooting.md").read_text("utf-8")
    quoted = re.findall(r"^\| `(.*?)` \|", page, re.MULTILINE)
    folders = (DOCS.parent / "src", *DOCS.parent.glob("packages/*/src"))
    sources = [path for folder in folders for path in folder.rglob("*.py")]
    known = "\0".join(text for path in sources for text in texts(path.read_text("utf-8")))
    assert len(quoted) > 30
    unknown = [
        message
        for message in quoted
        if not re.search("[^\0]*?".join(map(re.escape, message.split("…"))), known)
    ]
    assert not unknown


def test_commands_on_pages_exist_with_their_options():
    commands = known_commands()
    pages = [*DOCS.rglob("*.md"), *DOCS.parent.glob("*.md"), *DOCS.parent.glob("examples/*.md")]
    pages += [*DOCS.parent.glob("studies/*.md"), *DOCS.parent.glob("benchmarks/*.md")]
    wrong, count = {}, 0
    for page in pages:
        if {"_build", "reference"} & set(page.parts) or page.name == "CHANGELOG.md":
            continue
        text = page.read_text("utf-8")
        for name, words in re.findall(r"(?:^    |`)airpuck ([a-z][a-z-]+)([^`\n#|]*)", text, re.M):
            command, count = commands.get(name), count + 1
            known = {o for p in command.params for o in p.opts} if command else set()
            options = re.findall(r"(?<!\S)--?[a-z][a-z-]*", words)
            unknown = [option for option in options if option not in {*known, "--help-all"}]
            if command is None or unknown:
                wrong[f"{page.name}: airpuck {name}{words}"] = unknown
    assert count > 100
    assert not wrong


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub names them."""
    text = re.sub(r"^(```+).*?^\1", "", page.read_text("utf-8"), flags=re.S | re.M)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", title).lower() for title in titles)
    return {re.sub(r"[^\w\- ]", "", title).strip().replace(" ", "-") for title in plain}


def test_links_between_pages_lead_to_existing_headings():
    root = DOCS.parent
    pages = [*root.glob("*.md"), *DOCS.rglob("*.md")]
    for folder in ("studies", "benchmarks", "examples"):
        pages += (root / folder).rglob("*.md")
    dead, count = [], 0
    for page in pages:
        if {"_build", "reference"} & set(page.relative_to(root).parts):
            continue
        text = re.sub(r"^(```+).*?^\1|`[^`]*`", "", page.read_text("utf-8"), flags=re.S | re.M)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            path, _, anchor = link.partition("#")
            if ":" in link or "reference/" in path:  # other sites, and pages made for the site
                continue
            target, count = (page.parent / path if path else page), count + 1
            if not target.exists() or (anchor and anchor not in anchors(target)):
                dead.append(f"{page.relative_to(root)}: {link}")
    assert count > 300
    assert not dead


def test_the_guides_stay_short():
    written = [
        page
        for page in DOCS.rglob("*.md")
        if not {"_build", "reference", "tables"} & set(page.relative_to(DOCS).parts)
    ]
    lines = sum(len(page.read_text("utf-8").splitlines()) for page in written)
    assert lines <= MOST_LINES
    assert len((DOCS / "results.md").read_text("utf-8").splitlines()) <= 150


def test_no_line_starts_with_a_percent_sign():
    # MyST reads it as a comment, and the rest of the line disappears from the page.
    pages = [*DOCS.rglob("*.md"), *DOCS.parent.glob("examples/*.md")]
    text = {
        page: re.sub(r"^(```+|:::+).*?^\1", "", page.read_text("utf-8"), flags=re.S | re.M)
        for page in pages
        if not {"_build", "reference"} & set(page.parts)
    }
    assert len(text) > 30
    assert not [str(page) for page in text if re.search(r"^ {0,3}%", text[page], re.MULTILINE)]
