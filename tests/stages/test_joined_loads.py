"""Loads of one instrument joined to signals of another by order, step or time, always with a message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.sentences import assert_says
from tests.stages.line import run_line
from truing.schemas.faults import CampaignFaults

LOADS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
LARGEST = np.array([500.0, 500.0, 1000.0, 30.0, 30.0, 30.0])
STEPS = 40
PERIOD_S = 60.0
SIGMA_MV = 3e-4


def _tables(seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Loads and signals of the same steps, each with run, step and time."""
    rng = np.random.default_rng(seed)
    load = np.vstack([np.zeros((1, 6)), rng.uniform(-1.0, 1.0, (STEPS - 1, 6)) * LARGEST])
    gains = (np.eye(6) + 0.1 * rng.normal(size=(6, 6))) * 1.5 / LARGEST
    signal = load @ gains.T + SIGMA_MV * rng.normal(size=load.shape)
    same = {"run": 1, "step": np.arange(1, STEPS + 1), "time_s": PERIOD_S * np.arange(STEPS)}
    signals = pd.DataFrame(same | {f"v{k + 1}_mv": signal[:, k] for k in range(6)})
    return pd.DataFrame(same | dict(zip(LOADS, load.T, strict=True))), signals


def _run(
    folder: Path,
    loads: pd.DataFrame,
    signals: pd.DataFrame,
    joined_by: str,
    stages: str = "ingest qa",
    signals_keys: str = "",
) -> Any:
    loads.to_csv(folder / "weights.csv", index=False)
    signals.to_csv(folder / "bridges.csv", index=False)
    text = f'[campaign]\nname = "two"\nkind = "interferometer"\n[noise]\nsignal_mv = {SIGMA_MV}\n'
    text += f'[files.loads]\npath = "weights.csv"\n{joined_by}\n[files.signals]\npath = "bridges.csv"\n{signals_keys}'
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return run_line(folder, *stages.split())


def _check(tables: Any) -> Any:
    return tables["qa"].to_pandas().set_index("check").loc["loads-joined"]


BY = {way: f'joined_by = "{way}"' for way in ("rows", "step", "time")}


@pytest.mark.parametrize("way", ["rows", "step", "time"])
def test_each_signal_has_the_load_of_its_step(tmp_path: Path, way: str) -> None:
    loads, signals = _tables(1)
    tables, outcomes = _run(tmp_path, loads, signals, BY[way])
    assert (tables["signals"].to_pandas()[list(LOADS)].to_numpy() == loads[list(LOADS)].to_numpy()).all()
    (row,) = tables["loads_joined"].to_pylist()
    assert (row["joined_by"], row["signal_rows"], row["load_rows"], row["rows_matched"]) == (way, STEPS, STEPS, STEPS)
    assert f"loads of {STEPS} of {STEPS} rows of signals" in outcomes["ingest"].read
    assert _check(tables)["verdict"] == "pass"


@pytest.mark.parametrize("way", ["step", "time"])
def test_a_key_joins_rows_of_another_order_and_number(tmp_path: Path, way: str) -> None:
    loads, signals = _tables(2)
    mixed = loads.sample(frac=1.0, random_state=3).iloc[:-4]
    tables, _ = _run(tmp_path, mixed, signals, BY[way])
    found = tables["signals"].to_pandas().set_index("step")
    known = mixed.set_index("step").sort_index()
    assert found.index.tolist() == known.index.tolist()
    assert (found[list(LOADS)] == known[list(LOADS)]).all(axis=None)
    assert tables["exclusions"].to_pandas()["rows"].sum() == 4
    assert _check(tables)["verdict"] == "warn"


def test_different_numbers_of_rows_without_a_key_are_a_fault(tmp_path: Path) -> None:
    loads, signals = _tables(3)
    with pytest.raises(CampaignFaults) as faults:
        _run(tmp_path, loads.iloc[:-1], signals, BY["rows"])
    (fault,) = faults.value.faults
    assert (fault.file, fault.value) == ("weights.csv", f"{STEPS - 1} rows")
    assert f"{STEPS} rows, as in bridges.csv" in fault.expected


def test_nothing_is_joined_unless_the_mapping_says_how(tmp_path: Path) -> None:
    with pytest.raises(CampaignFaults) as faults:
        _run(tmp_path, *_tables(4), "")
    (fault,) = faults.value.faults
    assert (fault.file, fault.column) == ("campaign.toml", "files.loads")


@pytest.mark.parametrize(("way", "column"), [("step", "step"), ("time", "time_s")])
def test_a_missing_key_is_a_fault(tmp_path: Path, way: str, column: str) -> None:
    loads, signals = _tables(5)
    with pytest.raises(CampaignFaults) as faults:
        _run(tmp_path, loads.drop(columns=column), signals, BY[way])
    assert ("weights.csv", column) in {(fault.file, fault.column) for fault in faults.value.faults}


@pytest.mark.parametrize("shift", [-1, 1, 2])
def test_loads_of_the_row_before_or_after_fail_the_check(tmp_path: Path, shift: int) -> None:
    loads, signals = _tables(6)
    loads[list(LOADS)] = np.roll(loads[list(LOADS)].to_numpy(), shift, axis=0)
    found = _check(_run(tmp_path, loads, signals, BY["rows"])[0])
    assert found["verdict"] == "fail"
    assert found["value"] < 0.2


def test_clocks_that_differ_by_a_step_fail_the_check_and_smaller_offsets_change_no_row(tmp_path: Path) -> None:
    loads, signals = _tables(7)
    for offset, verdict in ((0.3 * PERIOD_S, "pass"), (PERIOD_S, "fail")):
        tables, _ = _run(tmp_path, loads.assign(time_s=loads["time_s"] + offset), signals, BY["time"])
        assert _check(tables)["verdict"] == verdict
        (row,) = tables["loads_joined"].to_pylist()
        if verdict == "pass":
            assert row["largest_apart_s"] == pytest.approx(offset)
            assert row["later_s"] == pytest.approx(0.5 * PERIOD_S - offset)
            assert row["earlier_s"] == pytest.approx(0.5 * PERIOD_S + offset)


def test_loads_that_do_not_change_from_row_to_row_leave_an_offset_untested(tmp_path: Path) -> None:
    loads, signals = _tables(8)
    names = [name for name in signals if name.endswith("_mv")]
    rng = np.random.default_rng(1)
    loads.loc[:, list(LOADS)] = np.repeat(loads[list(LOADS)].to_numpy()[:10], 4, axis=0)
    gains = rng.normal(size=(6, 6)) / LARGEST
    signals[names] = loads[list(LOADS)].to_numpy() @ gains + 2.0 * rng.normal(size=(STEPS, 6))
    found = _check(_run(tmp_path, loads, signals, BY["rows"])[0])
    assert found["verdict"] == "pass"
    assert_says(found["message"], "offset", "not tested")


def test_dates_in_one_file_and_seconds_in_the_other_are_a_fault(tmp_path: Path) -> None:
    loads, signals = _tables(9)
    stamps = pd.to_datetime("2026-05-14 10:00:00") + pd.to_timedelta(loads["time_s"], unit="s")
    loads["time_s"] = stamps.dt.strftime("%Y-%m-%d %H:%M:%S")
    with pytest.raises(CampaignFaults) as faults:
        _run(tmp_path, loads, signals, BY["time"] + '\ntime_format = "%Y-%m-%d %H:%M:%S"')
    assert {(fault.file, fault.column) for fault in faults.value.faults} == {("weights.csv", "time_s")}


def test_dates_with_a_zone_in_one_file_alone_are_a_fault(tmp_path: Path) -> None:
    loads, signals = _tables(9)
    for table, zone in ((loads, "Z"), (signals, "")):
        stamps = pd.to_datetime("2026-05-14 10:00:00") + pd.to_timedelta(table["time_s"], unit="s")
        table["time_s"] = stamps.dt.strftime(f"%Y-%m-%d %H:%M:%S{zone}")
    joined_by = BY["time"] + '\ntime_format = "%Y-%m-%d %H:%M:%S%z"'
    with pytest.raises(CampaignFaults) as faults:
        _run(tmp_path, loads, signals, joined_by, signals_keys='time_format = "%Y-%m-%d %H:%M:%S"\n')
    assert {(fault.file, fault.column) for fault in faults.value.faults} == {("weights.csv", "time_s")}


def test_joined_by_belongs_to_loads_alone(tmp_path: Path) -> None:
    loads, signals = _tables(10)
    both = signals.merge(loads, on=["run", "step", "time_s"])
    both.to_csv(tmp_path / "both.csv", index=False)
    text = '[campaign]\nname = "one"\nkind = "interferometer"\n[files.signals]\npath = "both.csv"\njoined_by = "rows"\n'
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    with pytest.raises(CampaignFaults, match="joined_by"):
        run_line(tmp_path, "ingest")
