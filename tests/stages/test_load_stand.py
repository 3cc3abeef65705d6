"""Signals of a force sensor on a stand with hangers, in one table of loads without times, give findings and
messages."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.report.exclusion_section import excluded

LARGEST = np.array([500.0, 500.0, 1000.0, 30.0, 30.0, 30.0])
LOADS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
SIGMA_MV, LOAD_SIGMA = 3e-4, np.array([0.05] * 3 + [0.003] * 3)
ARM_M = 0.01  # along y, of the positive x load
PER_N2 = 2e-8  # mV per N squared, in one signal
STAGES = ("ingest", "diagnose", "calibrate")


def _loads() -> np.ndarray:
    """Each load alone at half and full size to either side; pairs; and each one under z loads."""
    unit = np.eye(6) * LARGEST
    alone = [share * load for load in unit for share in (0.0, 0.5, 1.0, -0.5, -1.0)]
    pairs = [0.5 * (one - other) for one, other in combinations(unit, 2)]
    pressed = [share * unit[2] + 0.5 * other for other in np.delete(unit, 2, 0) for share in (1.0, -1.0, 0.75, -0.75)]
    return np.array([*alone, *pairs, *pressed])


def _write(folder: Path, seed: int, *, arm_m: float = 0.0, bend: float = 0.0, noise: str = "", **wrong: float) -> Path:
    """A campaign of signals; slip: the row whose second signal is wrong by 0.05 mV; touch: mV that the third signal
    gains where x loads are positive and z loads negative."""
    rng, recorded = np.random.default_rng(seed), _loads()
    acting = recorded + LOAD_SIGMA * rng.normal(size=recorded.shape) * (recorded != 0.0)
    acting[:, 5] -= arm_m * np.maximum(acting[:, 0], 0.0)  # Mz = x Fy - y Fx
    gains = (np.eye(6) + 0.1 * rng.normal(size=(6, 6))) * 1.5 / LARGEST
    signals = acting @ gains.T + 0.01 * rng.normal(size=6) + SIGMA_MV * rng.normal(size=recorded.shape)
    signals[:, 4] += bend * acting[:, 2] ** 2
    if "slip" in wrong:
        signals[int(wrong["slip"]), 1] += 0.05
    signals[:, 2] += wrong.get("touch", 0.0) * _are_touched(recorded)
    steps = {"run": 1, "step": np.arange(len(recorded)), "time_s": 1.0 * np.arange(len(recorded))}
    columns = dict(zip(LOADS, recorded.T, strict=True)) | {f"v{k + 1}_mv": signals[:, k] for k in range(6)}
    folder.mkdir()
    pd.DataFrame(steps | columns).to_csv(folder / "signals.csv", index=False)
    text = f'[campaign]\nname = "stand"\nkind = "interferometer"\n[noise]\nsignal_mv = {SIGMA_MV}\n{noise}'
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return folder


def _are_touched(loads: np.ndarray) -> np.ndarray:
    return (loads[:, 0] > 0.0) & (loads[:, 2] < 0.0)


DECLARED = f"load_n = {LOAD_SIGMA[0]}\nload_nm = {LOAD_SIGMA[3]}\n"


def _run(folder: Path) -> Any:
    tables, outcomes = run_line(folder, *STAGES)
    diagnosis = tables["diagnosis"].to_pandas()
    claimed = diagnosis[diagnosis["verdict"].isin(["found", "suspected"])]
    return SimpleNamespace(tables=tables, outcomes=outcomes, claimed=claimed)


@pytest.fixture(scope="module", params=["", DECLARED], ids=["loads-taken-as-exact", "noise-of-loads-declared"])
def off_axis(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return _run(_write(tmp_path_factory.mktemp("stand") / "c", 3, arm_m=ARM_M, noise=request.param))


def test_a_hanger_off_the_axis_is_found_whether_the_noise_of_loads_is_declared_or_not(off_axis: Any) -> None:
    (row,) = off_axis.claimed.to_dict("records")
    assert (row["cause"], row["subject"], row["verdict"]) == ("load-imbalance", "load fx", "found")
    differs = json.loads(row["parameters"])["moment_z_asymmetry"]
    assert differs["sigma"] < 1e-4
    assert_close(differs["value"], -ARM_M, atol=4.0 * differs["sigma"])
    assert 0.8 < row["rms_after"] / row["noise_floor"] < 1.25
    assert "Measure at the loading stand" in row["next_measurement"]


def test_no_duration_is_stated_where_no_times_were_recorded(off_axis: Any) -> None:
    plan = off_axis.tables.get("next_loads")
    if plan is not None:
        assert plan.column("duration_s").null_count == plan.num_rows
    assert not off_axis.claimed["next_measurement"].str.contains("This takes").any()


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return _run(_write(tmp_path_factory.mktemp("stand") / "c", 5, bend=PER_N2))


@pytest.fixture(scope="module")
def slipped(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return _run(_write(tmp_path_factory.mktemp("stand") / "c", 5, slip=37))


def test_a_bent_signal_is_one_finding(bent: Any) -> None:
    (row,) = bent.claimed.to_dict("records")
    assert (row["cause"], row["subject"], row["follows"]) == ("unexplained", "signal v5", "fz_n")


def test_the_one_signal_that_a_calibration_left_out_is_on_the_page(slipped: Any) -> None:
    table = slipped.tables["calibration_left_out"].to_pandas()
    assert table[["run", "step", "subject"]].to_numpy().tolist() == [[1, 37, "signal v2"]]
    assert slipped.outcomes["calibrate"].left_out == "1 load step with a gross error in a signal"
    section = excluded({"calibration_left_out": table})
    assert section.lead == "Left out by diagnosis and calibration: 1 gross error."
    assert [listing.rows[0][:3] for listing in section.listings] == [("calibration", "signal v2", "run 1, step 37")]


@pytest.fixture(scope="module")
def touched(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return _run(_write(tmp_path_factory.mktemp("stand") / "c", 5, touch=67.0 * SIGMA_MV, slip=20))


def test_an_effect_of_few_load_steps_is_used_and_a_slip_next_to_it_is_left_out(touched: Any) -> None:
    """Three load steps of 65 show it, and no cause describes it: their common part is reported."""
    kept = touched.tables["calibration_kept"].to_pandas()
    steps = np.flatnonzero(_are_touched(_loads())).tolist()
    assert len(steps) >= 3
    assert kept["step"].tolist() == steps
    assert set(kept["subject"]) == {"signal v3"}
    assert set(kept["kept_because"]) == {"shared input"}
    left_out = touched.tables["calibration_left_out"].to_pandas()
    assert left_out[["step", "subject"]].to_numpy().tolist() == [[20, "signal v2"]]


def test_a_diagnosis_finds_an_effect_of_few_load_steps_and_screens_no_other_value_of_its_channel(touched: Any) -> None:
    """Outliers of its own channel are no gross errors for a model that misses the effect."""
    unexplained = touched.claimed[touched.claimed["cause"] == "unexplained"]
    follows = unexplained.loc[unexplained["subject"] == "signal v3", "follows"]
    assert "fx_n fz_n" in follows.tolist()
    left_out = touched.tables["diagnosis_left_out"].to_pandas()
    assert left_out[["step", "subject"]].to_numpy().tolist() == [[20, "signal v2"]]


def test_a_bent_signal_leaves_no_load_step_out(bent: Any) -> None:
    assert "calibration_left_out" not in bent.tables
    assert bent.outcomes["calibrate"].left_out.startswith("nothing")
    assert "squares" in bent.outcomes["calibrate"].figure


def test_the_page_shows_which_outlying_signals_were_used(touched: Any) -> None:
    section = excluded({"calibration_kept": touched.tables["calibration_kept"].to_pandas()})
    assert section.lead == "Used despite large deviations: 3 signals with an effect of loads or runs."
    (listing,) = section.listings
    assert next(row[:2] for row in listing.rows) == ("signal v3", "run 1, step 31")
    assert {row[3] for row in listing.rows} == {"shared by several: fx > 0 and fz < 0"}
