"""A campaign of one axis from its folder to the page, the model and its predictions; and refusals."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.axis import AxisCampaign, AxisLayout, Hidden, record, write
from tests.faults import assert_fault, faults_of
from tests.report.explained import unexplained
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.settings_text import parsed_toml
from truing.simulation.axis.rows import AxisRows, approaches
from truing.stages.common.approaches import _configurations
from truing.stages.common.axis_columns import AxisColumns
from truing.stages.predict import predict
from truing.stages.quality.axis_checks import _repeated
from truing.stages.quality.check import CampaignLimits

BACKLASH, SHIFT, EVENT_ROW = 0.012, 0.02, 26


def _layout(**changes: object) -> AxisLayout:
    sweep = np.linspace(-80.0, 80.0, 10)
    given = {
        "kind": "rotary",
        "loop": "motor",
        "channels": ("motor", "load", "measured"),
        "command": np.concatenate([sweep, sweep[::-1], sweep, sweep[::-1]]),
        "noise": {"command": 1e-3, "motor": 3e-4, "load": 1e-3, "measured": 1e-3},
        "event_row": EVENT_ROW,
        "held_out": np.arange(40) % 5 == 3,
    }
    return AxisLayout(**(given | changes))  # type: ignore[arg-type]


HIDDEN = (Hidden("lost-motion", "", BACKLASH), Hidden("zero-shift", "instrument", SHIFT, EVENT_ROW, True))


def _campaign() -> AxisCampaign:
    return record(_layout(), HIDDEN, np.random.default_rng(5))


def _truing(*arguments: str) -> tuple[int, str]:
    """Exit code and all that was said."""
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.output


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("axis")
    folder = write(_campaign(), home / "campaign")
    assert _truing("run", str(folder), "--out", str(home / "run"))[0] == 0
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


def test_commands_repeated_at_reversals_ask_for_their_direction(tmp_path: Path) -> None:
    folder = write(_campaign(), tmp_path / "campaign")
    assert "3 commands are repeated where the axis turns" in _truing("check", str(folder))[1]
    file = folder / "configurations.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},approach", *(f"{row},1" for row in rows)]) + "\n")
    assert "repeated where the axis turns" not in _truing("check", str(folder))[1]


def test_rows_that_were_appended_twice_are_told_as_copies(tmp_path: Path) -> None:
    folder = write(_campaign(), tmp_path / "campaign")
    file = folder / "configurations.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, *rows, *rows[-3:]]) + "\n")
    code, said = _truing("check", str(folder))
    assert code == 2
    assert "these rows repeat earlier ones in every value" in said
    other = rows[-1].replace("calibration", "verification")
    file.write_text("\n".join([head, *rows, *rows[-3:-1], other if other != rows[-1] else f"{rows[-1]}9"]) + "\n")
    code, said = _truing("check", str(folder))
    assert code == 2
    assert "repeat earlier ones" not in said


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
    assert _truing("predict", str(run / "model.toml"), str(inputs), "--out", str(tmp_path / "out.parquet"))[0] == 0
    found = pq.read_table(tmp_path / "out.parquet").to_pandas().pivot(index="pose", columns="encoder", values="value")
    sigma = pq.read_table(tmp_path / "out.parquet").to_pandas()["sigma"]
    up, down = found.loc[2], found.loc[3]
    assert np.allclose(up["motor"] - 10.0, down["motor"] - 5.0, rtol=0, atol=1e-9)
    gap = (down["load"] - 5.0) - (up["load"] - 10.0)
    assert abs(gap - 2.0 * BACKLASH) < 8.0 * sigma.max() < BACKLASH
    assert _truing("predict", str(run / "model.toml"), str(inputs), "--out", str(tmp_path / "out.csv"))[0] == 0
    again = pyarrow.csv.read_csv(tmp_path / "out.csv").to_pandas()
    assert np.allclose(again["value"], found[["motor", "load", "measured"]].to_numpy().ravel(), rtol=1e-12)


def test_an_unnamed_dependence_on_a_column_is_reported_and_predicted_from_it(tmp_path: Path) -> None:
    layout = _layout(event_row=None)
    warmth = 20.0 + 5.0 * np.sin(np.arange(40) / 3.0) + np.random.default_rng(2).uniform(-1.0, 1.0, 40)
    made = record(layout, (), np.random.default_rng(3), {"measured": 0.004 * (warmth - 20.0)})
    folder = write(made, tmp_path / "campaign")
    table = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    with_warmth = [f"{table[0]},temperature_c", *(f"{row},{t:.6f}" for row, t in zip(table[1:], warmth, strict=True))]
    (folder / "configurations.csv").write_text("\n".join(with_warmth) + "\n", encoding="utf-8")
    assert _truing("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
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
    layout = _layout(command=command, event_row=None, held_out=np.arange(480) % 5 == 3)
    hidden = (Hidden("zero-shift", "instrument", SHIFT, onset),)
    folder = write(record(layout, hidden, np.random.default_rng(8)), tmp_path / "campaign")
    assert _truing("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    (found,) = (row for row in rows if row["verdict"] == "found")
    assert (found["cause"], found["subject"]) == ("zero-shift", "instrument")
    poses = pyarrow.csv.read_csv(folder / "configurations.csv").column("pose")
    assert json.loads(found["parameters"])["from_pose"]["value"] == str(poses[onset])


def test_two_errors_per_turn_and_a_shifted_zero_are_named_together(tmp_path: Path) -> None:
    """One curve of the command absorbs both errors; none of it is left for an effect without a name."""
    sweep = np.linspace(0.0, 360.0, 25)
    command, turn = np.tile(np.concatenate([sweep, sweep[::-1]]), 2), np.deg2rad(360.0) / 360.0
    layout = _layout(command=command, channels=("measured",), noise={"command": 0.0, "measured": 1e-4}, event_row=50)
    layout = replace(layout, held_out=np.arange(100) % 5 == 3)
    sizes = {1: 2.4e-3, 2: 1.2e-3}
    course = sum(size * np.sin(order * turn * command + 0.7) for order, size in sizes.items())
    course = course + 1.8e-3 * (np.arange(100) >= 50)
    folder = write(record(layout, (), np.random.default_rng(3), {"measured": course}), tmp_path / "campaign")
    assert _truing("run", str(folder), "--only", "diagnose", "--out", str(tmp_path / "run"))[0] == 0
    found = [row for row in pq.read_table(tmp_path / "run/diagnosis.parquet").to_pylist() if row["verdict"] == "found"]
    assert sorted(row["cause"] for row in found) == ["periodic-error", "periodic-error", "zero-shift"]
    reported = [json.loads(row["parameters"]) for row in found if row["cause"] == "periodic-error"]
    for one in reported:
        order = round(2.0 * np.pi / one["period"]["value"])
        amplitude = one["amplitude"]
        assert abs(amplitude["value"] - np.deg2rad(sizes[order])) < 4.0 * amplitude["sigma"] < 0.2 * amplitude["value"]


def test_growth_with_temperature_is_named_and_predicted_about_its_fixed_point(tmp_path: Path) -> None:
    warmth = 20.0 + 2.0 * np.sin(np.arange(40) / 3.0) + np.random.default_rng(2).uniform(-1.0, 1.0, 40)
    layout = _layout(event_row=None, temperature=np.round(warmth, 2), held_out=np.zeros(40, dtype=bool))
    growth, fixed = 1e-4, 30.0
    course = growth * (warmth - warmth.mean()) * (layout.command - fixed)
    folder = write(record(layout, (), np.random.default_rng(3), {"measured": course}), tmp_path / "campaign")
    assert _truing("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
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
    command = np.round(_layout().command + rng.uniform(-4.0, 4.0, 40), 3)
    hidden = Hidden("periodic-error", "encoder load", 0.006, period=37.0, phase=0.5)
    folder = write(record(_layout(command=command), (hidden,), rng), tmp_path / "campaign")
    settings = folder / "campaign.toml"
    text = settings.read_text(encoding="utf-8").replace("[noise]", f"{declared}[noise]")
    settings.write_text(text, encoding="utf-8")
    assert _truing("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
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


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("pose,angle\n1,0\n", "column command_deg: expected a column of that name, where the axis is sent"),
        ("pose,command_deg\n1,\n2,3\n", "row 2, column command_deg: found 'None'; expected a number"),
    ],
)
def test_commands_that_cannot_be_predicted_are_named(run: Path, text: str, told: str) -> None:
    table = pyarrow.csv.read_csv(io.BytesIO(text.encode()))
    with pytest.raises(CampaignFaults) as faults:
        predict((run / "model.toml").read_text(encoding="utf-8"), table, "there.csv")
    assert told in str(faults.value.faults[0])


def _broken(folder: Path, of: str, old: str, new: str) -> Path:
    path = write(_campaign(), folder) / of
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("of", "old", "new", "told"),
    [
        (
            "configurations.csv",
            "motor_deg",
            "motr_deg",
            "column motor_deg: expected this column, which [mechanism] motor",
        ),
        ("configurations.csv", "1,calibration,0,-80.0000", "1,calibration,0,", "row 2, column command_deg"),
        ("configurations.csv", "1,calibration,0,", "1,calibration,60,", "column time_s"),
        ("configurations.csv", "measured_deg", "measured_mm", "expected measured_deg: the axis is rotary"),
        ("campaign.toml", "motor_deg = 0.0003\n", "", "noise.motor_deg"),
        ("campaign.toml", '"command_deg"', '"command_counts"', "counts_per_deg"),
        ("campaign.toml", '"command_deg"', '"command_mm"', "a column ..._deg or ..._counts as command"),
        ("campaign.toml", 'load = "load_deg"', 'load = "motor_deg"', "different columns for command, motor and load"),
        ("campaign.toml", 'kind = "rotary"', 'kind = "round"', "mechanism.kind"),
        (
            "campaign.toml",
            'kind = "rotary"',
            'kind = "rotary"\nperiod_mm = 5.0',
            "expected period_deg for a rotary axis",
        ),
    ],
)
def test_unusable_inputs_are_named_with_their_place(tmp_path: Path, of: str, old: str, new: str, told: str) -> None:
    code, said = _truing("check", str(_broken(tmp_path / "c", of, old, new)))
    assert code == 2
    assert told in said
    assert "points.csv" not in said


def _verdicts(tmp_path: Path, campaign: AxisCampaign) -> tuple[int, dict[tuple[str, str], str], list[str]]:
    folder = write(campaign, tmp_path / "c")
    code, _ = _truing("run", str(folder), "--out", str(tmp_path / "run"))
    rows = pq.read_table(tmp_path / "run" / "qa.parquet").to_pylist()
    causes = pq.read_table(tmp_path / "run" / "diagnosis.parquet").column("cause").to_pylist()
    return code, {(row["check"], row["subject"] or ""): row["verdict"] for row in rows}, causes


def test_a_unit_slip_fails_and_withholds_the_diagnosis(tmp_path: Path) -> None:
    made = _campaign()
    slipped = made.recorded.copy()
    slipped[:, 1] *= np.pi / 180.0
    code, verdicts, causes = _verdicts(tmp_path, AxisCampaign(made.layout, slipped))
    assert code == 3
    assert verdicts["axis-units", "load"] == "fail"
    assert verdicts["axis-units", "motor"] == "pass"
    assert causes == []


def test_a_frozen_encoder_and_copied_rows_are_seen(tmp_path: Path) -> None:
    made = _campaign()
    frozen = made.recorded.copy()
    frozen[20:, 0] = frozen[20, 0]
    code, verdicts, _ = _verdicts(tmp_path / "a", AxisCampaign(made.layout, frozen))
    assert code == 3
    assert verdicts["axis-standing-rows", "motor"] == "fail"
    copied = made.recorded.copy()
    copied[20:30] = copied[:10]
    layout = _layout(command=np.concatenate([made.layout.command[:20], made.layout.command[:20]]))
    code, verdicts, _ = _verdicts(tmp_path / "b", AxisCampaign(layout, copied))
    assert verdicts["axis-repeated-rows", ""] == "warn"


def test_approaches_without_times_are_no_recording_in_motion() -> None:
    up = [
        (40.0 * k, way, cycle)
        for cycle in (1, 2)
        for way, ks in (("forward", range(9)), ("backward", range(8, -1, -1)))
        for k in ks
    ]
    target, way, cycle = zip(*up, strict=True)
    positions = {"target_mm": target, "direction": way, "cycle": cycle, "position_mm": target}
    table = _configurations(pa.table(positions | {"run": ["X"] * len(up), "row_order": list(range(1, len(up) + 1))}))
    command = table.column("command_mm").to_numpy() / 1e3
    rows = AxisRows.of(table.column("pose").to_pylist(), table.column("time_s").to_numpy(), command, 1e-9)
    assert set(rows.direction[1::2][9:18]) == {-1.0}
    assert not rows.rate.any()


def test_a_coarse_resolution_repeats_rows_of_one_command_without_copies() -> None:
    rng, command = np.random.default_rng(7), np.tile(10.0 * np.arange(37), 6)
    reading = np.round(6.0 * np.sin(np.radians(command)) + 0.1 * rng.standard_normal(len(command)), 2)
    equal = len(command) - len(np.unique(np.column_stack([command, reading]), axis=0))
    assert equal > 5
    table = pa.table(
        {"pose": list(range(len(command))), "command_deg": command, "load_deg": command + reading / 3600.0}
    )
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", {"load": "load_deg"}, None)
    limits = CampaignLimits("photogrammetry", {})
    poses = np.arange(len(command)).astype(object)
    assert _repeated(table, columns, poses, limits).verdict == "pass"
    copied = pa.concat_tables([table, table.slice(0, 37)])
    assert _repeated(copied, columns, np.arange(len(copied)).astype(object), limits).verdict == "warn"


def test_an_axis_that_never_moves_is_not_evaluated(tmp_path: Path) -> None:
    made = record(_layout(command=np.full(40, 10.0)), (), np.random.default_rng(1))
    folder = write(made, tmp_path / "c")
    _, said = _truing("check", str(folder))
    assert "command_deg never changes" in said


def test_counts_and_whole_turns_are_brought_to_one_unit() -> None:
    table = pa.table({"c_counts": [0.0, 3600.0, 7200.0], "motor_deg": [0.5, 360.5, 0.5]})
    columns = AxisColumns("rotary", "deg", "motor", "c_counts", {"motor": "motor_deg"}, 10.0)
    assert np.allclose(columns.si(table, "c_counts"), [0.0, 2.0 * np.pi, 4.0 * np.pi])
    assert np.allclose(columns.deviations(table)[:, 0], np.deg2rad(0.5))


@pytest.mark.parametrize("zero_deg", [0.0, 130.0])
def test_readings_between_0_and_a_turn_are_none_of_its_errors(zero_deg: float) -> None:
    """Half of the readings of a table that turns from -180 to 180 deg are a whole turn larger than its commands."""
    command = np.tile(np.linspace(-180.0, 180.0, 25), 2)
    table = pa.table({"c_deg": command, "measured_deg": (command + zero_deg + 0.01) % 360.0})
    columns = AxisColumns("rotary", "deg", "motor", "c_deg", {"measured": "measured_deg"}, None)
    deviation = np.rad2deg(columns.deviations(table)[:, 0])
    assert np.ptp(deviation) < 1e-9
    assert_close(deviation % 360.0, np.full(len(command), zero_deg + 0.01), atol=1e-9)


def test_overflows_of_a_counter_are_no_errors_but_other_jumps_are() -> None:
    command = np.arange(0.0, 80.0, 4.0)  # mm, 1000 counts each: 16 bits overflow at 65.5 mm
    off = np.random.default_rng(1).normal(0.0, 2.0, len(command))
    columns = AxisColumns("linear", "mm", "motor", "command_mm", {"load": "load_counts"}, 1000.0)

    def deviations_um(counts: np.ndarray) -> np.ndarray:
        table = pa.table({"command_mm": command, "load_counts": counts})
        return columns.deviations(table)[:, 0] * 1e6  # counts are um

    truth = np.round(1000.0 * command + off)
    assert_close(deviations_um(truth % 2**16), truth - 1000.0 * command, atol=1e-6)
    signed = (truth + 2**15) % 2**16 - 2**15
    assert_close(np.ptp(deviations_um(signed) - off), 0.0, atol=1.0)
    jump = np.where(command > 40.0, 30000.0, 0.0)
    assert_close(deviations_um(truth % 2**16 * 0.0 + truth + jump), truth + jump - 1000.0 * command, atol=1e-6)


def test_commands_within_a_turn_go_on_where_an_encoder_counts_turns() -> None:
    turned = np.array([340.0, 460.0, 580.0, 700.0, 820.0, 700.0])
    table = pa.table(
        {
            "pose": np.arange(6),
            "time_s": np.arange(6.0),
            "command_deg": turned % 360.0,
            "motor_deg": turned + 5.0,
            "load_deg": turned % 360.0 + 0.01,
        }
    )
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", {"load": "load_deg", "motor": "motor_deg"}, None)
    rows = columns.rows(table, 0.0)
    assert_close(np.diff(rows.command), np.deg2rad(np.diff(turned)), atol=1e-12)
    assert rows.direction.tolist() == [1.0, 1.0, 1.0, 1.0, 1.0, -1.0]
    apart = columns.deviations(table) % (2.0 * np.pi)  # a constant zero is free, whole turns too
    assert_close(apart, np.deg2rad(np.tile([0.01, 5.0], (6, 1))), atol=1e-12)
    alone = AxisColumns("rotary", "deg", "motor", "command_deg", {"load": "load_deg"}, None)
    assert_close(alone.deviations(table), np.deg2rad(np.full((6, 1), 0.01)), atol=1e-12)


@pytest.mark.parametrize("slip", [lambda own: 60.0 * own, lambda own: own + 360.0 * (np.arange(len(own)) > 6)])
def test_commands_stay_where_a_slip_of_one_encoder_looks_like_turns(slip) -> None:  # type: ignore[no-untyped-def]
    command = np.array([-80.0, -60.0, -20.0, 20.0, 60.0, 80.0, 40.0, 10.0, -30.0, -70.0, 5.0, 75.0])
    recorded = {"command_deg": command, "motor_deg": command + 0.01, "measured_deg": slip(command)}
    table = pa.table({"pose": np.arange(12), "time_s": np.arange(12.0), **recorded})
    encoders = {"motor": "motor_deg", "measured": "measured_deg"}
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", encoders, None)
    assert_close(columns.commands(table), np.deg2rad(command), atol=1e-12)


def test_direction_of_approach_is_that_of_the_last_movement_larger_than_the_least() -> None:
    command = np.array([0.0, 1.0, 0.95, 0.9, 0.0, np.nan, -1.0])
    found, _ = approaches(command, np.arange(7.0), 0.1)
    assert found.tolist() == [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]


def test_travel_since_the_turn_is_counted_from_where_the_axis_stood_when_it_turned() -> None:
    command = np.array([0.0, 1.0, 3.0, 2.95, 1.0, 0.0, 0.5])
    _, found = approaches(command, np.arange(7.0), 0.1)
    assert_close(found, np.array([0.0, 1.0, 3.0, 3.0, 2.0, 3.0, 0.5]), atol=1e-12)


def test_a_model_of_an_axis_says_what_it_is(run: Path) -> None:
    about = parsed_toml((run / "model.toml").read_text(encoding="utf-8"))["model"]
    assert (about["mechanism"], about["kind"], about["loop"]) == ("axis", "rotary", "motor")


def test_other_commands_take_an_axis_or_say_why_not(run: Path, tmp_path: Path) -> None:
    code, said = _truing("export", str(run), "--out", str(tmp_path / "exported"))
    assert code == 0, said
    assert parsed_toml((tmp_path / "exported" / "controller.toml").read_text(encoding="utf-8"))["effects"]
    code, said = _truing("design", str(run.parent / "campaign"), "--poses", "3")
    assert (code, "--poses" in said) == (2, True)
    assert "readings: 5 targets from both sides" in said


def test_a_starter_knows_an_axis_by_its_columns(tmp_path: Path) -> None:
    folder = write(_campaign(), tmp_path / "c")
    (folder / "campaign.toml").unlink()
    assert _truing("init", str(folder))[0] == 0
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    switched_on = "\n".join(line.removeprefix("# ") for line in text.splitlines() if "=" in line or "[" in line)
    made = read_campaign(parsed_toml(switched_on))
    assert (made.mechanism.type, made.noise.measured_deg) == ("axis", 0.001)


def test_noise_declared_too_large_in_one_encoder_makes_no_finding_doubtful(tmp_path: Path) -> None:
    """An encoder that scatters as declared is noisier than one declared too noisy; that is no lack of the model."""
    command = np.tile(np.r_[np.linspace(-80.0, 80.0, 60), np.linspace(80.0, -80.0, 60)], 4)
    layout = _layout(
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
    assert _truing("run", str(folder), "--out", str(tmp_path / "run"))[0] == 0
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
    layout = _layout(command=command, event_row=None, held_out=np.zeros(len(command), bool))
    folder = write(record(layout, HIDDEN[:1], np.random.default_rng(7)), tmp_path / "campaign")
    code, output = _truing("run", str(folder), "--out", str(tmp_path / "run"), "--only", "diagnose")
    assert code == 0
    assert "150 rows of 240, so that 90 evenly spread remain" in output
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    assert [row["cause"] for row in rows if row["verdict"] == "found"] == ["lost-motion"]


@pytest.mark.parametrize("cycles", [1, 2])
def test_a_load_that_leads_after_reversals_is_no_zero_shift(tmp_path: Path, cycles: int) -> None:
    """A gap that is compensated too much is negative; one sweep and back would pass for a shift of the zero."""
    command = np.tile(np.r_[np.arange(0.0, 361.0, 10.0), np.arange(350.0, -1.0, -10.0)], cycles)
    layout = _layout(command=command, channels=("measured",), event_row=None, held_out=np.zeros(len(command), bool))
    made = record(layout, (Hidden("lost-motion", "", -BACKLASH),), np.random.default_rng(8))
    folder = write(made, tmp_path / "campaign")
    code, output = _truing("run", str(folder), "--out", str(tmp_path / "run"))
    assert code == 0
    rows = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    found = {row["cause"]: json.loads(row["parameters"]) for row in rows if row["verdict"] == "found"}
    assert set(found) == {"lost-motion"}
    assert abs(found["lost-motion"]["backlash"]["value"] + np.deg2rad(BACKLASH)) < 0.05 * np.deg2rad(BACKLASH)
    assert_says(output, "load", "leads", "motor")
