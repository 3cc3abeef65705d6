"""docs/force-sensor-campaign.md shows the current output of its command (`tests/stages/test_diagnose_readings.py` tests
the diagnosis itself)."""

from __future__ import annotations

import re

import pytest

from docs.experiments.force_sensor_campaign import CAMPAIGN, PAGE, compliance_table, frames_of, stage_table
from tests.conftest import PROJECT
from tests.docs.shown import assert_shown, shown
from tests.stages.line import run_line

TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def run():
    return run_line(CAMPAIGN, "ingest", "qa", "pose", "deformation")


def test_the_compliance_is_what_the_stage_leaves(run):
    assert_shown(shown(TEXT, "compliance"), compliance_table(frames_of(run[0])["compliance"]), rel=0.02)


def test_the_stages_say_what_the_page_quotes(run):
    reported, found = shown(TEXT, "stages").splitlines(), stage_table(run[1]).splitlines()
    for stage in ("ingest", "pose", "deformation"):
        quoted, output = (
            next(line for line in lines if line.startswith(f"| `{stage}`")) for lines in (reported, found)
        )
        assert_shown(quoted, output, rel=0.0)


def test_the_checks_pass_as_the_page_says(run):
    verdicts = run[0]["qa"].to_pandas().groupby("check")["verdict"].value_counts()
    for line in shown(TEXT, "checks").splitlines()[2:]:
        check, reported, _ = (cell.strip().strip("`") for cell in line.strip("|").split("|"))
        for one in reported.split(", "):
            number, _, verdict = one.partition(" ")
            assert verdicts[check, verdict] == int(number)


def test_quoted_lines_of_the_folder_exist():
    settings = (CAMPAIGN / "campaign.toml").read_text(encoding="utf-8")
    quoted = TEXT.split("```toml\n")[1].split("```")[0]
    for line in (line.partition("#")[0].strip() for line in quoted.splitlines()):
        assert line in settings.splitlines() or not line
    head, row = TEXT.split("```csv\n")[1].splitlines()[:2]
    lines = (CAMPAIGN / "interferometer.csv").read_text(encoding="utf-8").splitlines()
    assert head == lines[0]
    assert row in lines


def test_links_lead_somewhere():
    for page in re.findall(r"\]\(([\w./-]+\.md)\)", TEXT):
        assert (PROJECT / "docs" / page).exists(), page
