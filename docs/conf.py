"""Sphinx settings: the pages of docs/ become a folder of their version in build/docs/html (`make docs`), offline."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "site")]

import truing  # noqa: E402

project = "truing"
author = "The truing authors"
copyright = "The truing authors, BSD 3-Clause"
version = release = truing.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
extensions += [
    "equations",
    "tree_of_lists",
    "docstrings",
    "notebooks",
    "search_excerpts",
    "search_symbols",
    "versions",
]  # in docs/site
exclude_patterns = ["experiments", "site"]
source_suffix = {".md": "markdown"}

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # a generated page may skip a level

nitpicky = True
# Types of numpy, of the standard library and of the inner rooms have no page here; public names do.
nitpick_ignore_regex = [("py:.*", r"(?!truing\.\w+$).*")]
smartquotes = False  # it takes the hyphens of --options for a dash

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "NDArray")}  # as they are written
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"
default_role = "code"

html_theme = "furo"
html_title = f"truing {release}"
html_static_path = ["site/static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it fetches pages, which a file may not: search_excerpts has their texts
pygments_style = "friendly"
pygments_dark_style = "monokai"

# `make links` asks the network; everything else here does without.
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_anchors = False
