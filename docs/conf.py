"""Configuration of the documentation's site: `make docs`."""

import os
import sys
from pathlib import Path

import airpuck

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "airpuck"
author = "the airpuck developers"
project_copyright = author
version = release = airpuck.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx_copybutton",
    "mathml",
    "reference_pages",
]
exclude_patterns = ["_build", "_ext", "tables"]
nitpicky = False

html_theme = "furo"
html_title = "airpuck"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_theme_options = {"source_directory": "docs/"}
html_show_sphinx = False
smartquotes_action = "qe"  # Quotes and ellipses. Two hyphens begin an option, not a dash.

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
# Notebooks run when the site is built, unless nothing in them has changed.
nb_execution_mode = os.environ.get("AIRPUCK_DOCS_NOTEBOOKS", "cache")
nb_execution_timeout = 1800  # Seconds for a cell: many times what an idle machine needs.
nb_execution_raise_on_error = True
nb_merge_streams = True
# A notebook that is not executed has no lexer.
suppress_warnings = ["myst-nb.lexer"]
nb_execution_in_temp = True

autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
copybutton_selector = "div:not(.output) > div.highlight pre"


def setup(app):
    """Tell screen readers the level of the navigation's headings; let the keyboard scroll code."""

    def mended(_app, _name, _template, context, _doctree):
        for part, old, new in (
            ("furo_navigation_tree", 'role="heading"', 'role="heading" aria-level="2"'),
            ("body", "<pre>", '<pre tabindex="0">'),
        ):
            context[part] = context.get(part, "").replace(old, new)

    app.connect("html-page-context", mended, priority=900)
