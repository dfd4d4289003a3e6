"""Sphinx extension: formulas as MathML, which browsers show without a script.

Nothing is loaded at view time but a font for mathematics, which is copied into the site.
"""

from __future__ import annotations

import re
import shutil
from importlib.resources import files
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util.logging import getLogger

#: Font with the tables that stretched brackets and sums need (SIL Open Font License).
_FONT = "STIXTwoMath-Regular.ttf"
#: Primes as superscripts; the font's primes are raised already.
_PRIMED = re.compile(r"<msup>(<mi>[^<]*</mi>)<mi>(&#x0203[23];)</mi></msup>")


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer `mathml`, and its font."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("build-finished", _copy_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(_converted(node, "inline"))
    raise nodes.SkipNode


def _display(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="formula" tabindex="0">{_converted(node, "block")}</div>')
    raise nodes.SkipNode


def _converted(node: nodes.Element, display: str) -> str:
    """Return a formula as MathML; warn of commands that the converter copies as text."""
    formula = _PRIMED.sub(
        r'\1<mo lspace="0" rspace="0">\2</mo>', convert(node.astext(), display=display)
    )
    if "\\" in formula or "<mi>&</mi>" in formula:
        getLogger(__name__).warning("cannot convert the formula %s", node.astext(), location=node)
    return formula


def _copy_font(app: Any, exception: Exception | None) -> None:
    """Copy the font from the package that ships it."""
    if exception is None and app.builder.format == "html":
        font = files("ziamath") / "fonts" / _FONT
        shutil.copyfile(str(font), Path(app.outdir) / "_static" / _FONT)
