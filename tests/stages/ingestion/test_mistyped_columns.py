"""A text column with nearly the name of a known one is refused; other text columns are ignored."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.faults import assert_fault, faults_of
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import chain_tables

ROBOT = Path(__file__).resolve().parents[3] / "sample_data" / "robot"


def _with_head(folder: Path, old: str, new: str) -> Path:
    copied = Path(shutil.copytree(ROBOT, folder / "robot"))
    table = copied / "configurations.csv"
    head, rows = table.read_text(encoding="utf-8").split("\n", 1)
    table.write_text(f"{head.replace(old, new)}\n{rows}", encoding="utf-8")
    return copied


@pytest.mark.parametrize("name", ["roles", "rol", "rloe"])
def test_a_mistyped_role_is_a_fault_and_stops_the_campaign(tmp_path: Path, name: str) -> None:
    campaign = open_campaign(_with_head(tmp_path, "role", name))
    faults = faults_of(lambda: chain_tables(campaign, campaign.validated()))
    own = assert_fault(faults, file="configurations.csv", column=name, row=2)
    assert own.value == "calibration"
    assert "role" in own.expected.split("did you mean")[1]


def test_other_text_is_ignored(tmp_path: Path) -> None:
    campaign = open_campaign(_with_head(tmp_path, "role", "operator"))
    table = chain_tables(campaign, campaign.validated())["configurations"]
    assert "operator" not in table.column_names
    assert set(table.column("role").to_pylist()) == {"calibration"}
