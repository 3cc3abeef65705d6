"""Conversion of a table of signals to wrenches, run by run; all missing columns are reported together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from tests.estimation.sensor.toy_sensor import RANGE, ToySensor, loads, sensor
from tests.faults import assert_fault, faults_of
from truing.estimation.sensor.calibrated_sensor import CalibratedSensor, calibrated_sensor, sensor_text
from truing.estimation.sensor.calibration import CalibrationModel
from truing.estimation.sensor.contenders import hold_out
from truing.pipeline.command_line import app
from truing.schemas.faults import CampaignFaults
from truing.stages.predict import predict

SIGNALS = [f"v{number}_mv" for number in range(1, 7)]
LOADS = ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]


def _calibrated(is_tared: bool = False) -> tuple[ToySensor, CalibratedSensor]:
    rng = np.random.default_rng(1)
    toy = sensor(rng, signal=1e-3)
    table = toy.table(rng, *loads(rng))
    model = CalibrationModel("errors in both", "forward", zero="none" if is_tared else "common")
    return toy, calibrated_sensor(hold_out(table, model), table, 20.0, is_tared)


def _loads(count: int = 8) -> np.ndarray:
    return np.random.default_rng(2).uniform(-0.5, 0.5, (count, 6)) * RANGE


def test_rows_come_back_in_their_order_with_the_wrench_that_acted():
    toy, calibrated = _calibrated()
    true = _loads()
    given = pd.DataFrame(true @ toy.A.T, columns=SIGNALS).assign(time_s=np.arange(8.0), step=range(8))
    found = predict(sensor_text(calibrated, {}), pa.Table.from_pandas(given, preserve_index=False)).to_pandas()
    sigma = found[[f"sigma_{name}" for name in LOADS]].to_numpy()
    assert np.all(np.abs(found[LOADS].to_numpy() - true) < 6 * sigma)
    assert found["row_order"].tolist() == list(range(1, 9))
    assert found["time_s"].tolist() == given["time_s"].tolist()
    assert found["is_within"].all()
    apart = np.abs(found["cov_fx_my"]) / (found["sigma_fx_n"] * found["sigma_my_nm"])
    assert (apart < 1).all()


def test_every_run_counts_from_its_own_unloaded_rows():
    toy, calibrated = _calibrated(is_tared=True)
    true = _loads()
    true[[0, 4]] = 0.0
    zero = np.repeat([[0.3], [-0.8]], 4, axis=0)
    given = pd.DataFrame(true @ toy.A.T + zero, columns=SIGNALS)
    given = given.assign(run=["a"] * 4 + ["b"] * 4, unloaded=[1, 0, 0, 0] * 2)
    text = sensor_text(calibrated, {})
    found = predict(text, pa.Table.from_pandas(given, preserve_index=False)).to_pandas()
    sigma = found[[f"sigma_{name}" for name in LOADS]].to_numpy()
    assert np.all(np.abs(found[LOADS].to_numpy() - true) < 6 * sigma)
    assert found["run"].tolist() == given["run"].tolist()
    loaded = pa.Table.from_pandas(given.assign(unloaded=[1] + [0] * 7), preserve_index=False)
    fault = assert_fault(faults_of(lambda: predict(text, loaded, "there.csv")), file="there.csv", column="unloaded")
    assert fault.expected.endswith("run b")


def test_all_that_is_missing_or_no_number_is_reported_at_once():
    toy, calibrated = _calibrated(is_tared=True)
    given = pd.DataFrame(_loads() @ toy.A.T, columns=SIGNALS)
    text = sensor_text(calibrated, {})
    with pytest.raises(CampaignFaults) as lacking:
        predict(text, pa.Table.from_pandas(given.drop(columns=["v2_mv", "v5_mv"]), preserve_index=False), "there.csv")
    assert {fault.column for fault in lacking.value.faults} == {"v2_mv", "v5_mv", "unloaded"}
    spoilt = given.assign(unloaded=1).astype({"v3_mv": object})
    spoilt.loc[2, "v3_mv"], spoilt.loc[5, "v1_mv"] = "abc", np.nan
    spoilt["v3_mv"] = spoilt["v3_mv"].astype(str)
    with pytest.raises(CampaignFaults) as wrong:
        predict(text, pa.Table.from_pandas(spoilt, preserve_index=False), "there.csv")
    assert {(fault.column, fault.row) for fault in wrong.value.faults} == {("v3_mv", 4), ("v1_mv", 7)}


def test_the_command_takes_a_run_and_a_table_of_signals(tmp_path: Path):
    toy, calibrated = _calibrated()
    (tmp_path / "sensor.toml").write_text(sensor_text(calibrated, {}), encoding="utf-8")
    true = _loads()
    pd.DataFrame(true @ toy.A.T, columns=SIGNALS).to_csv(tmp_path / "signals.csv", index=False)
    out = tmp_path / "wrenches.csv"
    done = CliRunner().invoke(app, ["predict", str(tmp_path), str(tmp_path / "signals.csv"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    found = pd.read_csv(out)
    assert np.all(np.abs(found[LOADS].to_numpy() - true) < 6 * found[[f"sigma_{n}" for n in LOADS]].to_numpy())
