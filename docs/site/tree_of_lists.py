"""The tree of pages from the lists of links in index.md, which also read on a code host."""

from __future__ import annotations

import re

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

_ENTRY = re.compile(r"^[-*] \[(?P<title>[^\]]+)\]\((?P<page>[\w./-]+)\.(?:md|ipynb)\)", re.MULTILINE)

# Another page of the project that is none of docs/: it is taken along as a file.
_BEYOND = re.compile(r"\]\(((?:\.\./)+(?:sample_data/[^)#]*|CHANGELOG|CONTRIBUTING|README)\.md)\)")


def _toctree(title: str, section: str) -> str:
    entries = "\n".join(f"{entry['title']} <{entry['page']}>" for entry in _ENTRY.finditer(section))
    return f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n{entries}\n```\n" if entries else ""


def add_trees(app: Sphinx, page: str, source: list[str]) -> None:
    """Add to an index a hidden tree for the list below each of its headings."""
    if page.rpartition("/")[2] == "index":
        _, *parts = re.split(r"^#+ (.+)$", source[0], flags=re.MULTILINE)
        trees = [_toctree(title, section) for title, section in zip(parts[::2], parts[1::2], strict=True)]
        source[0] = "\n".join([source[0], *trees])
    source[0] = _BEYOND.sub(r"](path:\1)", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every page's source before it is parsed."""
    app.connect("source-read", add_trees)
    app.add_lexer("csv", TextLexer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
