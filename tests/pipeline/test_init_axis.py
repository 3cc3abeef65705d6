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
def test_readings_beside_positions_of_an_axis_are_deviations_of_an_asked_sign(
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
