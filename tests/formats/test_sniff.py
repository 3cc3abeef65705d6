"""The proposal for a raw file reads that file without a fault, with the numbers that were written."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.formats.reading import read, written
from tests.tolerance import assert_close
from truing.formats.named_bench import positions_side_by_side
from truing.formats.sniff import sniff_file

ROWS = [(1, "P1", 1234.5, -0.25, 12.0), (1, "P2", -1.0, 2.0, 0.001), (2, "P1", 2345.625, 0.0, -7.5)]
HEADERS = {
    "en": ("pose", "body", "target", "x_mm", "y_mm", "z_mm"),
    "de": ("Messung", "Körper", "Punktnummer", "X [mm]", "Y [mm]", "Z [mm]"),
    "fr": ("Frame", "body", "cible", "x", "y", "z"),
}


def text(separator, decimal, thousands, end, names):
    lines = [separator.join(names)]
    for pose, target, *xyz in ROWS:
        numbers = [f"{v:,.4f}".translate(str.maketrans({",": thousands, ".": decimal})) for v in xyz]
        lines.append(separator.join([str(pose), "plate", target, *numbers]))
    return end.join(lines) + end


@given(
    st.sampled_from([",", ";", "\t", "|"]),
    st.sampled_from([(".", ""), (",", ""), (".", ","), (",", "."), (".", "'"), (",", " ")]),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16"]),
    st.sampled_from(sorted(HEADERS)),
    st.integers(0, 2),
)
def test_a_proposed_mapping_reads_its_file(tmp_path_factory, separator, notation, end, encoding, language, preamble):
    decimal, thousands = notation
    if separator in notation:
        separator = ";"
    folder = tmp_path_factory.mktemp("sniff")
    content = f"a report of some laboratory{end}" * preamble
    content += text(separator, decimal, thousands, end, HEADERS[language])
    path = written(folder, "export.csv", content, encoding)
    guess = sniff_file(path)
    assert guess.table == "points"
    found = read(folder, entries={"path": "export.csv", **guess.mapping})
    assert found.faults == ()
    assert found.columns["target"] == [row[1] for row in ROWS]
    for name, place in (("x_mm", 2), ("y_mm", 3), ("z_mm", 4)):
        assert_close(found.columns[name], [row[place] for row in ROWS], atol=0.0, what=name)


def test_units_in_headers_become_units_of_the_mapping(tmp_path):
    path = written(tmp_path, "e.csv", "pose;target;X [m];Y [m];Z [m]\n1;P;1,5;2,5;0,25\n")
    guess = sniff_file(path)
    found = read(tmp_path, entries={"path": "e.csv", **guess.mapping, "constants": {"body": "b"}})
    assert found.columns["x_mm"] == [1500.0]


def test_the_contracts_own_files_need_no_mapping(tmp_path):
    path = written(tmp_path, "configurations.csv", "pose,role,time_s,rho1_mm\n1,calibration,0,10\n")
    guess = sniff_file(path)
    assert (guess.table, guess.mapping, guess.notes) == ("configurations", {}, ())


@pytest.mark.parametrize(
    ("content", "file_format"),
    [
        ("CODE1,-1353.2,2028.7,488.3,0.04,0.02,0.02,0\r\nT2,1,2,3,4,5,6,0\r\n", "vstars"),
        (
            "Enabled\tFeature\tID\tx\ty\tz\nChecked\tA\t1\t6,997.3\t-1,2\t3\nChecked\tA\t2\t6,997.3\t-1.2\t3\n",
            "tracker",
        ),
    ],
)
def test_exports_of_instruments_are_recognised(tmp_path, content, file_format):
    guess = sniff_file(written(tmp_path, "e.txt", content.replace("-1,2", "-1.2")))
    assert guess.mapping["format"] == file_format
    assert guess.notes


def test_coordinates_without_header_by_position_and_compressed(tmp_path):
    (tmp_path / "s.txt.gz").write_bytes(gzip.compress(b"# made today\n  P1 1.5 2.5 3.5\n  P2 4 5 6\n" * 400))
    guess = sniff_file(tmp_path / "s.txt.gz")
    assert guess.mapping["comment"] == "#"
    assert guess.mapping["columns"] == {"target": 1, "x_mm": 2, "y_mm": 3, "z_mm": 4}


@pytest.mark.parametrize("content", [b"", b"\n\n", b"\x00\x01\x02" * 50, b"just a sentence\n", b"\xff\xfe", b"PAR1 no"])
@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.csv.gz", "a.txt"])
def test_a_file_without_a_table_is_named_and_raises_nothing(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    guess = sniff_file(tmp_path / name)
    assert guess.table is None
    assert guess.notes


@given(st.binary(max_size=200))
def test_no_content_makes_it_raise(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("any") / "a.txt"
    path.write_bytes(content)
    sniff_file(path)


def test_a_truncated_archive_is_reported(tmp_path):
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"a,b\n1,2\n" * 9000)[:60])
    assert "cannot be read" in sniff_file(tmp_path / "a.csv.gz").notes[0]


@pytest.mark.parametrize("name", ["_" * 20_000 + "!", "x" + "_ " * 9000 + "!", "1'" * 20_000, "known_f" * 5000])
def test_names_without_end_are_no_columns(tmp_path, name):
    """To try every way to cut a name of thousands of marks takes too long, so such names are no columns."""
    guess = sniff_file(written(tmp_path, "a.csv", f"{name},y,z\n" + "1,2,3\n" * 20))
    assert guess.mapping.get("columns", {}) == {}


@pytest.mark.parametrize(
    ("heads", "wide", "directions"),
    [
        (("Run 1 Forward (um)", "Run 1 Reverse (um)"), "Run {cycle} {direction} (um)", {"Forward", "Reverse"}),
        (("Lauf1+", "Lauf1-"), "Lauf{cycle}{direction}", {r"\+", r"\-"}),
        (("1_up", "1_down"), "{cycle}_{direction}", {"up", "down"}),
        (("1 (+)", "1 (-)"), "{cycle} ({direction})", {r"\+", r"\-"}),
        (("Ist (hin).Lauf 1", "Ist (zurück).Lauf 1"), "Ist ({direction}).Lauf {cycle}", {"hin", "zurück"}),
    ],
)
@pytest.mark.parametrize(("scale", "kind"), [(1e-3, "deviation_um"), (1.0, "position_mm")])
def test_runs_of_an_axis_side_by_side_are_recognised(heads, wide, directions, scale, kind):
    """Numbers that go along with the targets are positions."""
    if "(um)" in heads[0] and kind == "position_mm":
        scale = 1e3
    target = np.array([0.0, 50.0, 100.0])
    found = positions_side_by_side(("Target (mm)", *heads), np.column_stack([target, scale * target, scale * target]))
    assert found is not None
    assert (found.table, found.mapping["wide"], found.mapping["wide_values"]) == ("positioning", wide, kind)
    assert set(found.mapping["rename"]["direction"]) == directions


@pytest.mark.parametrize("heads", [("Run 1 Forward", "Comment"), ("Channel 1 x", "Channel 1 y"), ("Run 1 Forward",)])
def test_other_columns_next_to_a_target_are_no_runs(heads):
    assert positions_side_by_side(("Target (mm)", *heads), np.zeros((3, 1 + len(heads)))) is None


def test_a_column_name_next_to_coordinates_names_the_targets(tmp_path):
    (tmp_path / "points.txt").write_text("Id,Name,X (mm),Y (mm),Z (mm)\n1,B1,0.1,0.2,0.3\n2,B2,500,0.1,0.2\n")
    guess = sniff_file(tmp_path / "points.txt")
    assert guess.mapping["columns"] == {"target": "Name", "x_mm": "X (mm)", "y_mm": "Y (mm)", "z_mm": "Z (mm)"}


def test_names_of_two_words_above_aligned_columns_are_names(tmp_path):
    """Two blanks part the columns, one blank the words of a name: no name is said to lack."""
    rows = "".join(f"{k:10.3f}{k * k % 7:10.3f}{k + 0.5:10.3f}{3 * k % 5:10.3f}\n" for k in range(1, 20))
    file = tmp_path / "D12.txt"
    file.write_text(f"Plate: 12\nDate: 2003-10-17\n\n    Meas X    Meas Y     Nom D     Round\n{rows}")
    guess = sniff_file(file)
    assert guess.columns == ("Meas X", "Meas Y", "Nom D", "Round")


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        ("# Id, name, X, Y, Z", {"x_mm": "X", "y_mm": "Y", "z_mm": "Z"}),
        ("# Id, name, X, Y, Z, sigmaX, sigmaY, sigmaZ", {"target": 1, "x_mm": 3, "y_mm": 4, "z_mm": 5}),
    ],
)
def test_an_empty_column_of_names_names_no_targets(tmp_path, heading, columns):
    """Control points as a bundle program writes them: number, name, coordinates, and no name was given."""
    rows = "".join(f"{k},  , {150 + k / 7:.3f}, {154.08 + k / 9:.3f}, {149.0 - k / 5:.3f}\n" for k in range(1, 12))
    (tmp_path / "ctrl.txt").write_text(f"{heading}\n{rows}")
    assert sniff_file(tmp_path / "ctrl.txt").mapping["columns"] == columns
