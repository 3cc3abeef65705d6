"""`import truing`: quick, explicit, and of the version that the change log speaks of."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import truing
from tests.packaging.source_tree import PROJECT

HEAVY = {
    "dask", "duckdb", "ezc3d", "jinja2", "numba", "open3d", "pandas", "plotly", "polars", "pyarrow", "pydantic",
    "rich", "scipy", "typer",
}  # fmt: skip


def test_importing_truing_loads_no_heavy_library() -> None:
    program = "import json, sys, truing; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=PROJECT, check=True, capture_output=True, text=True
    ).stdout
    assert not HEAVY & set(json.loads(loaded))


def test_every_public_name_is_there() -> None:
    assert sorted(truing._HOME) == truing.__all__
    assert all(getattr(truing, name).__module__.startswith("truing.") for name in truing.__all__)
    assert set(truing.__all__) <= set(dir(truing))


def test_the_change_log_begins_with_this_version() -> None:
    headings = re.findall(r"^## (\S+)", (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert headings[0] == truing.__version__
