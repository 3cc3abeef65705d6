"""Angles in degrees, minutes and seconds are read as their decimal degrees, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from tests.pipeline.test_init_exports import init, numbers, table
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS
from truing.formats.sexagesimal import degrees_of, parsed_angles
from truing.schemas.faults import CampaignFaults

FORMS = (
    "{sign}{d}°{m:02d}'{s:06.3f}\"",
    "{sign}{d:03d}° {m:02d}′ {s:06.3f}″",
    "{sign}{d} {m} {s:.3f}",
    "{sign}{d}-{m:02d}-{s:06.3f}",
    "{sign}{d}:{m:02d}:{s:06.3f}",
    "{sign}{d}d{m:02d}m{s:06.3f}s",
)
ANGLES = np.array([0.0, 1e-4, -0.0125, 12.582416667, -0.999, 359.9999, -720.5, 45.25])


def _written(form: str, angle: float, mark: str = ".") -> str:
    milliseconds = round(abs(angle) * 3.6e6)
    minutes, rest = divmod(milliseconds, 60_000)
    text = form.format(sign="-" if angle < 0.0 else "", d=minutes // 60, m=minutes % 60, s=rest / 1000.0)
    return text.replace(".", mark)


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_angle_that_was_written(form: str, mark: str) -> None:
    texts = pa.array([*(_written(form, angle, mark) for angle in ANGLES), "", None])
    angles, bad = parsed_angles(texts)
    assert not bad.any()
    assert angles.to_pylist()[-2:] == [None, None]
    assert_close(np.array(angles.to_pylist()[:-2]), ANGLES, atol=1.0 / 3.6e6, what="angles")


@pytest.mark.parametrize(("text", "degrees"), [("12°30'", 12.5), ("-12° 30.6'", -12.51), ("7°59'60.0\"", 8.0)])
def test_seconds_may_be_absent_or_rounded_up(text: str, degrees: float) -> None:
    assert degrees_of(text) == pytest.approx(degrees, abs=1e-12)


@pytest.mark.parametrize("text", ["12.5", "12", "12°75'00\"", "12°30.5'10\"", "12°30'61\"", "one", "12°", "1 2 3 4"])
def test_no_other_text_is_such_an_angle(text: str) -> None:
    assert degrees_of(text) is None


def _campaign(folder: Path, readings: list[str], unit: str) -> None:
    rows = [f"{k + 1};{15 * k}°00'00.0\";{reading}" for k, reading in enumerate(readings)]
    (folder / "axis.csv").write_text("\n".join(["nr;at;shown", *rows]) + "\n", encoding="utf-8")
    columns = 'columns = { pose = "nr", command_deg = "at", measured_deg = "shown" }'
    units = f'units = {{ command_deg = "dms"{unit} }}'
    (folder / "campaign.toml").write_text(
        '[campaign]\nname = "axis"\nkind = "photogrammetry"\n'
        '[mechanism]\ntype = "axis"\nkind = "rotary"\ncommand = "command_deg"\n[noise]\nmeasured_deg = 1e-3\n'
        f'[files.configurations]\npath = "axis.csv"\nseparator = ";"\nquote = ""\n{columns}\n{units}\n',
        encoding="utf-8",
    )


def test_a_unit_of_the_mapping_reads_the_column(tmp_path: Path) -> None:
    at = 15.0 * np.arange(8) + 0.01
    _campaign(tmp_path, [_written(FORMS[0], angle) for angle in at], ', measured_deg = "dms"')
    found = run_line(tmp_path, "ingest")[0]["configurations"].to_pandas()
    assert_close(found["command_deg"], 15.0 * np.arange(8), atol=1e-12, what="commands")
    assert_close(found["measured_deg"], at, atol=1e-6, what="readings")


@pytest.mark.parametrize(
    ("cell", "unit", "expected"),
    [("15.01", ', measured_deg = "dms"', "degrees, minutes and seconds"), ("15°00'36\"", "", 'the unit "dms"')],
)
def test_an_angle_in_the_other_notation_is_a_fault_with_its_cure(
    tmp_path: Path, cell: str, unit: str, expected: str
) -> None:
    _campaign(tmp_path, [cell] * 8, unit)
    with pytest.raises(CampaignFaults, match=expected):
        run_line(tmp_path, "ingest")


@pytest.mark.parametrize(("mark", "separator"), [(".", ","), (",", ";")])
def test_init_proposes_the_unit_of_marked_angles(tmp_path: Path, mark: str, separator: str) -> None:
    at = 15.0 * np.arange(24)
    off = np.random.default_rng(1).normal(0.0, 1e-3, 24).round(6)
    rows = [
        [str(k + 1), *(_written(FORMS[0], a, mark) for a in pair)]
        for k, pair in enumerate(zip(at, at + off, strict=True))
    ]
    lines = [separator.join(cells) for cells in (["Nr", "Command", "Measured"], *rows)]
    (tmp_path / "axis.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "command_deg", "measured_deg"), np.column_stack([at, at + off]), atol=1e-6, what="axis")
