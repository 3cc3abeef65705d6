"""Run the command line, and read its output."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from typer.testing import CliRunner

from truing.pipeline.command_line import app


def call(*words: object) -> str:
    """Call `truing` and return what it printed; fails unless it ended well or a quality check alone failed."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.output


def run(folder: Path, stage: str, out: Path) -> dict[str, pd.DataFrame]:
    """Run a campaign up to a stage; return its tables by name."""
    call("run", folder, "--only", stage, "--out", out, "--quiet")
    return {path.stem: pd.read_parquet(path) for path in sorted(out.glob("*.parquet"))}


def figure(tables: dict[str, pd.DataFrame], model: str, name: str, **where: str) -> float:
    """One figure of model_choice."""
    where = {"deformation": "none", "estimator": "errors-in-variables", **where}
    rows = tables["model_choice"].query("model == @model and figure == @name")
    for column, value in where.items():
        rows = rows[rows[column] == value]
    assert len(rows) == 1, f"{model} {name} {where}: {len(rows)} rows"
    return float(rows["value"].iloc[0])
