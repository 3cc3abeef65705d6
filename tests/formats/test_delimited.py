"""Delimited text of every dialect gives the same table, and every fault names its line."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import zipfile

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.formats.text import Lines, OpenQuotation, line_numbers, record_blocks, split_lines, utf8_chunks
from truing.schemas.mapping import FileMapping

ROWS = [(1, "B01", 1234.5, -0.25, 12.0), (1, "P°2", -1.0, 2.0, 1e-3), (2, "B01", 1234567.125, 0.0, -7.5)]
NAMES = ("Messung", "Zielmarke", "X-Achse", "y", "z")
COLUMNS = {"pose": "Messung", "target": "Zielmarke", "x_mm": "X-Achse", "y_mm": "y", "z_mm": "z"}


def number(value: float, decimal: str, mark: str) -> str:
    return f"{value:,.4f}".translate(str.maketrans({",": mark, ".": decimal}))


def dialect(separator, decimal, mark, end, header, comment, blank_lines):
    glue = {"whitespace": "  \t "}.get(separator, separator)
    lines = [glue.join(NAMES)] if header else []
    for pose, target, *xyz in ROWS:
        lines += [f"{comment} a remark"] if comment else []
        lines.append(glue.join([str(pose), target, *(number(v, decimal, mark) for v in xyz)]))
        lines += ["", "   "] if blank_lines else []
    return end.join(lines) + end


@given(
    st.sampled_from([",", ";", "\t", "|", "whitespace"]),
    st.sampled_from([(".", None), (",", None), (".", ","), (",", "."), (".", "'"), (",", " ")]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.booleans(),
    st.sampled_from([None, "#", "//"]),
    st.booleans(),
    st.sampled_from(["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16", "utf-16-le"]),
    st.booleans(),
)
def test_every_dialect_gives_the_same_points(
    tmp_path_factory, separator, notation, end, header, comment, blank_lines, encoding, found_out
):
    decimal, thousands = notation
    clash = separator in (decimal, thousands) or (separator == "whitespace" and thousands == " ")
    if clash:
        separator = "|"
    folder = tmp_path_factory.mktemp("dialect")
    text = dialect(separator, decimal, thousands or "", end, header, comment, blank_lines)
    written(folder, "points.txt", text, encoding)
    entry = {
        "path": "points.txt",
        "decimal": decimal,
        "encoding": "utf-8" if encoding.startswith("utf-8") else encoding,
        "header": header,
        "columns": COLUMNS if header else dict(zip(COLUMNS, range(1, 6), strict=True)),
        "constants": {"body": "base"},
        **({"thousands": thousands} if thousands else {}),
        **({"comment": comment} if comment else {}),
        **({} if found_out and thousands != " " else {"separator": separator}),
    }
    found = read(folder, entries=entry)
    assert found.faults == ()
    assert found.columns["pose"] == [row[0] for row in ROWS]
    assert found.columns["target"] == [row[1] for row in ROWS]
    for name, place in (("x_mm", 2), ("y_mm", 3), ("z_mm", 4)):
        assert_close(found.columns[name], [row[place] for row in ROWS], atol=0.0, what=name)


def compressed(kind: str, content: bytes) -> bytes:
    if kind == "zip":
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("inner.csv", content)
        return buffer.getvalue()
    return {"gz": gzip.compress, "bz2": bz2.compress, "xz": lzma.compress}[kind](content)


POINTS = "pose,body,target,x_mm,y_mm,z_mm\n1,base,B1,1,2,3\n2,base,B1,4,5,6\n"


@pytest.mark.parametrize("kind", ["gz", "bz2", "xz", "zip"])
def test_compressed_files_are_read_as_they_are(tmp_path, kind):
    (tmp_path / f"points.csv.{kind}").write_bytes(compressed(kind, POINTS.encode()))
    found = read(tmp_path, entries={"path": f"points.csv.{kind}"})
    assert found.faults == ()
    assert found.columns["x_mm"] == [1.0, 4.0]


@pytest.mark.parametrize("kind", ["gz", "bz2", "xz", "zip"])
def test_a_truncated_file_is_a_fault_not_a_shorter_table(tmp_path, kind):
    content = compressed(kind, (POINTS + "3,base,B1,7,8,9\n" * 2000).encode())
    (tmp_path / f"p.csv.{kind}").write_bytes(content[: len(content) // 2])
    (fault,) = read(tmp_path, entries={"path": f"p.csv.{kind}"}).faults
    assert fault.file == f"p.csv.{kind}"
    assert "undamaged compressed file" in fault.expected


def test_an_archive_of_two_files_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "p.zip", "w") as archive:
        archive.writestr("a.csv", POINTS)
        archive.writestr("b.csv", POINTS)
    (fault,) = read(tmp_path, entries={"path": "p.zip"}).faults
    assert fault.value == "2 files"
    assert_says(fault.expected, "archive", "single file")


@given(st.binary(max_size=120), st.integers(1, 9))
def test_blocks_lose_nothing_and_end_with_records(content, size):
    content = bytes(b'\n",ab'[byte % 6 : byte % 6 + 1][0] for byte in content if byte % 6 < 5)
    stream = io.BytesIO(content)
    try:
        blocks = list(record_blocks(iter(lambda: stream.read(size), b""), b'"'))
    except OpenQuotation:
        assert content.count(b'"') % 2 == 1
        return
    assert b"".join(blocks) == content
    for block in blocks[:-1]:
        assert block.endswith(b"\n")
        assert block.count(b'"') % 2 == 0


LINES = st.sampled_from(["1,a", "2,b", '3,"a\nb"', "# no", "", "  ", ",,", "skip me", "4,c"])


@given(st.lists(LINES, max_size=30), st.booleans(), st.integers(0, 2))
def test_the_line_of_every_record(lines, has_header, skipped):
    head = ["preamble"] * skipped + (["# about", "name,what"] if has_header else [])
    text = "\n".join([*head, *lines]) + "\n"
    expected, line = [], len(head) + 1
    for content in lines:
        if content[:1].isdigit():
            expected.append(line)
        line += content.count("\n") + 1
    entry = FileMapping(path="x", comment="#", skip_lines=skipped, keep_lines=r"^\d")
    rules = Lines.of(entry, ",")
    found = line_numbers(io.BytesIO(text.encode()), entry, rules, has_header, range(len(expected)))
    assert found == expected


def test_utf16_is_decoded_across_chunks():
    text = "größer\nals µ\n" * 50
    chunks = utf8_chunks(io.BytesIO(text.encode("utf-16")), "utf-8", size=7)
    assert b"".join(chunks).decode() == text


def test_lines_that_quotation_marks_join_stay_together():
    assert split_lines(b'1,"a\nb"\n2,c\n', b'"') == [b'1,"a\nb"\n', b"2,c\n"]


@pytest.mark.parametrize(
    ("text", "entry", "row", "column", "value", "expected"),
    [
        ("pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,2,3\n1,b,U,1,oops,3\n", {}, 3, "y_mm", "oops", "a number"),
        ("pose;body;target;x_mm;y_mm;z_mm\n1;b;T;1,5;2;3\n", {}, 2, "x_mm", "1,5", 'set decimal = ","'),
        ("pose,body,target,x_mm,y_mm,z_mm\n\n\n1,b,T,1,inf,3\n", {}, 4, "y_mm", "inf", "a finite number"),
        ("pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,,3\n", {}, 2, "y_mm", "", "a number; an empty cell"),
        ("pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,nan,3\n", {}, 2, "y_mm", "nan", "a finite number"),
        (
            "pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,2,3\n1,b,U,1,2\n",
            {},
            3,
            None,
            "5 columns",
            "6 columns in every row",
        ),
        ("pose,body,target,x_mm,y_mm,z_mm\n,b,T,1,2,3\n", {}, 2, "pose", "", "a pose in every row"),
        ("pose,body,target,x_mm,y_mm,z_mm\n1,,T,1,2,3\n", {}, 2, "body", "", "a body in every row"),
        ("pose,body,target,x_mm,y_mm,z_mm,sigma_x_mm\n1,b,T,1,2,3,-1\n", {}, 2, "sigma_x_mm", "-1.0", "at least 0 mm"),
        ("# c\npose,body,target,x_mm,y_mm,z_mm\n# c\n1,b,T,1,x,3\n", {"comment": "#"}, 4, "y_mm", "x", "a number"),
    ],
)
def test_faults_name_file_row_column_value_and_expectation(tmp_path, text, entry, row, column, value, expected):
    written(tmp_path, "points.csv", text)
    (fault,) = read(tmp_path, entries={"path": "points.csv", **entry}).faults
    assert (fault.file, fault.row, fault.column, fault.value) == ("points.csv", row, column, value)
    assert expected in fault.expected


@pytest.mark.parametrize(
    ("content", "entry", "expected"),
    [
        (b"", {}, "at least one record"),
        (b"pose,body,target,x_mm,y_mm,z_mm\n", {}, "below the header"),
        (b"pose,body,target,x_mm,y_mm,z_mm\n1,b,K\xf6ln,1,2,3\n", {}, 'encoding = "cp1252"'),
        (b'pose,body,target,x_mm,y_mm,z_mm\n1,b,"T,1,2,3\n', {}, "a closing quotation mark"),
        (b"pose,body,target,x_mm,y_mm\n1,b,T,1,2\n", {}, "a column z_mm"),
        (b"pose,body,target,x_mm,y_mm,z_m\n1,b,T,1,2,3\n", {}, "did you mean"),
        (b"pose,body,target,x,y,z\n1,b,T,1,2,3\n", {"columns": {"x_mm": "x", "y_mm": "y", "z_mm": 9}}, "at least 9"),
    ],
)
def test_files_that_cannot_be_read_at_all(tmp_path, content, entry, expected):
    (tmp_path / "points.csv").write_bytes(content)
    faults = read(tmp_path, entries={"path": "points.csv", **entry}).faults
    assert any(expected in fault.expected for fault in faults), faults


def test_many_faults_of_a_kind_are_capped_with_their_count(tmp_path):
    rows = "".join(f"{i},b,T,1,bad{i},3\n" for i in range(50))
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm\n" + rows)
    faults = read(tmp_path).faults
    assert [fault.row for fault in faults] == [2, 3, 4]
    assert faults[-1].more == 47
    assert len(faults) + faults[-1].more == 50


def test_a_fault_late_in_a_large_file_has_its_line(tmp_path):
    rows = "".join(f"{i},base,B{i % 7},{i}.5,2,3\n" for i in range(400_000))
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm\n" + rows + "9,base,B1,1,two,3\n")
    (fault,) = read(tmp_path).faults
    assert (fault.row, fault.value) == (400_002, "two")


def test_quoted_cells_and_marks_without_meaning(tmp_path):
    written(tmp_path, "q.csv", 'pose,body,target,x_mm,y_mm,z_mm\n1,base,"a, b","1.5",2,3\n')
    assert read(tmp_path, entries={"path": "q.csv"}).columns["target"] == ["a, b"]
    written(tmp_path, "i.csv", 'pose,body,target,x_mm,y_mm,z_mm\n1,base,5" ball,1.5,2,3\n')
    assert read(tmp_path, entries={"path": "i.csv", "quote": ""}).columns["target"] == ['5" ball']


def test_rows_of_separators_alone_are_blank_as_spreadsheets_leave_them(tmp_path):
    written(tmp_path, "s.csv", "pose;body;target;x_mm;y_mm;z_mm\n1;b;T;1;2;3\n;;;;;\n;;;;;\n")
    found = read(tmp_path, entries={"path": "s.csv"})
    assert found.faults == ()
    assert len(found.rows) == 1
