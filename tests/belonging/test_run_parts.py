"""A part of a run with another unit or sign, columns that stand still in most runs, and copied columns are named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.belonging.test_load_slips import CHANNELS, SAMPLE, _asymmetric, _loaded
from tests.sensor_campaign import campaign_toml, measured, write_campaign
from tests.stages.line import run_line
from truing.belonging.copied_rows import equal_columns
from truing.belonging.frozen_values import constant_columns
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.run_parts import parts

READINGS, SIGNALS = "loads-against-readings", "signals-against-loads"


def _rows(table: pd.DataFrame, run: int, step: int) -> pd.Series:
    return (table["run"] == run) & (table["step"] >= step)


def _kilonewton(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    for table in (readings, signals):
        table.loc[_rows(table, 5, 8), "load"] *= 1e-3


def _no_sign(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    for table in (readings, signals):
        table.loc[table["load_axis"] == "fx", "load"] = table["load"].abs()


def _millimetres(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    readings.loc[_rows(readings, 5, 8) & readings["channel"].isin(["dx", "dy", "dz"]), "reading"] *= 1e-3


def _signals_turned(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    signals.loc[_rows(signals, 5, 8), [f"v{k}_mv" for k in range(1, 7)]] *= -1.0


def _frozen(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    signals.loc[signals["run"] > 5, "v2_mv"] = signals.loc[signals["run"] == 5, "v2_mv"].iloc[-1]


def _copied(readings: pd.DataFrame, signals: pd.DataFrame) -> None:
    signals["v3_mv"] = signals["v2_mv"]


FROM_8 = "run 5 from step"


@pytest.mark.parametrize(
    ("make", "own_channel", "relations", "kind", "factor", "where"),
    [
        pytest.param(_kilonewton, False, {READINGS, SIGNALS}, "unit", 1e3, FROM_8, id="load in kN"),
        pytest.param(_no_sign, True, {READINGS, SIGNALS}, "sign", 1.0, "run 2 from step", id="loads without a sign"),
        pytest.param(_millimetres, True, {READINGS}, "unit", 1e3, FROM_8, id="readings in mm"),
        pytest.param(_signals_turned, False, {SIGNALS}, "sign", 1.0, FROM_8, id="signals turned round"),
        pytest.param(_frozen, True, {SIGNALS}, "frozen", 1.0, "run 18", id="a signal frozen in most runs"),
        pytest.param(_copied, True, {SIGNALS}, "copied", 1.0, "v3", id="a copied signal"),
    ],
)
def test_a_slip_in_some_rows_is_named_with_its_place(
    tmp_path: Path,
    make: Callable[[pd.DataFrame, pd.DataFrame], None],
    own_channel: bool,
    relations: set[str],
    kind: str,
    factor: float,
    where: str,
) -> None:
    readings, signals = measured(np.random.default_rng(4), repeats=3, own_channel=own_channel)
    make(readings, signals)
    write_campaign(tmp_path / "c", readings, signals, campaign_toml())
    rows = run_line(tmp_path / "c", "ingest", "qa")[0]["belonging"].to_pylist()
    failed = [row for row in rows if row["state"] == "fails"]
    assert {row["relation"] for row in failed} == relations
    for row in failed:
        (slip,) = json.loads(row["slips"])
        assert (slip["kind"], slip["factor"]) == (kind, factor)
        assert any(subject.startswith(where) for subject in slip["subjects"]), slip


def _with_play(moved: np.ndarray, load: np.ndarray) -> np.ndarray:
    play = 0.2 * np.abs(moved).max(axis=0)
    return np.sign(moved) * np.maximum(np.abs(moved) - play, 0.0)


def _crept(moved: np.ndarray, load: np.ndarray) -> np.ndarray:
    out = moved.copy()
    for n in range(1, len(out)):
        out[n] = 0.7 * moved[n] + 0.3 * out[n - 1]
    return out


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(_asymmetric, id="push and pull differ by half"),
        pytest.param(_with_play, id="clearance"),
        pytest.param(_crept, id="what lags behind"),
        pytest.param(lambda moved, load: moved + 0.3 * moved**3 / np.abs(moved).max(axis=0) ** 2, id="stiffening"),
        pytest.param(lambda moved, load: moved * np.where(moved > 0.0, 1.0, 0.0), id="no contact in one direction"),
    ],
)
def test_a_physical_cause_is_no_part(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    steps = _loaded(change)
    assert not parts(steps.load, steps.run, steps.value, CHANNELS, np.full((6, 6), np.nan))
    assert not list(constant_columns(steps.load, steps.run, steps.value))


def test_an_answer_to_both_signs_alike_is_a_turned_part_only_of_a_channel_that_should_not() -> None:
    load = np.zeros((17, 6))
    load[:, 0] = np.concatenate([np.linspace(0.0, 1.0, 9), np.linspace(-0.1, -1.0, 8)])
    run, value = np.zeros(17, int), np.full((17, 6), np.nan)
    value[:, 0] = np.abs(load[:, 0])
    assert not parts(load, run, value, CHANNELS, np.zeros((6, 6)))
    assert [one.factor for one in parts(load, run, value, CHANNELS, np.eye(6))] == [-1.0]
    value[:, 0] **= 2
    assert not parts(load, run, value, CHANNELS, np.eye(6))


def test_signals_name_the_slip_of_loads_that_readings_show(tmp_path: Path) -> None:
    readings, signals = (pd.read_csv(SAMPLE / f"{name}.csv") for name in ("interferometer", "signals"))
    for table in (readings, signals):
        table["load"] /= np.where(table["load_axis"].str.startswith("f"), 4.4482216152605, 1.0)
    write_campaign(tmp_path / "c", readings, signals, (SAMPLE / "campaign.toml").read_text(encoding="utf-8"))
    rows = run_line(tmp_path / "c", "ingest", "qa")[0]["belonging"].to_pylist()
    reported = {row["relation"]: json.loads(row["slips"]) for row in rows if row["state"] == "fails"}
    assert reported[SIGNALS] == reported[READINGS]
    assert (reported[SIGNALS][0]["quantity"], round(reported[SIGNALS][0]["factor"], 6)) == ("force", 4.448222)


def test_a_coarse_converter_may_stand_still_and_agree() -> None:
    steps = _loaded(lambda moved, load: moved)
    coarse = np.round(steps.value / np.ptp(steps.value, axis=0) * 100.0)
    assert any(np.ptp(coarse[steps.run == one], axis=0).min() == 0.0 for one in np.unique(steps.run))
    assert not list(constant_columns(steps.load, steps.run, coarse))
    few = [RecordedColumn("v1", "signal", ()), RecordedColumn("v2", "signal", ())]
    assert not equal_columns(np.tile([[0.0], [1.0], [2.0]], (9, 2)), few, SIGNALS, "signals")


def test_signals_exchanged_from_a_run_on_are_named_for_all_axes(tmp_path: Path) -> None:
    readings, signals = (pd.read_csv(SAMPLE / f"{name}.csv") for name in ("interferometer", "signals"))
    later, pair = signals["run"] >= 20, ["v3_mv", "v5_mv"]
    assert signals.loc[later, "load_axis"].nunique() > 2
    signals.loc[later, pair] = signals.loc[later, pair[::-1]].to_numpy()
    write_campaign(tmp_path / "c", readings, signals, (SAMPLE / "campaign.toml").read_text(encoding="utf-8"))
    rows = run_line(tmp_path / "c", "ingest", "qa")[0]["belonging"].to_pylist()
    (row,) = [row for row in rows if row["state"] == "fails"]
    (slip,) = json.loads(row["slips"])
    assert (row["relation"], slip["kind"], slip["subjects"]) == (
        SIGNALS,
        "columns-exchanged",
        ["v3", "v5", "from run 20 on"],
    )
