"""`import truing` is fast, lists its public names, and has the version of CHANGELOG.md."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import Any

import numpy as np

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
    assert len(truing.__all__) < 120
    assert len(truing._GROUPS) == 5
    assert sum(len(names) for modules in truing._GROUPS.values() for names in modules.values()) == len(truing.__all__)
    assert sorted(truing._MODULES) == truing.__all__
    assert all(getattr(truing, name).__module__.startswith("truing.") for name in truing.__all__)
    assert set(truing.__all__) <= set(dir(truing))


def _measured() -> dict[str, Any]:
    """Return the names that docs/in-python.md takes as given: points and their survey, exact poses and readings."""
    rng, angle, side = np.random.default_rng(1), np.arange(6) * np.pi / 3, 0.3 * (-1.0) ** np.arange(6)
    a, b = (
        radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
        for radius, turn in ((0.2, angle + side), (0.1, angle - side))
    )
    length, rho0, survey = np.full(6, 0.25), np.full(6, 0.1), rng.normal(0.0, 0.1, (8, 3))
    p, R = rng.normal([0.0, 0.0, 0.3], 0.01, (20, 3)), truing.exp_so3(rng.normal(0.0, 0.05, (20, 3)))
    rho = truing.inverse(truing.mechanism("ups", a, b, None, length, rho0), p, R)
    covariance = np.tile(1e-12 * np.eye(12), (20, 1, 1))
    given = {"a": a, "b": b, "length": length, "rho0": rho0, "p": p, "R": R, "rho": rho, "covariance": covariance}
    return given | {"survey_points": survey, "measured_points": survey[None]}


def test_the_examples_on_arrays_give_the_exact_parameters_back() -> None:
    given = _measured() | {"truing": truing}
    page = (PROJECT / "docs" / "in-python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"<!-- given: .*? -->\n```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        exec(block, given)
    assert given["fit"].status[0] == truing.FitStatus.OK
    assert given["found"].ok
    assert np.abs(given["found"].values - given["problem"].start).max() < 1e-12


def test_the_change_log_begins_with_this_version() -> None:
    headings = re.findall(r"^## (\S+)", (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert headings[0] == truing.__version__


def test_the_citation_is_of_this_version() -> None:
    assert f"\nversion: {truing.__version__}\n" in (PROJECT / "CITATION.cff").read_text(encoding="utf-8")
