"""Clouds and markers whose damage would end the process that their library reads them in: refused, and nothing said."""

from __future__ import annotations

import subprocess

import pytest

from schemas.campaign import read_campaign
from tests.formats.reading import SHAPES, read
from tests.formats.test_other_formats import write_c3d
from truing.formats.cloud_heads import check_cloud_head
from truing.formats.faultlog import FaultLog
from truing.formats.raw import Unusable
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles

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


@pytest.mark.parametrize(
    ("suffix", "head"),
    [
        ("ply", ply(more="property end_header\n")),
        ("ply", ply(more="")),
        ("ply", ply(more=XYZ.replace("float z", "floot z"))),
        ("ply", ply(count="-3")),
        ("ply", ply(count="9" * 30)),
        ("ply", ply(count=100)),
        ("ply", ply().replace("element vertex 20\n", "")),
        ("pcd", pcd(count="0")),
        ("pcd", pcd(field=" i")),
        ("pcd", pcd(field=" i", size=" 3", kind=" F", count="1 1")),
        ("pcd", pcd(width=21)),
        ("pcd", pcd(width="9" * 15, points="9" * 15)),
        ("pcd", pcd().replace("WIDTH 20\n", "")),
    ],
)
def test_a_head_that_contradicts_itself_or_the_files_size(tmp_path, suffix, head):
    with pytest.raises(Unusable, match="a whole"):
        check_cloud_head(clouds(tmp_path, suffix, head.encode() + bytes(240)))


@pytest.mark.parametrize(
    ("suffix", "head"),
    [
        ("ply", ply()),
        ("ply", ply(more="comment by hand\n" + XYZ + "element face 2\nproperty list uchar int vertex_indices\n")),
        ("pcd", pcd()),
        ("pcd", pcd(field=" _", size=" 1", kind=" U", count="1 4", data="binary")),
        ("pcd", pcd().replace("POINTS 20\n", "")),
    ],
)
def test_heads_that_are_as_they_are_written(tmp_path, suffix, head):
    check_cloud_head(clouds(tmp_path, suffix, head.encode() + bytes(260)))


def test_markers_that_end_the_process_of_their_library(tmp_path, monkeypatch):
    """Such a file is not made by hand; what stands here is how the process ended."""
    write_c3d(tmp_path / "take.c3d")
    entry = {"path": "take.c3d", "constants": {"body": "b"}}
    assert len(read(tmp_path, entries=entry).records) == 11
    ended = subprocess.CompletedProcess([], -11)
    monkeypatch.setattr("truing.formats.c3d_file.subprocess.run", lambda *_, **__: ended)
    (fault,) = read(tmp_path, entries=entry).faults
    assert (fault.file, fault.expected) == ("take.c3d", "a whole C3D file; this one is damaged")


def test_rows_that_cannot_be_found_again_are_told_without_their_line(tmp_path):
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
    monkeypatch.setattr("truing.formats.c3d_file.SECONDS", 1.0)
    (fault,) = read(tmp_path, entries=MARKERS).faults
    assert fault.expected == "a whole C3D file; this one is damaged: it was not read after 1 s"


def test_a_header_of_other_frames_than_the_file_holds(tmp_path):
    write_c3d(tmp_path / "take.c3d")
    content = bytearray((tmp_path / "take.c3d").read_bytes())
    content[8:10] = b"\3\0"
    (tmp_path / "take.c3d").write_bytes(content + bytes(512))
    (fault,) = read(tmp_path, entries=MARKERS).faults
    assert fault.expected.startswith("a whole C3D file; its header announces 3 frames, 4 could be read")
