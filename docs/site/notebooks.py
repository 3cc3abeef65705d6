"""Conversion of an executed notebook to a page: text, code, and stored outputs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from sphinx.application import Sphinx


class NotebookParser(MystParser):
    """Reads a notebook as the page that its cells would be."""

    supported = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Parse the cells as Markdown."""
        cells = json.loads(inputstring)["cells"]
        super().parse("\n\n".join(part for cell in cells for part in _parts(cell)), document)


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    yield _fenced("python", source)
    for output in cell["outputs"]:
        yield _left(output)


def _left(output: dict[str, Any]) -> str:
    """Content of one output: a picture before a table before text."""
    if output["output_type"] == "stream":
        return _fenced("text", "".join(output["text"]))
    data = {kind: "".join(shown) for kind, shown in output["data"].items()}
    if "image/png" in data:
        picture = data["image/png"].replace("\n", "")
        name = data["text/plain"].replace('"', "'").replace("\n", " ")
        return f'<img alt="{name}" src="data:image/png;base64,{picture}">'
    if "text/html" in data:
        return data["text/html"].replace('border="1" class="dataframe"', 'class="docutils"')
    return _fenced("text", data["text/plain"])


def _fenced(language: str, text: str) -> str:
    return f"````{language}\n{text.rstrip()}\n````"


def setup(app: Sphinx) -> dict[str, bool]:
    """Take notebooks for pages."""
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
