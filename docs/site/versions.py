"""Versions of the pages in folders of their names, and the list for the version menu."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_LIST, _SCRIPT, _START = "versions.js", "version_chooser.js", "index.html"


def built_versions(folder: Path) -> list[str]:
    """Names of the folders that hold pages with a chooser, the newest version first."""
    found = [script.parents[1].name for script in folder.glob(f"*/_static/{_SCRIPT}")]
    return sorted(found, key=lambda name: [int(number) for number in re.findall(r"\d+", name)], reverse=True)


def write_list(folder: Path) -> None:
    """Write the list for the chooser, and a first page that leads to the newest version."""
    names = built_versions(folder)
    (folder / _LIST).write_text(f"showVersions({json.dumps(names)});\n", encoding="utf-8")
    leads = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={names[0]}/{_START}">'
    (folder / _START).write_text(f'{leads}<a href="{names[0]}/{_START}">truing {names[0]}</a>\n', encoding="utf-8")


def _finish(app: Sphinx, error: Exception | None) -> None:
    place = Path(app.outdir)
    if error is None and app.builder.format == "html" and place.name == app.config.release:
        write_list(place.parent)


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the chooser to every page; the list is written for pages in a folder named by their version alone."""
    app.add_js_file(_SCRIPT)
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
