"""Damaged clouds and markers that would crash their library are refused without its output."""

from __future__ import annotations

import struct
import subprocess

import pytest

from tests.formats.reading import SHAPES, read
from tests.formats.test_other_formats import write_c3d
from tests.sentences import assert_says
from truing.formats.cloud_files import lzf_decompressed
from truing.formats.faultlog import FaultLog
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign

PLY = "ply\nformat {form} 1.0\nelement vertex {count}\n{more}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = (
    "VERSION 0.7\nFIELDS x y z{field}\nSIZE 4 4 4{size}\nTYPE F F F{kind}\nCOUNT 1 1 {count}\nWIDTH {width}\nHEIGHT 1\n"
)


def ply(form="binary_little_endian", count=20, more=XYZ):
    return PLY.format(form=form, count=count, more=more)


def pcd(count="1", width=20, field="", size="", kind="", points=20, data="ascii"):
    head = PCD.format(count=count, width=width, field=field, size=size, kind=kind)
    return f"{head}POINTS {points}\nDATA {data}\n"


def clouds(tmp_path, suffix, content):
    (tmp_path / f"p.{suffix}").write_bytes(content)
    return tmp_path / f"p.{suffix}"


CLOUD = {"path": "p.*", "constants": {"pose": 1, "body": "b"}}


def refused(tmp_path, suffix, content):
    """The only fault of a cloud, of which no point is read."""
    clouds(tmp_path, suffix, content)
    found = read(tmp_path, entries=CLOUD)
    (fault,) = found.faults
    assert fault.file == f"p.{suffix}"
    return fault


@pytest.mark.parametrize(
    ("suffix", "head"),
    [
        ("ply", ply(more="property end_header\n")),
        ("ply", ply(more="")),
        ("ply", ply(more=XYZ.replace("float z", "floot z"))),
        ("ply", ply(more=XYZ + "property float x\n")),
        ("ply", ply(more=XYZ + "property list uchar float w\n")),
        ("ply", ply(count="-3")),
        ("ply", ply(count="9" * 30)),
        ("ply", ply(count=100)),
        ("ply", ply(form="ascii 1.0\nformat binary_big_endian")),
        ("ply", ply().replace("element vertex 20\n", "")),
        ("ply", ply(count=0)),
        ("pcd", pcd(count="0")),
        ("pcd", pcd(field=" i")),
        ("pcd", pcd(field=" i", size=" 3", kind=" F", count="1 1")),
        ("pcd", pcd(field=" x", size=" 4", kind=" F", count="1 1")),
        ("pcd", pcd(width=21)),
        ("pcd", pcd(width=0, points=0)),
        ("pcd", pcd(width="9" * 15, points="9" * 15, data="binary")),
        ("pcd", pcd(data="packed")),
        ("pcd", pcd().replace("WIDTH 20\n", "")),
        ("pcd", pcd().replace("POINTS 20\n", "SIZE 4 4 4\n")),
    ],
)
def test_a_head_that_contradicts_itself_or_the_files_size(tmp_path, suffix, head):
    expected = refused(tmp_path, suffix, head.encode() + bytes(240)).expected
    assert "an undamaged" in expected or "single numbers" in expected


ROWS = [(i, i + 0.5, 2 * i) for i in range(1, 21)]
TEXT = "".join("{} {} {}\n".format(*row) for row in ROWS)
FACE = "element face 2\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        ("ply", ply(form="ascii") + TEXT),
        ("ply", (ply(form="ascii") + TEXT).replace("\n", "\r\n")),
        ("ply", ply(form="ascii", more="comment by hand\n" + XYZ + FACE) + TEXT + "3 0 1 2\n4 0 1 2 3\n"),
        ("ply", ply(form="ascii").replace("element vertex", FACE + "element vertex") + "3 0 1 2\n3 0 1 2\n" + TEXT),
        ("pcd", pcd() + TEXT),
        ("pcd", pcd().replace("POINTS 20\n", "") + TEXT),
        ("pcd", pcd(field=" _ _", size=" 1 2", kind=" U U", count="1 2 1") + TEXT.replace("\n", " 7 7 7\n")),
    ],
)
def test_clouds_of_text_as_they_are_written(tmp_path, suffix, content):
    clouds(tmp_path, suffix, content.encode())
    found = read(tmp_path, entries=CLOUD)
    assert found.faults == ()
    assert list(zip(*(found.columns[f"{axis}_mm"] for axis in "xyz"), strict=True)) == ROWS


@pytest.mark.parametrize("order", ["little", "big"])
def test_binary_vertices_next_to_faces(tmp_path, order):
    mark = "<" if order == "little" else ">"
    points = b"".join(struct.pack(f"{mark}fff", *row) for row in ROWS)
    three, four = struct.pack(f"{mark}B3i", 3, 0, 1, 2), struct.pack(f"{mark}B4i", 4, 0, 1, 2, 3)
    for faces in (three + three, three + four):
        head = ply(form=f"binary_{order}_endian", more=XYZ + FACE).encode()
        clouds(tmp_path, "ply", head + points + faces)
        found = read(tmp_path, entries=CLOUD)
        assert found.faults == ()
        assert list(zip(*(found.columns[f"{axis}_mm"] for axis in "xyz"), strict=True)) == ROWS
        assert_says(refused(tmp_path, "ply", head + points + faces[:-1]).expected, "header announces")
        assert_says(refused(tmp_path, "ply", head + points + faces + b"\1").expected, "ends", "header says")
        for count in (19, 21):  # the last of 21 would be made of faces
            other = head.replace(b"vertex 20", b"vertex %d" % count)
            assert_says(refused(tmp_path, "ply", other + points + faces).expected, "undamaged PLY file")


@pytest.mark.parametrize(
    ("suffix", "content", "value", "expected"),
    [
        ("ply", ply(form="ascii", count=25) + TEXT, "20 points", "25 points, as the header announces"),
        ("ply", ply(form="ascii", count=18) + TEXT, "2 more", "0 lines after the points"),
        ("ply", ply(form="ascii", count=21, more=XYZ + FACE) + TEXT + "3 0 1 2\n" * 2, "4 columns", "3 columns in"),
        ("ply", ply(form="ascii", count=18, more=XYZ + FACE) + TEXT + "3 0 1 2\n" * 2, "19 19.5 38", "a line of face"),
        ("ply", ply(form="ascii", count=18, more=XYZ + FACE) + TEXT, "19 19.5 38", "a line of face"),
        ("ply", ply(form="ascii", more=XYZ + FACE) + TEXT + "2 0 1\n1 20\n", "1 20", "a line of face"),
        ("ply", ply(form="ascii", more=XYZ[17:]) + TEXT, "3 numbers", "2 numbers in every row"),
        ("pcd", pcd(width=25, points=25) + TEXT, "20 points", "25 points, as the header announces"),
        ("pcd", pcd(width=18, points=18) + TEXT, "2 more", "0 lines after the points"),
    ],
)
def test_other_rows_than_the_head_announces(tmp_path, suffix, content, value, expected):
    clouds(tmp_path, suffix, content.encode())
    fault = read(tmp_path, entries=CLOUD).faults[-1]
    assert fault.value == value
    assert expected in fault.expected


def test_vertices_without_x_are_no_points(tmp_path):
    content = ply(form="ascii", more=XYZ[17:]) + "".join(line.split(" ", 1)[1] + "\n" for line in TEXT.splitlines())
    fault = refused(tmp_path, "ply", content.encode())
    assert fault.column == "x_mm"
    assert_says(fault.expected, "column x", "x_mm", "y, z")


@pytest.mark.parametrize(("suffix", "head", "row"), [("ply", ply(form="ascii"), 10), ("pcd", pcd(), 12)])
def test_cells_that_are_no_numbers_have_their_line(tmp_path, suffix, head, row):
    """Decimal commas were zeros, a row too short moved all that followed, and words were zeros too."""
    for spoilt, value, expected in (
        ("3 3,5 6", "3,5", 'set decimal = ","'),
        ("3 x 6", "x", "a number"),
        ("3 nan 6", "nan", "a finite number"),
        ("3 3.5", "2 columns", "3 columns in every row"),
    ):
        fault = refused(tmp_path, suffix, (head + TEXT.replace("3 3.5 6", spoilt, 1)).encode())
        assert (fault.row, fault.value) == (row, value)
        assert expected in fault.expected
    clouds(tmp_path, suffix, (head + TEXT.replace(".", ",")).encode())
    found = read(tmp_path, entries={**CLOUD, "decimal": ","})
    assert (found.faults, found.columns["y_mm"][2]) == ((), 3.5)


@pytest.mark.parametrize("spoilt", ["short", "long", "other count", "damaged"])
def test_compressed_points(tmp_path, spoilt):
    fields = b"".join(struct.pack("<20f", *column) for column in zip(*ROWS, strict=True))
    packed = b"".join(bytes([len(part) - 1]) + part for part in (fields[i : i + 32] for i in range(0, 240, 32)))
    head = pcd(data="binary_compressed").encode()
    clouds(tmp_path, "pcd", head + struct.pack("<2I", len(packed), 240) + packed)
    found = read(tmp_path, entries=CLOUD)
    assert found.faults == ()
    assert list(zip(*(found.columns[f"{axis}_mm"] for axis in "xyz"), strict=True)) == ROWS
    content = {
        "short": head + struct.pack("<2I", len(packed), 240) + packed[:-1],
        "long": head + struct.pack("<2I", len(packed), 240) + packed + b"\1",
        "other count": head + struct.pack("<2I", len(packed), 228) + packed,
        "damaged": head + struct.pack("<2I", len(packed), 240) + b"\xff" + packed[1:],
    }
    assert_says(refused(tmp_path, "pcd", content[spoilt]).expected, "undamaged PCD file")


def test_lzf_repeats_what_it_has_just_made():
    assert lzf_decompressed(b"\0a\xe0\xff\0", 265) == b"a" * 265
    assert lzf_decompressed(b"\2abc\x20\2", 6) == b"abcabc"
    assert lzf_decompressed(b"\2abc\x20\2", 5) is None
    assert lzf_decompressed(b"\x20\0", 3) is None
    assert lzf_decompressed(b"\2ab", 3) is None


def test_markers_that_end_the_process_of_their_library(tmp_path, monkeypatch):
    """Such a file cannot be made by hand: the test sets the exit of the process."""
    write_c3d(tmp_path / "take.c3d")
    entry = {"path": "take.c3d", "constants": {"body": "b"}}
    assert len(read(tmp_path, entries=entry).records) == 11
    ended = subprocess.CompletedProcess([], -11)
    monkeypatch.setattr("truing.formats.motion_capture.subprocess.run", lambda *_, **__: ended)
    (fault,) = read(tmp_path, entries=entry).faults
    assert fault.file == "take.c3d"
    assert_says(fault.expected, "undamaged C3D file", "damaged")


def test_rows_that_cannot_be_found_again_are_reported_without_their_line(tmp_path):
    """The file has changed meanwhile, or its quotation marks join its lines in another way."""
    rows = "\n".join(f"1,b,T{n},1,2,x" for n in range(3))
    (tmp_path / "points.csv").write_text(f"pose,body,target,x_mm,y_mm,z_mm\n{rows}\n")
    log = FaultLog()
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}})
    for _ in read_table(CampaignFiles(tmp_path, campaign), SHAPES["points"], log):
        pass
    (tmp_path / "points.csv").write_text("pose\n1\n")
    assert [(fault.row, fault.value) for fault in log.faults()] == [(2, "x"), (None, "x"), (None, "x")]
    (tmp_path / "points.csv").unlink()
    assert [fault.row for fault in log.faults()] == [None] * 3


MARKERS = {"path": "take.c3d", "constants": {"body": "b"}}


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (300, "begins with a header of 512 bytes"),
        (700, "its header announces"),
        (1600, "its header announces 1728 bytes"),
        (1727, "its header announces 1728 bytes"),
    ],
)
def test_markers_that_are_cut_short(tmp_path, length, expected):
    """Of the 1600 bytes ezc3d reads one frame of four, and of the 700 it never ends to read."""
    write_c3d(tmp_path / "take.c3d")
    (tmp_path / "take.c3d").write_bytes((tmp_path / "take.c3d").read_bytes()[:length])
    (fault,) = read(tmp_path, entries=MARKERS).faults
    assert fault.file == "take.c3d"
    assert expected in fault.expected


def test_markers_whose_reading_never_ends_are_given_up(tmp_path, monkeypatch):
    """The header says that there is nothing behind 700 bytes, so nothing is missing; ezc3d reads on and on."""
    write_c3d(tmp_path / "take.c3d")
    content = bytearray((tmp_path / "take.c3d").read_bytes()[:700])
    content[2:4], content[16:18], content[514] = bytes(2), b"\1\0", 0
    (tmp_path / "take.c3d").write_bytes(content)
    monkeypatch.setattr("truing.formats.motion_capture.SECONDS", 1.0)
    (fault,) = read(tmp_path, entries=MARKERS).faults
    assert_says(fault.expected, "undamaged C3D file", "damaged", "not read", "1 s")


def test_a_header_of_other_frames_than_the_file_holds(tmp_path):
    write_c3d(tmp_path / "take.c3d")
    content = bytearray((tmp_path / "take.c3d").read_bytes())
    content[8:10] = b"\3\0"
    (tmp_path / "take.c3d").write_bytes(content + bytes(512))
    (fault,) = read(tmp_path, entries=MARKERS).faults
    assert_says(fault.expected, "undamaged C3D file", "3 frames", "4 could")
