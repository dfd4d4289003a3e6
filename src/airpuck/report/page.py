"""Pages of text, tables and figures in one self-contained file."""

from __future__ import annotations

import base64
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airpuck.boundary.outputs import packaged_text, rendered, replacing
from airpuck.model.quantities import QUANTITIES
from airpuck.model.rungs import RUNGS
from airpuck.report.style import drawn
from airpuck.report.tables import PageTable as PageTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption."""

    #: File name without the suffix.
    name: str
    #: A figure, written as PNG and PDF, or the text of an SVG.
    figure: Figure | str
    #: Plain text.
    caption: str
    #: Whether an SVG moves: as an element of the page it follows the reader's preferences.
    moves: bool = False


@dataclass(frozen=True)
class Text:
    """Paragraphs, or a list."""

    #: Plain text.
    paragraphs: Sequence[str]
    #: Whether the paragraphs are items of a bulleted list.
    bullets: bool = False


@dataclass(frozen=True)
class Details:
    """Blocks that stay folded until a reader opens them."""

    #: Label of the fold.
    summary: str
    blocks: Sequence[PageTable | Text]


Block = Picture | PageTable | Text | Details


@dataclass(frozen=True)
class PageSection:
    """A section of a page."""

    #: Name in links.
    anchor: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Origin:
    """Command and date, for the foot of a page."""

    #: Time at which the page was made.
    date: str
    #: Command line that made the page.
    command: str


def write_page(
    out: str | os.PathLike[str],
    title: str,
    lead: str,
    sections: Sequence[PageSection],
    origin: Origin | None = None,
) -> Path:
    """Write a page as ``index.html`` and its pictures as files in ``figures``.

    The page embeds its pictures, so it can be sent as a single file. ``figures`` holds each figure
    as PNG and PDF. Each file is written under a temporary name and renamed, the page last.

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
    # The answer stands before the contents.
    answers = sum(section.anchor == "summary" for section in sections[:1])
    shown = {"title": title, "lead": lead, "sections": sections, "origin": origin}
    extras = {"answers": answers, "words": _words(lead, sections), "with_code": _with_code}
    page = rendered("report.html.jinja", **shown, **extras, images=images)
    path = folder / "index.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _words(lead: str, sections: Sequence[PageSection]) -> list[tuple[str, str]]:
    """Return the names on a page that need an explanation, and what they mean."""
    text = " ".join([lead, *(t for section in sections for b in section.blocks for t in _texts(b))])
    words = {name: rung.summary for name, rung in RUNGS.items()}
    words |= {quantity.symbol: quantity.meaning for quantity in QUANTITIES}
    words |= tomllib.loads(packaged_text("words.toml"))
    return [
        (word, meaning[0].upper() + meaning[1:])
        for word, meaning in words.items()
        if re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text)
    ]


def _texts(block: Block) -> list[str]:
    """Return the texts of a block."""
    if isinstance(block, Details):
        return [text for inside in block.blocks for text in _texts(inside)]
    if isinstance(block, Text):
        return list(block.paragraphs)
    if isinstance(block, Picture):
        return [block.caption]
    return [block.caption, *block.headings, *(row[0] for row in block.rows)]


def _with_code(text: str) -> Any:
    """Escape a text, and set what stands between backticks as code."""
    import markupsafe

    escaped = str(markupsafe.escape(text))
    return markupsafe.Markup(re.sub("`([^`]*)`", r"<code>\1</code>", escaped))
