"""A pose at which all measured values deviate is no gross error of one measurement: the verdict names it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pytest

from tests.sentences import assert_says
from tests.stages.line import run_line
from truing.report.diagnosis.deviating_epochs import RARE, deviating_epochs, deviating_words
from truing.report.verdict import verdict_frame
from truing.schemas.verdict import ReasonCode

SAMPLE = Path(__file__).parents[2] / "sample_data" / "robot"
POSE = 17
SHIFT_MM = 0.4  # of all targets of one pose


def _diagnosed(folder: Path, shift_mm: float) -> dict[str, pd.DataFrame]:
    """Return the tables of the sample robot's diagnosis, all targets of one pose shifted."""
    shutil.copytree(SAMPLE, folder)
    points = pd.read_csv(folder / "points.csv")
    points.loc[points["pose"] == POSE, "x_mm"] += shift_mm
    points.to_csv(folder / "points.csv", index=False)
    made, _ = run_line(folder, "ingest", "qa", "pose", "diagnose")
    return {name: table.to_pandas() for name, table in made.items() if isinstance(table, pa.Table)}


@pytest.mark.slow
def test_a_pose_whose_targets_all_deviate_is_named_in_the_verdict_and_has_no_error(tmp_path: Path) -> None:
    tables = _diagnosed(tmp_path / "robot", 0.4)
    (deviating,) = deviating_epochs(tables)
    targets = int((tables["observations"]["pose"] == POSE).sum())
    assert (deviating.name, deviating.left_out, deviating.measured) == (f"pose {POSE}", targets, targets)
    verdicts = verdict_frame(tables).set_index("section")
    assert verdicts.loc["adequacy", "reason_code"] == ReasonCode.EPOCHS_LEFT_OUT
    assert verdicts.loc["adequacy", "state"] == "attention"
    assert verdicts.loc["campaign", "decided_by"] == "diagnosis"  # what was found comes first
    errors = tables["prediction"].set_index("pose")
    assert errors.loc[POSE, ["rms_before", "rms_after", "largest_before", "largest_after"]].isna().all()
    assert errors.drop(POSE)["rms_after"].notna().all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigmas", "named", "code"),
    [(0.0, [], ReasonCode.WITHIN_NOISE), (5.0, [POSE], ReasonCode.EPOCHS_DEVIATE)],
)
def test_a_pose_that_deviates_by_less_than_gross_errors_is_named_too(
    sigmas: float, named: list[int], code: ReasonCode, tmp_path: Path, robot_run: Path
) -> None:
    """Each single value may be noise; all together are not."""
    if sigmas:
        tables = _diagnosed(tmp_path / "robot", sigmas * 0.01)
    else:
        tables = {path.stem: pd.read_parquet(path) for path in (robot_run / "run").glob("*.parquet")}
    errors = tables["prediction"]
    assert errors.loc[errors["p_deviates"] < RARE, "pose"].tolist() == named
    assert verdict_frame(tables).set_index("section").loc["adequacy", "reason_code"] == code
    assert not deviating_epochs(tables)


def _left_out(*rows: tuple[int, str, float, int | None]) -> dict[str, pd.DataFrame]:
    columns = ["pose", "subject", "value", "measured_there"]
    return {"diagnosis_left_out": pd.DataFrame(rows, columns=columns).assign(unit="sigma", limit=5.0, reason="why")}


def test_single_values_of_many_are_no_deviating_pose() -> None:
    assert not deviating_epochs(_left_out((3, "tip T1", 9.0, 4), (5, "tip T2", 8.0, 4)))
    assert not deviating_epochs(_left_out((3, "tip T1", 9.0, None)))
    assert not deviating_epochs({})


def test_more_than_half_of_the_values_must_deviate_and_the_largest_deviation_comes_first() -> None:
    half = [(7, "T1", 30.0, 2)]
    most = [(3, "T1", 9.0, 3), (3, "T2", 8.0, 3), (5, "T1", 20.0, 2), (5, "T2", 6.0, 2)]
    found = deviating_epochs(_left_out(*half, *most))
    assert [(epoch.name, epoch.left_out, epoch.largest) for epoch in found] == [("pose 5", 2, 20.0), ("pose 3", 2, 9.0)]


def test_one_value_cannot_distinguish_the_machine_from_the_measurement() -> None:
    several = deviating_epochs(_left_out((3, "T1", 9.0, 2), (3, "T2", 8.0, 2)))
    words = deviating_words(several, model_fits=True)
    assert_says(words, "pose 3", "2 of 2 values")
    assert_says(words, "no error of a single value", "machine", "instrument", "reading")
    words = deviating_words(deviating_epochs(_left_out((3, "T1", 9.0, 1))), model_fits=True)
    assert_says(words, "pose 3", "measured value deviates")
    assert_says(words, "One value cannot tell")


def test_an_incomplete_model_gives_no_reason_why_a_pose_deviates() -> None:
    words = deviating_words(deviating_epochs(_left_out((3, "T1", 9.0, 1))), model_fits=False)
    assert_says(words, "pose 3", "incomplete model")
    assert "machine" not in words, "the model may be wrong there"


def test_load_steps_are_named_by_run() -> None:
    steps = _left_out((3, "dx", 9.0, 2), (3, "dy", 8.0, 2))["diagnosis_left_out"]
    steps = steps.drop(columns="pose").assign(run=2, step=7)
    assert [epoch.name for epoch in deviating_epochs({"diagnosis_left_out": steps})] == ["load step 7 of run 2"]
