"""Excerpts below search results that also work for pages opened from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

_TEXTS, _SCRIPT = "page_texts.js", "search_excerpts.js"
_NO_TEXT = (nodes.raw, nodes.comment, nodes.math, nodes.math_block)


def page_text(doctree: nodes.document) -> str:
    """The words of a page in one line, without equations and drawings."""
    found = [node.astext() for node in doctree.findall(nodes.Text) if not isinstance(node.parent, _NO_TEXT)]
    return " ".join(" ".join(found).split())


def _add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    if page == "search":
        app.add_js_file(_TEXTS)
        app.add_js_file(_SCRIPT)


def _write_texts(app: Sphinx, error: Exception | None) -> None:
    if error is not None or app.builder.format != "html":
        return
    texts = {name: page_text(app.env.get_doctree(name)) for name in sorted(app.env.found_docs)}
    place = Path(app.outdir) / "_static" / _TEXTS
    place.write_text(f"const PAGE_TEXTS = {json.dumps(texts, ensure_ascii=False)};\n", encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the excerpts to the page of results alone."""
    app.connect("html-page-context", _add_scripts)
    app.connect("build-finished", _write_texts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
