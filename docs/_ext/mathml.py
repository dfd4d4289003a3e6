"""Sphinx extension: formulas as MathML, which browsers show without a script.

Nothing is loaded at view time but a font for mathematics, which is copied into the site.
"""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

#: Font with the tables that stretched brackets and sums need (SIL Open Font License).
_FONT = "STIXTwoMath-Regular.ttf"


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer `mathml`, and its font."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("build-finished", _copy_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _display(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def _copy_font(app: Any, exception: Exception | None) -> None:
    """Copy the font from the package that ships it."""
    if exception is None and app.builder.format == "html":
        font = files("ziamath") / "fonts" / _FONT
        shutil.copyfile(str(font), Path(app.outdir) / "_static" / _FONT)
