"""External loads of a campaign: keys, payload and columns, their effect on the calibration, and faults."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.faults import assert_fault, faults_of
from tests.stages.line import run_line, settings_of
from truing.simulation.mechanisms.weight import GRAVITY
from truing.stages.common.external_load import external_loads

SAMPLE = Path(__file__).resolve().parents[3] / "sample_data" / "telescope"


def _campaign(folder: Path, text: str = "", **columns: Any) -> Path:
    shutil.copytree(SAMPLE, folder)
    settings = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(settings + text, encoding="utf-8")
    table = pd.read_csv(folder / "configurations.csv").assign(**columns)
    table.to_csv(folder / "configurations.csv", index=False)
    return folder


def _loads(folder: Path) -> np.ndarray | None:
    table = run_line(folder, "ingest")[0]["configurations"]
    return external_loads(settings_of(folder), table, np.broadcast_to(np.eye(3), (table.num_rows, 3, 3)))


def test_columns_have_precedence_over_keys_and_the_payload_adds(tmp_path: Path) -> None:
    assert _loads(_campaign(tmp_path / "none")) is None
    text = "\n[load]\nforce_n = [1.0, 2.0, 3.0]\ntorque_nm = [0.0, 0.0, 4.0]\n"
    keys = _loads(_campaign(tmp_path / "keys", text))
    assert keys is not None
    assert (keys == [1.0, 2.0, 3.0, 0.0, 0.0, 4.0]).all()
    poses = len(keys)
    whole = _campaign(tmp_path / "all", text, fy_n=np.arange(poses), payload_kg=np.full(poses, 2.0))
    settings = (whole / "campaign.toml").read_text(encoding="utf-8")
    settings = settings.replace("[mechanism]", "[mechanism]\npayload_com_mm = [100.0, 0.0, 0.0]", 1)
    (whole / "campaign.toml").write_text(f"{settings}\n[measurement]\nup = [0.0, 0.0, 2.0]\n", encoding="utf-8")
    found = _loads(whole)
    assert found is not None
    expected = np.tile([1.0, 0.0, 3.0 - 2.0 * GRAVITY, 0.0, 0.2 * GRAVITY, 4.0], (poses, 1))
    expected[:, 1] = np.arange(poses)
    assert np.allclose(found, expected, rtol=1e-12)


def test_the_calibration_says_how_far_a_load_moves_the_platform(tmp_path: Path) -> None:
    load = 200.0 * np.cos(np.arange(len(pd.read_csv(SAMPLE / "configurations.csv"))))
    tables, _ = run_line(_campaign(tmp_path / "c", fz_n=load), "ingest", "pose", "calibrate")
    figures = tables["model_choice"].to_pandas().query("estimator == 'nominal' and model == 'stiffness'")
    figures = figures.set_index("figure")["value"]
    assert 0.1 < figures["load_shift_rms"] < 20.0
    assert figures["load_shift_varying"] == pytest.approx(figures["load_shift_rms"], rel=0.2)  # its mean is near zero


def test_an_empty_cell_of_a_load_is_a_fault(tmp_path: Path) -> None:
    load = np.zeros(len(pd.read_csv(SAMPLE / "configurations.csv")))
    load[3] = np.nan
    found = faults_of(lambda: run_line(_campaign(tmp_path / "c", fz_n=load), "ingest"))
    assert_fault(found, file="configurations.csv", row=5, column="fz_n")


@pytest.mark.parametrize("lacking", ["flexure", "leg_tube"])
def test_a_load_on_legs_of_unknown_stiffness_is_a_fault(tmp_path: Path, lacking: str) -> None:
    folder = _campaign(tmp_path / "c", "\n[load]\nforce_n = [0.0, 0.0, -10.0]\n")
    run_line(folder, "ingest")
    settings = (folder / "campaign.toml").read_text(encoding="utf-8")
    start = settings.index(f"[mechanism.{lacking}]")
    end = settings.index("\n\n", start)
    (folder / "campaign.toml").write_text(settings[:start] + settings[end:], encoding="utf-8")
    assert_fault(faults_of(lambda: run_line(folder, "ingest")), file="campaign.toml", column="load")
