"""Readings of an axis in another file than its commands, joined by order, pose or time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.schemas.faults import CampaignFaults

ROWS, PERIOD_S = 36, 60.0
BY = {way: f'joined_by = "{way}"' for way in ("rows", "pose", "time")}
TOML = """
[campaign]
name = "axis"
kind = "photogrammetry"
[mechanism]
type = "{type}"
{kind}
[noise]
measured_deg = 1e-4
[files.configurations]
path = "commands.csv"
[files.measured]
path = "readings.csv"
{keys}
"""


def _tables() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Commands and readings of the same rows, each with pose and time; readings a second later."""
    at = 10.0 * np.arange(ROWS)
    keys = {"pose": np.arange(1, ROWS + 1), "time_s": PERIOD_S * np.arange(ROWS)}
    off = np.random.default_rng(7).normal(0.0, 1e-3, ROWS)
    commands = pd.DataFrame({**keys, "command_deg": at})
    return commands, pd.DataFrame({**keys, "measured_deg": at + off}).assign(time_s=keys["time_s"] + 1.0)


def _ingested(
    folder: Path, commands: pd.DataFrame, readings: pd.DataFrame, keys: str, machine: str = "axis"
) -> tuple[pd.DataFrame, str]:
    commands.to_csv(folder / "commands.csv", index=False)
    readings.to_csv(folder / "readings.csv", index=False)
    kind = 'kind = "rotary"\ncommand = "command_deg"' if machine == "axis" else ""
    (folder / "campaign.toml").write_text(TOML.format(type=machine, kind=kind, keys=keys), encoding="utf-8")
    tables, outcomes = run_line(folder, "ingest")
    return tables["configurations"].to_pandas(), outcomes["ingest"].read


@pytest.mark.parametrize("way", BY)
def test_each_command_has_the_reading_of_its_row(tmp_path: Path, way: str) -> None:
    commands, readings = _tables()
    found, words = _ingested(tmp_path, commands, readings, BY[way])
    assert_close(found["measured_deg"], readings["measured_deg"], atol=0.0, what="readings")
    assert f"readings of {ROWS} of {ROWS} rows of commands" in words
    assert ("1 s apart" in words) == (way == "time")


@pytest.mark.parametrize("way", ["pose", "time"])
def test_a_key_joins_rows_of_another_order_and_number(tmp_path: Path, way: str) -> None:
    commands, readings = _tables()
    mixed = readings.sample(frac=1.0, random_state=3).iloc[:-4]
    found, _ = _ingested(tmp_path, commands, mixed, BY[way])
    known = mixed.set_index("pose")["measured_deg"].sort_index()
    assert found["pose"].tolist() == known.index.tolist()
    assert_close(found["measured_deg"], known, atol=0.0, what="readings")


@pytest.mark.parametrize("is_dense", ["commands", "readings"])
def test_stops_find_their_rows_in_a_recording(tmp_path: Path, is_dense: str) -> None:
    """Of a log at a constant rate and a reading at each stop, each stop gives one row, that of its time."""
    time = np.arange(0.0, PERIOD_S * ROWS, 0.5)
    at = np.interp(time, PERIOD_S * np.arange(ROWS), 10.0 * np.arange(ROWS))
    log = pd.DataFrame({"pose": np.arange(len(time)), "time_s": time, "command_deg": at, "measured_deg": at + 0.25})
    stops = log.iloc[::120].assign(time_s=lambda table: table["time_s"] + 0.1)
    commands, readings = (log, stops) if is_dense == "commands" else (stops, log)
    commands, readings = commands.drop(columns="measured_deg"), readings.drop(columns="command_deg")
    found, _ = _ingested(tmp_path, commands, readings, BY["time"])
    assert len(found) == len(stops)
    assert_close(found["measured_deg"] - found["command_deg"], np.full(ROWS, 0.25), atol=1e-12, what="deviations")


def test_a_deviation_in_its_own_unit_is_added_to_the_command(tmp_path: Path) -> None:
    commands, readings = _tables()
    off = (readings["measured_deg"] - commands["command_deg"]) * 3600.0
    table = readings[["pose"]].assign(X=off)
    keys = BY["pose"] + '\ncolumns = { deviation_deg = "X" }\nunits = { deviation_deg = "arcsec" }'
    found, _ = _ingested(tmp_path, commands, table, keys)
    assert_close(found["measured_deg"], readings["measured_deg"], atol=1e-9, what="readings")


@pytest.mark.parametrize(
    ("change", "keys", "machine", "expected"),
    [
        ("shorter", BY["rows"], "axis", "36 rows, as in commands.csv"),
        ("", "", "axis", "how its rows belong to those of configurations"),
        ("", 'joined_by = "step"', "axis", 'joined_by = "rows", "pose" or "time"'),
        ("both", BY["rows"], "axis", "columns in one file"),
        ("later", BY["time"], "axis", "rows that belong to those of commands.csv"),
        ("", BY["rows"], "none", 'type = "axis"'),
    ],
)
def test_readings_that_cannot_be_joined_are_a_fault(
    tmp_path: Path, change: str, keys: str, machine: str, expected: str
) -> None:
    commands, readings = _tables()
    if change == "shorter":
        readings = readings.iloc[:-1]
    if change == "both":
        readings = readings.assign(command_deg=1.0)
    if change == "later":
        readings = readings.assign(time_s=readings["time_s"] + 1e6)
    with pytest.raises(CampaignFaults, match=expected):
        _ingested(tmp_path, commands, readings, keys, machine)
