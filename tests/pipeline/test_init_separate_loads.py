"""`truing init` finds loads in one file and signals in another, and asks how their rows belong together."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init
from tests.pipeline.test_init_loads import CHANNELS, COMPONENTS, LOADS, SIGNALS
from truing.formats.raw_tables import WRENCH
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.schemas.faults import CampaignFaults


def _text(names: list[str], values: np.ndarray, key: str = "") -> str:
    steps = range(1, len(values) + 1)
    rows = [
        ",".join([*([str(step)] if key else []), *map("{:g}".format, row)])
        for step, row in zip(steps, values, strict=True)
    ]
    return "\n".join([",".join([*([key] if key else []), *names]), *rows]) + "\n"


def _ingested(folder: Path) -> np.ndarray:
    """Loads of the signals, as `truing check` reads them."""
    tables = check_campaign(open_campaign(folder)).ingested
    assert tables is not None
    return np.column_stack([tables["signals"].column(name).to_numpy() for name in WRENCH])


@pytest.mark.parametrize(("key", "way"), [("Step", "step"), ("", "rows")])
def test_loads_and_channels_of_one_bench_are_joined(tmp_path: Path, key: str, way: str) -> None:
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS, key))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS, key))
    _, document = init(tmp_path)
    assert (document["files"]["loads"]["path"], document["files"]["loads"]["joined_by"]) == ("weights.csv", way)
    assert document["files"]["signals"]["path"] == "bridges.csv"
    assert (_ingested(tmp_path) == LOADS).all()


def test_an_answer_joins_by_the_order_of_rows_where_steps_differ(tmp_path: Path) -> None:
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS, "Step"))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS, "Step"))
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "join=rows"])
    assert done.exit_code == 0, done.stdout
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["files"]["loads"]["joined_by"] == "rows"
    assert "# check: rows of loads" not in text


def test_an_assumed_order_of_rows_is_marked_as_a_guess(tmp_path: Path) -> None:
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS))
    init(tmp_path)
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert f"# check: rows of loads are taken to belong to those of bridges.csv in the same order: {len(LOADS)}" in text


def test_different_numbers_of_rows_without_a_key_are_not_joined(tmp_path: Path) -> None:
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS[:-1]))
    assert "loads" not in init(tmp_path)[1]["files"]
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert f"weights.csv holds loads, but {len(LOADS)} rows and not {len(LOADS) - 1}" in text


def test_several_files_of_loads_are_left_to_the_user(tmp_path: Path) -> None:
    for name in ("weights.csv", "plan.csv"):
        (tmp_path / name).write_text(_text(COMPONENTS, LOADS + (name == "plan.csv")))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS))
    assert "loads" not in init(tmp_path)[1]["files"]


def test_rows_that_an_edited_mapping_cannot_join_are_a_fault(tmp_path: Path) -> None:
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS))
    (tmp_path / "bridges.csv").write_text(_text(CHANNELS, SIGNALS))
    init(tmp_path)
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS[:-1]))
    with pytest.raises(CampaignFaults) as faults:
        check_campaign(open_campaign(tmp_path))
    assert [(fault.file, fault.value) for fault in faults.value.faults] == [("weights.csv", f"{len(LOADS) - 1} rows")]


def test_gauges_have_the_unit_that_words_above_them_state(tmp_path: Path) -> None:
    names = [f"G{number}" for number in range(len(CHANNELS))]
    (tmp_path / "weights.csv").write_text(_text(COMPONENTS, LOADS))
    (tmp_path / "gauges.csv").write_text("Serial Number: FT21345\nUnits: Volts\n" + _text(names, SIGNALS))
    _, document = init(tmp_path)
    keys = document["files"]["signals"]
    assert (keys["path"], document["files"]["loads"]["path"]) == ("gauges.csv", "weights.csv")
    assert keys["columns"]["v1_mv"] == "G0"
    assert set(keys["units"].values()) == {"V"}
