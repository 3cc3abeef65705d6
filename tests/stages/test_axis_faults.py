"""Wrong settings, columns and recordings of an axis are reported with their place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.blind.generator.axis import AxisCampaign, record, write
from tests.changed_files import replace_text
from tests.stages.axis_campaigns import axis_campaign, axis_layout, truing_command
from truing.stages.common.axis_columns import AxisColumns
from truing.stages.quality.axis_checks import _repeated
from truing.stages.quality.check import CampaignLimits


@pytest.mark.parametrize(
    ("of", "old", "new", "expected"),
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
def test_unusable_inputs_are_named_with_their_place(tmp_path: Path, of: str, old: str, new: str, expected: str) -> None:
    folder = write(axis_campaign(), tmp_path / "c")
    replace_text(folder / of, old, new)
    code, said = truing_command("check", str(folder))
    assert code == 2
    assert expected in said
    assert "points.csv" not in said


def _verdicts(tmp_path: Path, campaign: AxisCampaign) -> tuple[int, dict[tuple[str, str], str], list[str]]:
    folder = write(campaign, tmp_path / "c")
    code, _ = truing_command("run", str(folder), "--out", str(tmp_path / "run"))
    rows = pq.read_table(tmp_path / "run" / "qa.parquet").to_pylist()
    causes = pq.read_table(tmp_path / "run" / "diagnosis.parquet").column("cause").to_pylist()
    return code, {(row["check"], row["subject"] or ""): row["verdict"] for row in rows}, causes


def test_a_unit_slip_fails_and_withholds_the_diagnosis(tmp_path: Path) -> None:
    made = axis_campaign()
    slipped = made.recorded.copy()
    slipped[:, 1] *= np.pi / 180.0
    code, verdicts, causes = _verdicts(tmp_path, AxisCampaign(made.layout, slipped))
    assert code == 3
    assert verdicts["axis-units", "load"] == "fail"
    assert verdicts["axis-units", "motor"] == "pass"
    assert causes == []


def test_a_frozen_encoder_and_copied_rows_are_seen(tmp_path: Path) -> None:
    made = axis_campaign()
    frozen = made.recorded.copy()
    frozen[20:, 0] = frozen[20, 0]
    code, verdicts, _ = _verdicts(tmp_path / "a", AxisCampaign(made.layout, frozen))
    assert code == 3
    assert verdicts["axis-standing-rows", "motor"] == "fail"
    copied = made.recorded.copy()
    copied[20:30] = copied[:10]
    layout = axis_layout(command=np.concatenate([made.layout.command[:20], made.layout.command[:20]]))
    code, verdicts, _ = _verdicts(tmp_path / "b", AxisCampaign(layout, copied))
    assert verdicts["axis-repeated-rows", ""] == "warn"


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
    made = record(axis_layout(command=np.full(40, 10.0)), (), np.random.default_rng(1))
    folder = write(made, tmp_path / "c")
    _, said = truing_command("check", str(folder))
    assert "command_deg never changes" in said


def test_commands_repeated_at_reversals_ask_for_their_direction(tmp_path: Path) -> None:
    folder = write(axis_campaign(), tmp_path / "campaign")
    assert "3 commands are repeated where the axis turns" in truing_command("check", str(folder))[1]
    file = folder / "configurations.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},approach", *(f"{row},1" for row in rows)]) + "\n")
    assert "repeated where the axis turns" not in truing_command("check", str(folder))[1]


def test_rows_that_were_appended_twice_are_reported_as_copies(tmp_path: Path) -> None:
    folder = write(axis_campaign(), tmp_path / "campaign")
    file = folder / "configurations.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, *rows, *rows[-3:]]) + "\n")
    code, said = truing_command("check", str(folder))
    assert code == 2
    assert "these rows repeat earlier ones in every value" in said
    other = rows[-1].replace("calibration", "verification")
    file.write_text("\n".join([head, *rows, *rows[-3:-1], other if other != rows[-1] else f"{rows[-1]}9"]) + "\n")
    code, said = truing_command("check", str(folder))
    assert code == 2
    assert "repeat earlier ones" not in said
