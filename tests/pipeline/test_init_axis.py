"""`truing init` on instrument readings next to positions of an axis, and on texts without tables."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import numbers, table
from tests.tolerance import assert_close
from truing.pipeline.command_line import app
from truing.stages.ingestion.axis_rows import ROWS

AT = np.array([*np.arange(0.0, 361.0, 30.0), *np.arange(360.0, -1.0, -30.0)])
READINGS = np.round(4.0 * np.sin(np.radians(AT)), 2)


@pytest.mark.parametrize(
    ("head", "unit", "directions"),
    [
        ("run;direction;table_deg;face;reading_arcsec;sd_arcsec", "deg", ("cw", "ccw")),
        ("Lauf;Richtung;Tisch [deg];Fläche;Anzeige [arcsec];Streuung", "deg", ("+", "-")),
        ("run;dir;nominal_mm;no;reading_um;sd_um", "mm", ("cw", "ccw")),
    ],
)
@pytest.mark.parametrize("sign", ["place-command", "command-place"])
def test_readings_next_to_positions_of_an_axis_are_deviations_of_an_asked_sign(
    tmp_path: Path, head: str, unit: str, directions: tuple[str, str], sign: str
) -> None:
    rows = [
        f"{1 + k // 13};{directions[k // 13]};{at:.4f};{k % 13};{reading};0.12"
        for k, (at, reading) in enumerate(zip(AT, READINGS, strict=True))
    ]
    (tmp_path / "polygon.csv").write_text("\n".join(["# autocollimator", head, *rows]) + "\n", encoding="utf-8")
    (tmp_path / "memo.txt").write_text(
        "We turned the table to multiples of 30 degrees, first one way and then back, and read the collimator.\n"
        "The reading is in arcseconds, after the certificate was subtracted, as always in our laboratory.\n"
    )
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--answer", f"sign={sign}"])
    assert done.exit_code == 0, done.stderr
    document = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    assert document["mechanism"]["type"] == "axis"
    assert list(document["files"]) == ["configurations"]
    found = table(tmp_path, document, ROWS)
    factor = (1.0 if sign == "place-command" else -1.0) / (3600.0 if unit == "deg" else 1000.0)
    expected = np.column_stack([AT, factor * READINGS])
    assert_close(numbers(found, f"command_{unit}", f"deviation_{unit}"), expected, atol=1e-12, what="axis")
    columns = {"pose", f"command_{unit}", f"deviation_{unit}", "approach"}
    assert set(found.table.column_names) == columns, "no conditions"
    assert found.table.column("approach").to_pylist() == [1] * 13 + [-1] * 13
    assert "memo.txt: text without a table" in done.stdout


def test_a_file_that_is_not_recognised_says_why_and_where_entries_are_described(tmp_path: Path) -> None:
    (tmp_path / "odd.csv").write_text("foo,bar,baz\n" + "1,2,3\n" * 5)
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert "no table has columns of these names; columns foo, bar, baz" in done.stdout
    for text in (done.stdout, (tmp_path / "campaign.toml").read_text()):
        assert "docs/own-files.md" in text


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        ("Air temperature [°C];T_mat [°C]", {"air_temperature_c": 20.0, "mat_temperature_c": 21.0}),
        ("Temperatur Maßstab;Spindle Temp [F]", {"massstab_temperature_c": 20.0, "spindle_temperature_c": -6.1111}),
        ("Air Temp (°F);Temp (C)", {"air_temperature_c": -6.6667, "temperature_c": 21.0}),
    ],
)
def test_temperatures_next_to_an_axis_are_read_with_their_units(
    tmp_path: Path, head: str, expected: dict[str, float]
) -> None:
    rows = [f"{k};{37.0 * k:.3f};{37.0 * k + 1e-3:.5f};20.0;21.0" for k in range(9)]
    (tmp_path / "axis.csv").write_text("\n".join([f"No;Nominal [mm];Laser [mm];{head}", *rows]) + "\n")
    assert CliRunner().invoke(app, ["init", str(tmp_path)]).exit_code == 0
    document = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    found = table(tmp_path, document, ROWS)
    assert_close(numbers(found, *expected)[0], list(expected.values()), atol=1e-4, what="temperatures")


def test_temperatures_of_air_and_machine_are_read_next_to_positioning_runs(tmp_path: Path) -> None:
    head = "Run;Direction;Target (mm);Error (µm);Air temp (°C);Machine temp (°F);Pressure (mbar)"
    rows = [f"1;{'+' if k < 5 else '-'};{40.0 * min(k, 9 - k):.1f};{0.1 * k};20.5;69.8;1012" for k in range(10)]
    (tmp_path / "axis.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    assert CliRunner().invoke(app, ["init", str(tmp_path)]).exit_code == 0
    files = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))["files"]["positioning"]
    assert files["columns"]["air_temperature_c"] == "Air temp (°C)"
    assert files["columns"]["material_temperature_c"] == "Machine temp (°F)"
    assert files["units"]["material_temperature_c"] == "degF"


def test_encoders_in_counts_say_what_an_entry_needs(tmp_path: Path) -> None:
    rows = [f"{4200 * k}\t{7 * k % 50}.5\t{1000 * (7 * k % 50)}\t{77 * (7 * k % 50)}" for k in range(12)]
    (tmp_path / "axis.tsv").write_text("\n".join(["t_ms\tcmd_deg\tmotor_cnt\tload_cnt", *rows]) + "\n")
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert "encoders in counts: motor_cnt, load_cnt" in done.stdout
    assert 'motor_deg = { name = "motor_cnt", scale = 0.001, unit = "deg" }' in done.stdout
