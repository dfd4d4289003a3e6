"""A page of text, tables and figures in one file, which needs nothing from outside."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from airpuck.boundary.outputs import replacing
from airpuck.report.style import drawn

#: Letters in a line of a table that still fits on a page.
_WIDE = 110


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure and what to see in it."""

    #: Name of its file, without the suffix.
    name: str
    #: A figure, which becomes a PNG, or the text of an SVG.
    figure: Figure | str
    #: Plain text.
    caption: str


@dataclass(frozen=True)
class PageTable:
    """A table."""

    #: Plain text.
    caption: str
    #: One for each column.
    headings: Sequence[str]
    #: Texts of the cells; the first of a row names it.
    rows: Sequence[Sequence[str]]
    #: A line above the headings: texts, and how many columns each spans.
    groups: Sequence[tuple[str, int]] = ()
    #: Row and column of cells to stress.
    marked: frozenset[tuple[int, int]] = frozenset()

    @property
    def wide(self) -> bool:
        """Whether it needs smaller letters to fit on a page."""
        columns = zip(self.headings, *self.rows, strict=True)
        return sum(3 + max(map(len, column)) for column in columns) > _WIDE


@dataclass(frozen=True)
class Text:
    """Paragraphs, or a list."""

    #: Plain text.
    paragraphs: Sequence[str]
    #: Whether they are the items of a list.
    bullets: bool = False


@dataclass(frozen=True)
class Details:
    """What only some readers want: folded away until they open it."""

    #: What it holds.
    summary: str
    #: Its content.
    blocks: Sequence[PageTable | Text]


Block = Picture | PageTable | Text | Details


@dataclass(frozen=True)
class PageSection:
    """A section of a page."""

    #: Its name in links.
    anchor: str
    #: Its heading.
    title: str
    #: Its content.
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Origin:
    """Where a page comes from."""

    #: When it was made.
    date: str
    #: The command line that made it.
    command: str


def write_page(
    out: str | os.PathLike[str],
    title: str,
    lead: str,
    sections: Sequence[PageSection],
    origin: Origin | None = None,
) -> Path:
    """Write a page as ``index.html`` and its pictures as files in ``figures``.

    The page holds its pictures within itself, so that it can be sent alone. Beside the PNG that it
    shows, each figure is there as a PDF. Each file is written to a temporary name and renamed; the
    page comes last.

    Parameters
    ----------
    out : path-like
        Folder to write to.
    title, lead : str
        Plain text.
    sections : sequence of PageSection
        Content.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    folder = Path(out)
    images = {}
    pictures = (b for section in sections for b in section.blocks if isinstance(b, Picture))
    for picture in pictures:
        if isinstance(picture.figure, str):
            files, media = {"svg": picture.figure.encode()}, "svg+xml"
        else:
            files, media = {name: drawn(picture.figure, name) for name in ("png", "pdf")}, "png"
        encoded = base64.b64encode(next(iter(files.values()))).decode("ascii")
        images[picture.name] = f"data:image/{media};base64,{encoded}"
        for suffix, content in files.items():
            with replacing(folder / "figures" / f"{picture.name}.{suffix}") as temporary:
                temporary.write_bytes(content)
    content = {"title": title, "lead": lead, "sections": sections, "origin": origin}
    page = render("report.html.jinja", **content, images=images)
    path = folder / "index.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def packaged_text(name: str) -> str:
    """Read a text that comes with the package."""
    return (resources.files("airpuck") / "packaged" / name).read_text("utf-8")


def render(template: str, **values: Any) -> str:
    """Fill in a template that comes with the package; values are escaped."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(packaged_text(template)).render(**values)
