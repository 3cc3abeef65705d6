"""Run docs/example.ipynb and store its outputs: `python -m docs.experiments.notebook FOLDER`.

FOLDER holds ``sample_data/telescope`` and the run ``runs/telescope`` that `truing run` makes of it; absent, the folder
that this is called from. Figures are shown by a headless Chromium; everything else is plain Python. The tag of a cell
says how far its outputs are held to what is recorded: ``exact`` anywhere, ``runs`` where they hang on the run opened.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[1] / "example.ipynb"
_CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)

Document = dict[str, Any]
Picture = Callable[[Any], str]
"""From a figure to its PNG, base64."""


def recorded() -> Document:
    """The notebook of the docs."""
    document: Document = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return document


def code_cells(document: Document) -> list[Document]:
    """The cells that are executed, in their order."""
    return [cell for cell in document["cells"] if cell["cell_type"] == "code"]


def outputs(document: Document, folder: Path, picture: Picture) -> Iterator[list[Document]]:
    """Execute the code cells in one namespace, in a folder; the outputs of each."""
    names: Document = {"__name__": "__main__"}
    with contextlib.chdir(folder):
        for cell in code_cells(document):
            yield _executed("".join(cell["source"]), names, picture)


def _executed(source: str, names: Document, picture: Picture) -> list[Document]:
    """Output of a cell, and the value of its last line where that is an expression."""
    tree, said, value = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(said):
        exec(compile(tree, "<cell>", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)
    text = said.getvalue()
    shown = [{"output_type": "stream", "name": "stdout", "text": _lines(text)}] if text else []
    return shown if value is None else [*shown, _result(value, picture)]


def _result(value: Any, picture: Picture) -> Document:
    import pandas as pd
    import plotly.graph_objects as go

    if isinstance(value, go.Figure):
        title = (value.layout.title.text or "").partition("<br>")[0]
        data = {"image/png": picture(value), "text/plain": [f"Figure: {title}"]}
    elif isinstance(value, pd.DataFrame):
        data = {"text/html": _lines(value.to_html()), "text/plain": _lines(value.to_string())}
    else:
        data = {"text/plain": _lines(repr(value))}
    return {"output_type": "display_data", "metadata": {}, "data": data}


def text_of(shown: list[Document]) -> str:
    """The outputs of a cell as plain text."""
    parts = (one["text"] if one["output_type"] == "stream" else one["data"]["text/plain"] for one in shown)
    return "\n".join("".join(part) for part in parts)


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def photographed(figure: Any) -> str:
    """A figure as Chromium shows it, PNG in base64."""
    program = next((found for name in _CHROMIUM if (found := shutil.which(name))), None)
    if program is None:
        raise SystemExit("no chromium or chrome here to show figures with")
    size = f"--window-size={figure.layout.width or 800},{figure.layout.height or 450}"
    with tempfile.TemporaryDirectory() as folder:
        page, shot = Path(folder, "figure.html"), Path(folder, "figure.png")
        html = figure.to_html(include_plotlyjs=True, config={"displayModeBar": False})
        page.write_text(html.replace("<body>", '<body style="margin:0">'), encoding="utf-8")
        command = [program, *_FLAGS, f"--user-data-dir={folder}/profile", size, f"--screenshot={shot}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        return base64.b64encode(shot.read_bytes()).decode()


def main() -> None:
    """Execute the notebook where the run lies, and write it with its outputs."""
    document = recorded()
    shown = outputs(document, Path(sys.argv[1] if len(sys.argv) > 1 else os.curdir).resolve(), photographed)
    for count, (cell, own) in enumerate(zip(code_cells(document), shown, strict=True), start=1):
        cell["execution_count"], cell["outputs"] = count, own
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8")
    sys.stdout.write(f"{NOTEBOOK}: {len(text) / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
