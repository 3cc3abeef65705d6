"""Faults of broken campaigns: file, row, column, value and expectation; no traceback, nothing half-written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.broken.cases import CASES, write_broken
from tests.broken.good import CAMPAIGNS
from tests.broken.spoiling import Broken
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_broken_campaign_is_reported(case: Broken, tmp_path: Path) -> None:
    campaign = write_broken(case, tmp_path / "campaign")
    before = _contents(campaign)
    until = [] if case.whole else ["--only", "qa"]
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(tmp_path / "run"), "--quiet", *until])
    assert done.exit_code == case.code, done.output
    assert [wanted for wanted in case.says if not re.search(wanted, done.output)] == [], done.output
    assert "Traceback" not in done.output
    assert "Warning" not in done.output
    assert _contents(campaign) == before  # a raw file is never touched
    assert {path.name for path in tmp_path.iterdir()} <= {"campaign", "run"}
    assert not list(tmp_path.rglob("*.part"))
    if case.code == ExitCode.UNUSABLE_CAMPAIGN:
        assert not list((tmp_path / "run").rglob("*.parquet"))


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_the_campaigns_that_they_are_made_from_are_good(name: str, tmp_path: Path) -> None:
    campaign = CAMPAIGNS[name](tmp_path / "campaign")
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(tmp_path / "run"), "--quiet", "--only", "qa"])
    assert (done.exit_code, done.output) == (ExitCode.DONE, "")


def test_there_are_many_damaged_campaigns_with_distinct_names() -> None:
    names = [case.name for case in CASES]
    assert len(names) == len(set(names)) >= 100
