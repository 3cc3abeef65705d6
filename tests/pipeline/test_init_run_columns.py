"""`truing init` on one file of several runs: the day of a positioning test, and the sequence of a sensor's loads."""

from __future__ import annotations

from pathlib import Path

from openpyxl import Workbook

from tests.pipeline.test_init_exports import init, table
from truing.formats.raw_tables import POSITIONING, SIGNALS

DAYS = ("2026-09-02", "2026-09-03", "2026-09-05")
TARGETS = (0.0, 30.0, 60.0, 90.0)


def _positioning(folder: Path, days: tuple[str, ...]) -> None:
    """A test of three cycles on each day; the clock differs in every row, and each day has a temperature of its own."""
    rows = ["Date;Time;Run;Direction;Target (mm);Deviation (um);Scale temp (C)"]
    for number, day in enumerate(days):
        for cycle in (1, 2, 3):
            for step, (mark, target) in enumerate([*(("+", x) for x in TARGETS), *(("-", x) for x in TARGETS[::-1])]):
                rows.append(f"{day};08:{cycle:02d}:{step:02d};{cycle};{mark};{target};{0.1 * step:.1f};{20 + number}")
    (folder / "laser.csv").write_text("\n".join([*rows, ""]))


def test_cycles_that_repeat_on_another_day_are_runs_of_their_days(tmp_path: Path) -> None:
    _positioning(tmp_path, DAYS)
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING).table
    assert tuple(dict.fromkeys(found.column("run").to_pylist())) == DAYS
    keys = [found.column(name).to_pylist() for name in ("run", "target_mm", "direction", "cycle")]
    assert len(set(zip(*keys, strict=True))) == found.num_rows == len(DAYS) * 3 * 2 * len(TARGETS)
    assert "# check: the values of Date are assumed to be runs" in (tmp_path / "campaign.toml").read_text()


def test_cycles_of_one_day_are_one_run_without_a_guess_on_days(tmp_path: Path) -> None:
    _positioning(tmp_path, DAYS[:1])
    _, document = init(tmp_path)
    assert len(set(table(tmp_path, document, POSITIONING).table.column("run").to_pylist())) == 1
    assert "Date" not in document["files"]["positioning"]["columns"].values()


def test_merged_cells_of_a_sequence_name_the_runs_of_loads(tmp_path: Path) -> None:
    book = Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(["Six-axis sensor: calibration"])
    sheet.append(["No.", "Sequence", "Fx [N]", "Fy [N]", "Fz [N]", *(f"CH{k} [mV/V]" for k in range(1, 7))])
    for row in range(12):
        load = [50.0 * (row % 4) if axis == row // 4 else 0.0 for axis in range(3)]
        sheet.append(
            [row + 1, row // 4 + 1 if row % 4 == 0 else None, *load, *(0.01 * sum(load) + k for k in range(6))]
        )
    for first in (3, 7, 11):
        sheet.merge_cells(start_row=first, end_row=first + 3, start_column=2, end_column=2)
    book.save(tmp_path / "calibration.xlsx")
    text, document = init(tmp_path)
    runs = table(tmp_path, document, SIGNALS).table.column("run").to_pylist()
    assert [str(run) for run in runs] == [str(1 + row // 4) for row in range(12)]
    assert "Name of the run" not in text
