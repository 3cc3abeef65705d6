"""Readings that a person excluded or kept, by run, step and channel: applied in every stage, counted and named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.stages.benches import bench_with_a_gross_error
from tests.stages.line import run_line, settings_of
from truing.inference.fitter import Fitter
from truing.report.exclusion_section import excluded
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.stages.common.recorded_signals import recorded
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.search import assembled_data

STAGES = ("ingest", "qa", "pose", "deformation")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_with_a_gross_error(tmp_path_factory.mktemp("hand") / "bench")


def ruled(folder: Path, home: Path, *rules: str) -> Path:
    """The same campaign with rules of a person."""
    for name in ("interferometer.csv", "signals.csv"):
        (home / name).write_bytes((folder / name).read_bytes())
    by = 'by = "M. Keller"\nreason = "leaned on it"\n'
    decisions = "".join(f"\n[[{table}]]\n{keys}\n{by}" for table, keys in (rule.split(": ") for rule in rules))
    (home / "campaign.toml").write_text((folder / "campaign.toml").read_text() + decisions)
    return home


def gathered(folder: Path) -> DiagnosisData:
    return assembled_data(run_line(folder, "ingest")[0], settings_of(folder))


def residuals(tables: dict[str, Any]) -> pd.DataFrame:
    return tables["reading_residuals"].to_pandas().set_index(["run", "step", "channel"])


def test_excluded_points_are_counted_and_used_in_no_stage(measured: Path, tmp_path: Path) -> None:
    rules = ("exclude: run = 1\nstep = 3", 'exclude: run = 2\nchannel = "ry"', 'exclude: step = 5\nchannel = "v4"')
    folder = ruled(measured, tmp_path, *rules)
    (plain, _), (tables, said) = run_line(measured, *STAGES), run_line(folder, *STAGES)
    rows = residuals(tables)
    out = rows[rows["decision"] == "excluded"]
    assert len(out) == 6 + 21
    assert out["rejected"].all()
    assert out["reason"].str.contains("M. Keller").all()
    assert len(rows) == len(residuals(plain))
    assert said["pose"].left_out == "1 reading as a gross error: dz of run 1 step 7; 27 readings excluded by a person"
    signals = recorded({"signals": tables["signals"]}, settings_of(folder))
    assert (signals.excluded, len(signals.steps.run)) == (3, 42 - 3)
    used = [made["displacement"].to_pandas()[["n_used", "n_rejected"]].sum().to_numpy() for made in (plain, tables)]
    assert (used[0] - used[1]).tolist() == [27, -27]
    checks = tables["qa"].to_pandas().set_index(["check", "subject"]).loc["overruled"]
    assert checks["value"].tolist() == [12.0, 21.0, 2.0]
    assert (checks["verdict"] == "pass").all()
    page = excluded({name: made.to_pandas() for name, made in tables.items() if hasattr(made, "to_pandas")})
    decisions = page.listings[0].rows
    places = {row[1]: row[2] for row in decisions}
    assert places["run 2 ry"] == "21 steps: 0, 1, 2, 3, 4, 5, 6, 7 …"
    assert {row[0] for row in decisions if row[1] == "run 2 ry"} == {"excluded by M. Keller: leaned on it"}


def test_the_diagnosis_leaves_it_out_and_knows_that_the_load_was_there(measured: Path, tmp_path: Path) -> None:
    found = gathered(ruled(measured, tmp_path, "exclude: run = 1\nstep = 3", 'exclude: run = 2\nchannel = "v4"'))
    plain = gathered(measured)
    gone = plain.calibration.measured.is_observed & ~found.calibration.measured.is_observed
    assert np.array_equal(np.argwhere(gone)[:12], [[3, k] for k in range(12)])
    assert np.array_equal(np.argwhere(gone)[12:], [[21 + step, 9] for step in range(21)])
    assert np.array_equal(found.calibration.conditions.load, plain.calibration.conditions.load)
    assert found.left_out.startswith("6 readings and 27 signals")
    assert np.isfinite(Fitter(found.model, found.calibration, None, 0).prepared().fit.shared).all()


def test_points_kept_by_a_person_are_no_gross_errors(measured: Path, tmp_path: Path) -> None:
    folder = ruled(measured, tmp_path, 'keep: run = 1\nstep = 7\nchannel = "dz"')
    gross = [residuals(run_line(one, "ingest", "pose")[0]).loc[(1, 7, "dz")] for one in (measured, folder)]
    assert gross[0]["rejected"]
    assert gross[0]["reason"].startswith("gross error")
    assert not gross[1]["rejected"]
    assert (gross[1]["decision"], gross[1]["reason"].partition(" by ")[2]) == ("kept", "M. Keller: leaned on it")
    for one, count in ((measured, 1), (folder, 0)):
        found = gathered(one)
        fitter = Fitter(found.model, found.calibration, None, 0)
        fitter.prepared()
        assert len(fitter.screened) == count


def test_a_rule_that_names_nothing_warns_and_is_no_failure(measured: Path, tmp_path: Path) -> None:
    folder = ruled(measured, tmp_path, 'exclude: run = 9\nchannel = "dx"', 'keep: pose = 3\nbody = "platform"')
    tables, said = run_line(folder, "ingest", "qa")
    checks = tables["qa"].to_pandas().set_index(["check", "subject"]).loc["overruled"]
    assert checks["verdict"].tolist() == ["warn", "warn"]
    assert (
        checks["message"].iloc[0] == "Run 9, channel dx: no reading has this name, so none was excluded by M. Keller."
    )
    assert not said["qa"].failed_checks


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"run": 3}, "pose, body or target in [[exclude]] and [[keep]]; run, step and channel are keys for a bench"),
        ({"channel": "d"}, "exclude.1.channel"),
    ],
)
def test_invalid_keys_are_faults(keys: dict[str, Any], expected: str) -> None:
    rule = {**keys, "by": "M. Keller", "reason": "leaned on it"}
    with pytest.raises(CampaignFaults) as caught:
        read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "exclude": [rule]})
    assert expected in str(caught.value)
