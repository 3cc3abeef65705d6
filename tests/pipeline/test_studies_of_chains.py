"""Studies of a chain by `truing design`: accuracy after a calibration, unique numbers, tolerances; refusals of an
axis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.csv
import pytest

from tests.pipeline.test_design_of_axes import axis
from tests.pipeline.test_design_of_chains import COLUMNS, LIMITS, SAMPLE, call, planned, readings
from tests.report.explained import unexplained
from tests.sentences import assert_says

REQUIRED = "\n[requirement]\nx_mm = 0.012\nz_mm = 0.001\n"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies use a run of the campaign that lies in the current folder: none does here."""
    monkeypatch.chdir(tmp_path)


def test_the_plan_is_the_table_of_a_campaign_that_reaches_what_poses_can_reach(tmp_path: Path) -> None:
    place = planned(tmp_path / "arm", workspace=REQUIRED)
    done = call(place, "--accuracy", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    found = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas()
    of_plan = found[found["poses"] == "plan"].set_index("component")
    assert of_plan.loc["x", "error_95"] <= of_plan.loc["x", "requirement"] == pytest.approx(12.0)
    assert of_plan.loc["z", "of_readings_95"] > of_plan.loc["z", "requirement"]
    assert np.isnan(of_plan.loc["z", "poses_needed"])
    plan = readings(tmp_path / "found-plan.csv")
    assert len(plan) == of_plan["count"].iloc[0] < 40
    assert (plan >= LIMITS[:, 0] - 1e-6).all()
    assert (plan <= LIMITS[:, 1] + 1e-6).all()
    assert pyarrow.csv.read_csv(tmp_path / "found-plan.csv").column_names == ["pose", "role", *COLUMNS]
    assert_says(done.output, "no number of poses reaches 1 µm")
    assert not unexplained((tmp_path / "found.html").read_text(encoding="utf-8"))


def combinations(place: Path) -> pd.DataFrame:
    return pyarrow.csv.read_csv(place).to_pandas().fillna({"shown_at": ""})


def test_structural_combinations_are_distinguished_from_those_that_other_poses_would_show(tmp_path: Path) -> None:
    """Poses with a roll at rest hide what any other roll shows."""
    done = call(SAMPLE, "--uniqueness", "--out", tmp_path / "all.csv")
    assert done.exit_code == 0, done.output
    found = combinations(tmp_path / "all-combinations.csv")
    assert set(found["poses"]) == {"possible", "own"}
    assert (found["shown_at"] == "").all()  # the sample's own poses show all that any poses show
    assert_says(done.output, "They show every combination that poses within the ranges can show")
    place = planned(tmp_path / "still")
    table = pyarrow.csv.read_csv(SAMPLE / "configurations.csv").slice(0, 30).to_pandas().assign(roll_deg=0.0)
    table.to_csv(place / "configurations.csv", index=False)
    done = call(place, "--uniqueness", "--out", tmp_path / "still.csv")
    assert done.exit_code == 0, done.output
    still = combinations(tmp_path / "still-combinations.csv")
    shown = still[still["shown_at"] != ""]
    assert set(shown["poses"]) == {"own"}
    assert "roll_deg" in shown["shown_at"].iloc[0]
    numbers = {name: pyarrow.csv.read_csv(tmp_path / f"{name}.csv").to_pandas() for name in ("all", "still")}
    determined = {n: t[t["poses"] == "own"].set_index("kind")["determined"].sum() for n, t in numbers.items()}
    assert determined["still"] < determined["all"]
    assert not unexplained((tmp_path / "still.html").read_text(encoding="utf-8"))


def test_shares_of_tolerances_add_up_and_the_first_one_is_named(tmp_path: Path) -> None:
    done = call(planned(tmp_path / "arm"), "--tolerances", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    found = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas()
    whole, sources = found.iloc[0], found.iloc[1:]
    for quantity, unit in (("position", "um"), ("orientation", "arcsec")):
        assert sources[f"{quantity}_share"].sum() == pytest.approx(1.0)
        assert np.sqrt(np.sum(sources[f"{quantity}_{unit}"] ** 2)) == pytest.approx(whole[f"{quantity}_{unit}"])
    first = sources.loc[sources["position_share"].idxmax()]
    assert_says(done.output, f"zero of joint {first['subject']}")
    of_readings = pyarrow.csv.read_csv(tmp_path / "found-readings.csv").to_pandas()
    assert len(of_readings) == len(COLUMNS)
    # An angle of 0.0002 deg is 250 times as small as the tolerance of a zero.
    zeros = sources[sources["kind"] == "offset"].set_index("subject")["position_um"]
    np.testing.assert_allclose(zeros / 250.0, of_readings.set_index("subject")["position_um"].loc[zeros.index])
    assert not unexplained((tmp_path / "found.html").read_text(encoding="utf-8"))


def test_a_chain_without_tolerances_and_options_without_meaning_are_refused(tmp_path: Path) -> None:
    place = planned(tmp_path / "arm")
    text = (place / "campaign.toml").read_text(encoding="utf-8")
    (place / "campaign.toml").write_text(text.replace("[mechanism.tolerance]", "[workspace]").replace(
        "offset_deg = 0.05\nlength_mm = 0.3\nangle_deg = 0.03\n", ""))  # fmt: skip
    done = call(place, "--tolerances")
    assert done.exit_code == 2
    assert_says(done.output, "mechanism.tolerance", "offset_deg")
    done = call(SAMPLE, "--uniqueness", "--causes", "joint-compliance")
    assert done.exit_code == 2
    assert_says(done.output, "--causes")


@pytest.mark.parametrize(
    ("option", "instead"),
    [("--accuracy", "Positioning"), ("--uniqueness", "one position"), ("--tolerances", "truing power")],
)
def test_an_axis_names_what_it_has_instead(tmp_path: Path, option: str, instead: str) -> None:
    done = call(axis(tmp_path / "stage"), option)
    assert done.exit_code == 2
    assert_says(done.output, "axis", instead)


def test_power_says_what_a_run_will_decide_of_the_requirements(tmp_path: Path) -> None:
    """By the same figures as --accuracy: expected error, and held-out poses that decide."""
    place = planned(tmp_path / "arm", workspace=REQUIRED.replace("0.012", "0.03"))
    (place / "configurations.csv").write_bytes((SAMPLE / "configurations.csv").read_bytes())
    done = call(place, "--accuracy", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    found = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas().query("poses == 'own'").set_index("component")
    done = call(place, "--causes", "joint-gain", "--draws", 0, "--out", tmp_path / "power.csv", command="power")
    assert done.exit_code == 0, done.output
    held_out = int(found.loc["x", "held_out_needed"])
    assert_says(done.output, "Requirement along x", "30.0 µm required: met", f"{held_out} held-out poses decide it")
    assert_says(done.output, "Requirement along z", "1 µm required: not met")
