"""Causes hidden in the readings of an axis are found with their subject and size."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.blind.generator.axis import Hidden, record, write
from tests.faults import assert_fault, faults_of
from tests.sentences import assert_says
from tests.stages.axis_campaigns import BACKLASH, HIDDEN, SHIFT, axis_layout, truing_command
from truing.stages.predict import predict


def test_an_unnamed_dependence_on_a_column_is_reported_and_predicted_from_it(tmp_path: Path) -> None:
    layout = axis_layout(event_row=None)
    warmth = 20.0 + 5.0 * np.sin(np.arange(40) / 3.0) + np.random.default_rng(2).uniform(-1.0, 1.0, 40)
    made = record(layout, (), np.random.default_rng(3), {"measured": 0.004 * (warmth - 20.0)})
    folder = write(made, tmp_path / "campaign")
    table = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    with_warmth = [f"{table[0]},temperature_c", *(f"{row},{t:.6f}" for row, t in zip(table[1:], warmth, strict=True))]
    (folder / "configurations.csv").write_text("\n".join(with_warmth) + "\n", encoding="utf-8")
    assert truing_command("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    found = [(row["cause"], row["subject"], row["follows"]) for row in rows if row["verdict"] == "found"]
    assert found == [("unexplained", "instrument", "temperature_c")]
    model = (tmp_path / "run" / "model.toml").read_text(encoding="utf-8")
    bare = pa.table({"pose": [1], "command_deg": [10.0]})
    assert_fault(faults_of(lambda: predict(model, bare, "there.csv")), file="there.csv", column="temperature_c")
    inputs = pa.table({"pose": [1, 2], "command_deg": [10.0, 10.0], "temperature_c": [18.0, 22.0]})
    reported = predict(model, inputs, "there.csv").to_pandas()
    reported = reported[reported["encoder"] == "measured"]
    moved = reported["value"].to_numpy()[1] - reported["value"].to_numpy()[0]
    assert abs(moved - 0.004 * 4.0) < 4.0 * reported["sigma"].max() < 0.2 * moved


def test_a_shift_between_two_onsets_that_are_tried_is_dated_to_its_row(tmp_path: Path) -> None:
    sweep = np.linspace(-80.0, 80.0, 40)
    command, onset = np.tile(np.concatenate([sweep, sweep[::-1]]), 6), 302  # every third row is tried
    layout = axis_layout(command=command, event_row=None, held_out=np.arange(480) % 5 == 3)
    hidden = (Hidden("zero-shift", "instrument", SHIFT, onset),)
    folder = write(record(layout, hidden, np.random.default_rng(8)), tmp_path / "campaign")
    assert truing_command("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    (found,) = (row for row in rows if row["verdict"] == "found")
    assert (found["cause"], found["subject"]) == ("zero-shift", "instrument")
    poses = pyarrow.csv.read_csv(folder / "configurations.csv").column("pose")
    assert json.loads(found["parameters"])["from_pose"]["value"] == str(poses[onset])


def test_two_errors_per_turn_and_a_shifted_zero_are_named_together(tmp_path: Path) -> None:
    """One curve of the command absorbs both errors; none of it is left for an effect without a name."""
    sweep = np.linspace(0.0, 360.0, 25)
    command, turn = np.tile(np.concatenate([sweep, sweep[::-1]]), 2), np.deg2rad(360.0) / 360.0
    layout = axis_layout(
        command=command, channels=("measured",), noise={"command": 0.0, "measured": 1e-4}, event_row=50
    )
    layout = replace(layout, held_out=np.arange(100) % 5 == 3)
    sizes = {1: 2.4e-3, 2: 1.2e-3}
    course = sum(size * np.sin(order * turn * command + 0.7) for order, size in sizes.items())
    course = course + 1.8e-3 * (np.arange(100) >= 50)
    folder = write(record(layout, (), np.random.default_rng(3), {"measured": course}), tmp_path / "campaign")
    assert truing_command("run", str(folder), "--only", "diagnose", "--out", str(tmp_path / "run"))[0] == 0
    found = [row for row in pq.read_table(tmp_path / "run/diagnosis.parquet").to_pylist() if row["verdict"] == "found"]
    assert sorted(row["cause"] for row in found) == ["periodic-error", "periodic-error", "zero-shift"]
    reported = [json.loads(row["parameters"]) for row in found if row["cause"] == "periodic-error"]
    for one in reported:
        order = round(2.0 * np.pi / one["period"]["value"])
        amplitude = one["amplitude"]
        assert abs(amplitude["value"] - np.deg2rad(sizes[order])) < 4.0 * amplitude["sigma"] < 0.2 * amplitude["value"]


def test_growth_with_temperature_is_named_and_predicted_about_its_fixed_point(tmp_path: Path) -> None:
    warmth = 20.0 + 2.0 * np.sin(np.arange(40) / 3.0) + np.random.default_rng(2).uniform(-1.0, 1.0, 40)
    layout = axis_layout(event_row=None, temperature=np.round(warmth, 2), held_out=np.zeros(40, dtype=bool))
    growth, fixed = 1e-4, 30.0
    course = growth * (warmth - warmth.mean()) * (layout.command - fixed)
    folder = write(record(layout, (), np.random.default_rng(3), {"measured": course}), tmp_path / "campaign")
    assert truing_command("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    found = [row for row in rows if row["verdict"] == "found"]
    assert [(row["cause"], row["subject"]) for row in found] == [("axis-growth", "instrument")]
    reported = json.loads(found[0]["parameters"])
    assert abs(reported["growth"]["value"] - growth) < 4.0 * reported["growth"]["sigma"] < 0.2 * growth
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "with temperature" in page
    assert "rows left out in turn" in page
    assert "eld-out" not in page  # no row has the role of verification
    model = (tmp_path / "run" / "model.toml").read_text(encoding="utf-8")
    inputs = pa.table(
        {"pose": [1, 2, 3, 4], "command_deg": [30.0, 30.0, 75.0, 75.0], "temperature_c": [17.0, 23.0] * 2}
    )
    reported = predict(model, inputs, "there.csv").to_pandas()
    at = reported[reported["encoder"] == "measured"].set_index("pose")["value"]
    sigma = float(reported["sigma"].max())
    assert abs(at[2] - at[1]) < 6.0 * sigma
    assert abs(at[4] - at[3] - growth * 6.0 * 45.0) < 6.0 * sigma < 0.3 * growth * 270.0


@pytest.mark.parametrize("declared", ["", "period_deg = 37.0\n"])
def test_a_periodic_error_is_named_with_its_period(tmp_path: Path, declared: str) -> None:
    rng = np.random.default_rng(7)
    command = np.round(axis_layout().command + rng.uniform(-4.0, 4.0, 40), 3)
    hidden = Hidden("periodic-error", "encoder load", 0.006, period=37.0, phase=0.5)
    folder = write(record(axis_layout(command=command), (hidden,), rng), tmp_path / "campaign")
    settings = folder / "campaign.toml"
    text = settings.read_text(encoding="utf-8").replace("[noise]", f"{declared}[noise]")
    settings.write_text(text, encoding="utf-8")
    assert truing_command("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    found = [row for row in rows if row["verdict"] == "found"]
    assert [(row["cause"], row["subject"]) for row in found] == [("periodic-error", "encoder load")]
    reported = json.loads(found[0]["parameters"])
    assert (
        abs(reported["amplitude"]["value"] - np.deg2rad(0.006))
        < 4.0 * reported["amplitude"]["sigma"]
        < np.deg2rad(0.003)
    )
    period = reported["period"]
    assert abs(period["value"] - np.deg2rad(37.0)) < (1e-9 if declared else 4.0 * period["sigma"])
    assert "has a periodic error" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    model = (tmp_path / "run" / "model.toml").read_text(encoding="utf-8")
    inputs = pa.table({"pose": [1, 2], "command_deg": [10.0, 28.5]})
    table = predict(model, inputs, "there.csv").to_pandas()
    at = table[table["encoder"] == "load"].set_index("pose")["value"]
    wave = 0.006 * np.sin(2.0 * np.pi * np.array([10.0, 28.5]) / 37.0 + 0.5)
    assert abs(at[2] - at[1] - 18.5 - np.diff(wave)[0]) < 6.0 * table["sigma"].max()


def test_noise_declared_too_large_in_one_encoder_makes_no_finding_doubtful(tmp_path: Path) -> None:
    """An encoder that scatters as declared is noisier than one declared too noisy; that is no lack of the model."""
    command = np.tile(np.r_[np.linspace(-80.0, 80.0, 60), np.linspace(80.0, -80.0, 60)], 4)
    layout = axis_layout(
        command=command,
        channels=("motor", "measured"),
        noise={"command": 0.0, "motor": 1e-3, "measured": 5e-4},
        event_row=None,
        held_out=np.zeros(len(command), bool),
    )
    folder = write(record(layout, HIDDEN[:1], np.random.default_rng(6)), tmp_path / "campaign")
    settings = (folder / "campaign.toml").read_text(encoding="utf-8")
    assert settings.count("measured_deg = 0.0005") == 1
    (folder / "campaign.toml").write_text(settings.replace("measured_deg = 0.0005", "measured_deg = 0.001"))
    assert truing_command("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    reported = {(row["cause"], row["verdict"], row["reason_code"]) for row in rows if row["verdict"] != "rejected"}
    assert {row for row in reported if row[1] != "not testable"} == {
        ("lost-motion", "found", "found"),
        ("unexplained", "found", "noise"),  # the noise of the motor's encoder, next to that of the other
    }


def test_a_long_recording_is_compared_at_rows_that_are_spread_over_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("truing.stages.diagnosis.axis_points._MOST_ROWS", 90)
    command = np.tile(np.r_[np.linspace(-80.0, 80.0, 40), np.linspace(80.0, -80.0, 40)], 3)
    layout = axis_layout(command=command, event_row=None, held_out=np.zeros(len(command), bool))
    folder = write(record(layout, HIDDEN[:1], np.random.default_rng(7)), tmp_path / "campaign")
    code, output = truing_command("run", str(folder), "--out", str(tmp_path / "run"), "--only", "diagnose")
    assert code == 0
    assert "150 rows of 240, so that 90 evenly spread remain" in output
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    assert [row["cause"] for row in rows if row["verdict"] == "found"] == ["lost-motion"]


@pytest.mark.parametrize("cycles", [1, 2])
def test_a_load_that_leads_after_reversals_is_no_zero_shift(tmp_path: Path, cycles: int) -> None:
    """A gap that is compensated too much is negative; one sweep and back would pass for a shift of the zero."""
    command = np.tile(np.r_[np.arange(0.0, 361.0, 10.0), np.arange(350.0, -1.0, -10.0)], cycles)
    layout = axis_layout(command=command, channels=("measured",), event_row=None, held_out=np.zeros(len(command), bool))
    made = record(layout, (Hidden("lost-motion", "", -BACKLASH),), np.random.default_rng(8))
    folder = write(made, tmp_path / "campaign")
    code, output = truing_command("run", str(folder), "--out", str(tmp_path / "run"))
    assert code == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    found = {row["cause"]: json.loads(row["parameters"]) for row in rows if row["verdict"] == "found"}
    assert set(found) == {"lost-motion"}
    assert abs(found["lost-motion"]["backlash"]["value"] + np.deg2rad(BACKLASH)) < 0.05 * np.deg2rad(BACKLASH)
    assert_says(output, "load", "leads", "motor")
