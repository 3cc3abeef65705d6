"""A campaign of one axis from its folder to the page, the model and its predictions."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.blind.generator.axis import write
from tests.report.explained import unexplained
from tests.stages.axis_campaigns import BACKLASH, SHIFT, axis_campaign, truing_command
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.settings_text import parsed_toml
from truing.stages.predict import predict


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("axis")
    folder = write(axis_campaign(), home / "campaign")
    assert truing_command("run", str(folder), "--out", str(home / "run"))[0] == 0
    return home / "run"


def test_the_hidden_cause_is_found_with_its_subject_and_size(run: Path) -> None:
    rows = pq.read_table(run / "diagnosis.parquet").to_pylist()
    found = [row for row in rows if row["verdict"] == "found"]
    assert {(row["cause"], row["subject"]) for row in found} == {("zero-shift", "instrument"), ("lost-motion", "")}
    assert len(found) == 2
    assert {row["cause"] for row in rows} >= {"scale-error", "lost-motion", "zero-shift", "periodic-error"}
    reported = {row["cause"]: json.loads(row["parameters"]) for row in found}
    for cause, name, size in (("lost-motion", "backlash", BACKLASH), ("zero-shift", "shift", SHIFT)):
        own = reported[cause][name]
        assert own["unit"] == "rad"
        assert abs(own["value"] - np.deg2rad(size)) < 4.0 * own["sigma"] < 0.2 * own["value"]
    settings = {row["cause"]: json.loads(row["settings"]) for row in found}
    assert settings["zero-shift"]["event"] == "power-cycle"


def test_errors_fall_to_the_noise_in_every_encoder_held_out_too(run: Path) -> None:
    errors = pq.read_table(run / "axis_errors.parquet").to_pandas()
    assert len(errors) == 120
    for (encoder, _), own in errors.groupby(["encoder", "role"]):
        before, after = (float(np.sqrt(np.mean(own[name] ** 2))) for name in ("missed_before", "missed_after"))
        assert after < 1.6 * own["noise_floor"].max()
        assert encoder == "motor" or before > 3.0 * after


def test_the_page_shows_the_axis_and_names_what_was_found(run: Path) -> None:
    page = (run / "report.html").read_text(encoding="utf-8")
    assert not unexplained(page)
    assert 'id="axis"' in page
    assert "otion is lost between" in page
    assert "power-cycle" in page


def test_the_model_predicts_readings_from_either_side(run: Path, tmp_path: Path) -> None:
    inputs = tmp_path / "commands.csv"
    inputs.write_text("pose,command_deg\n1,0\n2,10\n3,5\n", encoding="utf-8")
    assert (
        truing_command("predict", str(run / "model.toml"), str(inputs), "--out", str(tmp_path / "out.parquet"))[0] == 0
    )
    found = pq.read_table(tmp_path / "out.parquet").to_pandas().pivot(index="pose", columns="encoder", values="value")
    sigma = pq.read_table(tmp_path / "out.parquet").to_pandas()["sigma"]
    up, down = found.loc[2], found.loc[3]
    assert np.allclose(up["motor"] - 10.0, down["motor"] - 5.0, rtol=0, atol=1e-9)
    gap = (down["load"] - 5.0) - (up["load"] - 10.0)
    assert abs(gap - 2.0 * BACKLASH) < 8.0 * sigma.max() < BACKLASH
    assert truing_command("predict", str(run / "model.toml"), str(inputs), "--out", str(tmp_path / "out.csv"))[0] == 0
    again = pyarrow.csv.read_csv(tmp_path / "out.csv").to_pandas()
    assert np.allclose(again["value"], found[["motor", "load", "measured"]].to_numpy().ravel(), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pose,angle\n1,0\n", "column command_deg: expected a column of that name, where the axis is sent"),
        ("pose,command_deg\n1,\n2,3\n", "row 2, column command_deg: found 'None'; expected a number"),
    ],
)
def test_commands_that_cannot_be_predicted_are_named(run: Path, text: str, expected: str) -> None:
    table = pyarrow.csv.read_csv(io.BytesIO(text.encode()))
    with pytest.raises(CampaignFaults) as faults:
        predict((run / "model.toml").read_text(encoding="utf-8"), table, "there.csv")
    assert expected in str(faults.value.faults[0])


def test_a_model_of_an_axis_says_what_it_is(run: Path) -> None:
    about = parsed_toml((run / "model.toml").read_text(encoding="utf-8"))["model"]
    assert (about["mechanism"], about["kind"], about["loop"]) == ("axis", "rotary", "motor")


def test_other_commands_take_an_axis_or_say_why_not(run: Path, tmp_path: Path) -> None:
    code, said = truing_command("export", str(run), "--out", str(tmp_path / "exported"))
    assert code == 0, said
    assert parsed_toml((tmp_path / "exported" / "controller.toml").read_text(encoding="utf-8"))["effects"]
    code, said = truing_command("design", str(run.parent / "campaign"), "--poses", "3")
    assert (code, "--poses" in said) == (2, True)
    assert "readings: 5 targets from both sides" in said


def test_a_starter_knows_an_axis_by_its_columns(tmp_path: Path) -> None:
    folder = write(axis_campaign(), tmp_path / "c")
    (folder / "campaign.toml").unlink()
    assert truing_command("init", str(folder))[0] == 0
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    switched_on = "\n".join(line.removeprefix("# ") for line in text.splitlines() if "=" in line or "[" in line)
    made = read_campaign(parsed_toml(switched_on))
    assert (made.mechanism.type, made.noise.measured_deg) == ("axis", 0.001)
