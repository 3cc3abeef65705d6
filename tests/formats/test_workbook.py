"""Sheets of Excel workbooks from two libraries give the same table; sheets without one are refused."""

from __future__ import annotations

import datetime
import itertools
import zipfile

import pytest
import xlsxwriter

from tests.formats.reading import read

openpyxl = pytest.importorskip("openpyxl", reason="not installed")

HEADER = ["Pose", "Marke", "X [mm]", "Y [mm]", "Z [mm]"]
ROWS = [[1, "T1", 1.5, 2.25, -3.0], [1, "T2", 4, 5, 6], [2, "T1", 7.125, 8, 9]]
ENTRY = {
    "path": "book.xlsx",
    "constants": {"body": "platform"},
    "columns": {"pose": "Pose", "target": "Marke", **{f"{a}_mm": f"{a.upper()} [mm]" for a in "xyz"}},
}
# ten entities, each forty times the one before
NAMES = "bcdefghijk"
ENTITIES = '<!ENTITY b "c">' + "".join(
    f'<!ENTITY {name} "{f"&{before};" * 40}">' for before, name in itertools.pairwise(NAMES)
)


def book(folder, sheets, name="book.xlsx", hidden=()):
    made = openpyxl.Workbook()
    made.remove(made.active)
    for title, rows in sheets.items():
        sheet = made.create_sheet(title)
        for row in rows:
            sheet.append(row)
        if title in hidden:
            sheet.sheet_state = "hidden"
    made.save(folder / name)
    return made


def changed(row, column, value):
    rows = [list(one) for one in ROWS]
    rows[row][column] = value
    return [HEADER, *rows]


def test_a_sheet_is_the_table_that_its_cells_hold(tmp_path):
    book(tmp_path, {"Data": [HEADER, *ROWS]})
    found = read(tmp_path, entries=ENTRY)
    assert found.faults == ()
    assert [found.columns[name] for name in ("pose", "target")] == [[1, 1, 2], ["T1", "T2", "T1"]]
    assert [found.columns[f"{a}_mm"] for a in "xyz"] == [[1.5, 4.0, 7.125], [2.25, 5.0, 8.0], [-3.0, 6.0, 9.0]]


def test_a_sheet_of_another_library_is_read_alike(tmp_path):
    with xlsxwriter.Workbook(str(tmp_path / "book.xlsx")) as made:
        sheet = made.add_worksheet("Data")
        for number, row in enumerate([HEADER, *ROWS]):
            sheet.write_row(number + 3, 1, row)  # tables need not begin at A1
    entry = {**ENTRY, "columns": ENTRY["columns"]}
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    assert found.columns["x_mm"] == [1.5, 4.0, 7.125]


def test_faults_name_sheet_and_row_of_the_file(tmp_path):
    rows = changed(1, 3, "#N/A")
    book(tmp_path, {"Data": [["Messung vom Montag"], [], rows[0], [], *rows[1:]]})
    (fault,) = read(tmp_path, entries={**ENTRY, "skip_lines": 1}).faults
    assert (fault.file, fault.row, fault.column, fault.value) == ("book.xlsx, sheet Data", 6, "Y [mm]", "#N/A")


def test_one_of_several_sheets_has_to_be_named(tmp_path):
    book(tmp_path, {"A": [HEADER, *ROWS], "B": [HEADER, ROWS[0]], "Notes": []}, hidden=("B",))
    assert len(read(tmp_path, entries=ENTRY).records) == 3
    assert len(read(tmp_path, entries={**ENTRY, "sheet": "B"}).records) == 1
    assert len(read(tmp_path, entries={**ENTRY, "sheet": 2}).records) == 1
    book(tmp_path, {"A": [HEADER, *ROWS], "B": [HEADER, ROWS[0]]})
    (fault,) = read(tmp_path, entries=ENTRY).faults
    assert "sheet = 'A'" in fault.expected
    (fault,) = read(tmp_path, entries={**ENTRY, "sheet": "C"}).faults
    assert (fault.column, fault.value) == ("sheet", "C")


def test_a_formula_without_its_result_is_no_number(tmp_path):
    book(tmp_path, {"Data": changed(2, 2, "=A1+1")})
    (fault,) = read(tmp_path, entries=ENTRY).faults
    assert (fault.row, fault.column) == (4, "X [mm]")
    assert "formula" in fault.expected


def test_a_formula_with_its_result_is_that(tmp_path):
    with xlsxwriter.Workbook(str(tmp_path / "book.xlsx")) as made:
        sheet = made.add_worksheet("Data")
        for number, row in enumerate([HEADER, *ROWS]):
            sheet.write_row(number, 0, row)
        sheet.write_formula(1, 2, "=3/2", None, 1.5)
    found = read(tmp_path, entries=ENTRY)
    assert found.faults == ()
    assert found.columns["x_mm"][0] == 1.5


def test_an_empty_cell_is_a_fault_as_in_text(tmp_path):
    book(tmp_path, {"Data": changed(0, 4, None)})
    (fault,) = read(tmp_path, entries=ENTRY).faults
    assert (fault.row, fault.column, fault.value) == (2, "Z [mm]", "")
    left = read(tmp_path, entries={**ENTRY, "missing": [""]})
    assert left.faults == ()
    assert len(left.records) == 2


def test_cells_merged_downwards_hold_their_value_in_every_row(tmp_path):
    made = book(tmp_path, {"Data": changed(1, 0, None)})
    made["Data"].merge_cells("A2:A3")
    made.save(tmp_path / "book.xlsx")
    found = read(tmp_path, entries=ENTRY)
    assert found.faults == ()
    assert found.columns["pose"] == [1, 1, 2]


def test_an_empty_cell_below_merged_ones_stays_empty(tmp_path):
    rows = [*changed(1, 0, None), [None, "T2", 1.0, 2.0, 3.0]]
    made = book(tmp_path, {"Data": rows})
    made["Data"].merge_cells("A2:A3")
    made.save(tmp_path / "book.xlsx")
    (fault,) = read(tmp_path, entries=ENTRY).faults
    assert (fault.row, fault.column) == (5, "Pose")


def test_dates_are_seconds(tmp_path):
    start = datetime.datetime(2026, 3, 1, 12, 0, 0)
    rows = [["pose", "when"], *([n, start + datetime.timedelta(seconds=90 * n)] for n in range(3))]
    book(tmp_path, {"Data": rows})
    found = read(tmp_path, "configurations", {"path": "book.xlsx", "columns": {"time_s": "when"}})
    assert found.faults == ()
    assert [time - found.columns["time_s"][0] for time in found.columns["time_s"]] == [0.0, 90.0, 180.0]


def test_lengths_that_a_sheet_took_for_dates_are_faults(tmp_path):
    rows = [["pose", "x"], *([n, datetime.datetime(2026, 5, n + 1)] for n in range(3))]
    book(tmp_path, {"Data": rows})
    entry = {"path": "book.xlsx", "columns": {"x_mm": "x", "y_mm": "x", "z_mm": "x"}}
    entry["constants"] = {"body": "A", "target": "T"}
    faults = read(tmp_path, "points", entry).faults
    assert {fault.column for fault in faults} == {"x"}


def test_numbers_typed_as_text_with_a_decimal_comma(tmp_path):
    rows = changed(0, 2, "1,5")
    book(tmp_path, {"Data": rows})
    (fault,) = read(tmp_path, entries=ENTRY).faults
    assert 'decimal = ","' in fault.expected
    found = read(tmp_path, entries={**ENTRY, "decimal": ","})
    assert found.faults == ()
    assert found.columns["x_mm"] == [1.5, 4.0, 7.125]


@pytest.mark.parametrize("damage", ["cut", "no archive", "other archive", "bomb", "a row far away", "entities"])
def test_a_damaged_workbook_is_one_fault(tmp_path, damage):
    path = tmp_path / "book.xlsx"
    book(tmp_path, {"Data": [HEADER, *ROWS]})
    good = path.read_bytes()
    if damage == "cut":
        path.write_bytes(good[: len(good) // 2])
    elif damage == "no archive":
        path.write_bytes(b"pose,x\n1,2\n")
    elif damage == "other archive":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("points.csv", "pose,x\n")
    else:
        part = "xl/worksheets/sheet1.xml"
        sheet = zipfile.ZipFile(path).read(part).decode()
        many = {
            "bomb": sheet.replace("</worksheet>", " " * (80 << 20) + "</worksheet>"),
            "a row far away": sheet.replace('r="4"', 'r="99999999"'),
            "entities": f"<!DOCTYPE a [{ENTITIES}]>{sheet.split('?>')[-1].replace('</worksheet>', '&k;</worksheet>')}",
        }[damage]
        with zipfile.ZipFile(path) as old:
            parts = {name: old.read(name) for name in old.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in {**parts, part: many.encode()}.items():
                archive.writestr(name, content)
    faults = read(tmp_path, entries=ENTRY).faults
    assert len(faults) == 1, faults
    assert faults[0].file.startswith("book.xlsx")
