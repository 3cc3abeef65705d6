"""Photographs: listed files, header data, grey values, and faults."""

from __future__ import annotations

import os
import shutil
import struct
import zlib
from contextlib import suppress

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational, ImageFileDirectory_v2

from tests.sentences import assert_says, says
from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.image_files import read_grey, read_head
from truing.formats.photographs import list_photographs
from truing.formats.raw import Unusable
from truing.formats.source import CampaignFiles, has_photographs, raw_files
from truing.schemas.campaign import read_campaign

MODEL, ORIENTATION, EXIF, FOCAL, FOCAL_35, SERIAL = 0x110, 0x112, 0x8769, 0x920A, 0xA405, 0xA431
PLANE_X, PLANE_UNIT, WIDTH_TAKEN, TAKEN, SPLIT = 0xA20E, 0xA210, 0xA002, 0x9003, 0x9291
GREY = np.random.default_rng(1).integers(0, 255, (40, 60)).astype(np.uint8)


def saved(path, pixels=None, tags=None, exposure=None, **more):
    path.parent.mkdir(parents=True, exist_ok=True)
    if pixels is None:  # none is the copy of another
        pixels = np.roll(GREY, zlib.crc32(str(path).encode()) % GREY.size)
    if path.suffix == ".tif":
        more["tiffinfo"] = ImageFileDirectory_v2()
        more["tiffinfo"].update({**(tags or {}), **({EXIF: exposure} if exposure else {})})
    else:
        more["exif"] = Image.Exif()
        more["exif"].update(tags or {})
        more["exif"].get_ifd(EXIF).update(exposure or {})
    Image.fromarray(pixels).save(path, **more)
    return path


def listed(folder, log=None, sensor_width_mm=None, **entry):
    files = {"files": {"images": entry}} if entry else {}
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, **files})
    return list_photographs(CampaignFiles(folder, campaign), sensor_width_mm, FaultLog() if log is None else log)


def listed_photographs(folder, **entry):
    log = FaultLog()
    return [(one.image, one.pose, one.camera) for one in listed(folder, log, **entry).found], log.faults()


def test_poses_and_cameras_by_folder_or_name(tmp_path):
    for name in ("images/10_2.jpg", "images/9_1.png", "images/7/left/a.tif", "images/7/right/a.tif", "images/8/B.JPG"):
        saved(tmp_path / name)
    found, faults = listed_photographs(tmp_path)
    assert not faults
    assert sorted(found) == [
        ("10_2", "10", "camera"),
        ("7/left/a", "7", "left"),
        ("7/right/a", "7", "right"),
        ("8/B", "8", "camera"),
        ("9_1", "9", "camera"),
    ]


def test_poses_by_a_pattern_with_what_else_lies_there_counted(tmp_path):
    for name in ("raw/DSC_p07_c2_0013.jpg", "raw/DSC_p08_c2_0014.jpg"):
        saved(tmp_path / name)
    (tmp_path / "raw/DSC_p07_c2_0013.NEF").write_bytes(b"raw")
    entry = {"path": "raw/*", "from_name": r"_p(?P<pose>\d+)_c(?P<camera>\d)", "offset": {"pose": 100}}
    found, faults = listed_photographs(tmp_path, **entry)
    assert not faults
    assert found == [("raw/DSC_p07_c2_0013", "107", "2"), ("raw/DSC_p08_c2_0014", "108", "2")]
    assert listed(tmp_path, **entry).left_out == {("raw", "no photograph (.nef)"): 1}
    assert listed(tmp_path, **entry).poses_are_numbers


def test_a_folder_means_the_pictures_in_it(tmp_path):
    for name in ("photos/1/a.jpg", "photos/2_7.JPG", "photos/3/left/b.tif"):
        saved(tmp_path / name)
    (tmp_path / "photos/notes.txt").write_text("warm")
    found, faults = listed_photographs(tmp_path, path="photos")
    assert not faults
    assert sorted(pose for _, pose, _ in found) == ["1", "2", "3"]
    mapped = {"files": {"images": {"path": "photos/"}}}
    assert len(raw_files(tmp_path, mapped)) == 3
    (tmp_path / "none").mkdir()
    assert [fault.value for fault in listed_photographs(tmp_path, path="none")[1]] == ["none"]


def test_pictures_next_to_points_make_no_campaign_of_photographs(tmp_path):
    saved(tmp_path / "images/1/setup.jpg")
    assert has_photographs(tmp_path, {})
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n")
    assert not has_photographs(tmp_path, {})
    assert has_photographs(tmp_path, {"files": {"images": {"path": "images/*/*.jpg"}}})


@pytest.mark.parametrize(
    ("exposure", "sensor", "expected", "stated_by"),
    [
        ({}, None, None, None),
        ({FOCAL: IFDRational(50), FOCAL_35: 75}, None, 75 * np.hypot(60, 40) / np.hypot(36, 24), "35 mm film"),
        ({FOCAL: IFDRational(50), FOCAL_35: 75}, 24.0, 50 * 60 / 24.0, "sensor_width_mm"),
        # 60 px on 30 mm, of which the file holds all
        ({FOCAL: IFDRational(50), PLANE_X: IFDRational(20), PLANE_UNIT: 3}, None, 50 * 2.0, "focal plane"),
        # made half as large since: 120 px on 30 mm
        (
            {FOCAL: IFDRational(50), PLANE_X: IFDRational(40), PLANE_UNIT: 3, WIDTH_TAKEN: 120},
            *(None, 50 * 2.0, "focal plane"),
        ),
        # nonsense: a resolution that would make the sensor a kilometre wide, a focal length of zero
        ({FOCAL: IFDRational(50), PLANE_X: IFDRational(1, 1000), PLANE_UNIT: 3}, None, None, None),
        ({FOCAL: IFDRational(0, 0), FOCAL_35: 0}, 24.0, None, None),
    ],
)
@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_the_principal_distance_to_start_from(tmp_path, ending, exposure, sensor, expected, stated_by):
    head = read_head(saved(tmp_path / f"a.{ending}", tags={MODEL: "D850"}, exposure=exposure), sensor)
    assert (head.width_px, head.height_px, head.bits) == (60, 40, 8)
    if expected is None:
        assert head.principal_distance_px is head.principal_distance_from is None
    else:
        assert_close(head.principal_distance_px, expected, atol=1e-9)
        assert stated_by in head.principal_distance_from


def test_cameras_by_model_serial_number_focal_length_and_format(tmp_path):
    exposure = {SERIAL: "0042\0", FOCAL: IFDRational(35), TAKEN: "2026:11:22 10:11:12", SPLIT: "25"}
    saved(tmp_path / "images/1/a.jpg", tags={MODEL: "D850", ORIENTATION: 6}, exposure=exposure)
    saved(tmp_path / "images/1/b.jpg", tags={MODEL: "D850"}, exposure={**exposure, FOCAL: IFDRational(50)})
    saved(tmp_path / "images/1/c.jpg", GREY.T, tags={MODEL: "D850"}, exposure={**exposure, FOCAL: IFDRational(50)})
    saved(tmp_path / "images/1/d.jpg", tags={MODEL: "X2"})
    found = listed(tmp_path).found
    assert [one.camera for one in found] == [
        "D850 0042, 35 mm, 60 x 40",
        "D850 0042, 50 mm, 60 x 40",
        "D850 0042, 50 mm, 40 x 60",
        "X2",
    ]
    assert [one.head.turned for one in found] == ["on its side", "", "", ""]
    assert (found[0].head.width_px, found[0].head.taken_at) == (60, "2026-11-22T10:11:12.25")


def test_grey_values_as_they_stand(tmp_path):
    colour = np.random.default_rng(2).integers(0, 255, (40, 60, 3)).astype(np.uint8)
    luminance = colour @ [0.299, 0.587, 0.114]
    deep = GREY.astype(np.uint16) * 257
    cases = {"a.png": GREY, "b.tif": GREY, "c.png": deep, "d.tif": deep}
    for name, pixels in cases.items():
        path = saved(tmp_path / name, pixels)
        grey = read_grey(path, read_head(path))
        assert grey.dtype == pixels.dtype
        assert (grey == pixels).all()
    for name, scale in (("e.png", 1), ("f.tif", 1), ("g.png", 257), ("h.tif", 257)):
        path = str(tmp_path / name)
        cv2.imwrite(path, colour[..., ::-1] if scale == 1 else colour[..., ::-1].astype(np.uint16) * 257)
        path = tmp_path / name
        assert_close(read_grey(path, read_head(path)) / scale, luminance, atol=1.0)
    smooth = np.add.outer(np.arange(40), 2 * np.arange(60)).astype(np.uint8)
    path = saved(tmp_path / "i.jpg", np.dstack([smooth] * 3), tags={ORIENTATION: 6}, quality=95)
    assert_close(read_grey(path, read_head(path)), smooth, atol=3.0)


def bomb(width, height):
    """The head of a PNG that announces so many pixels, and hardly any of them."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(b"\0" * 99))]
    body = [
        struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in (*chunks, (b"IEND", b""))
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def test_a_copy_in_a_pose_counts_once_and_in_another_pose_is_a_fault(tmp_path):
    for name in ("images/1/a.png", "images/1/b.png", "images/2/a.png"):
        saved(tmp_path / name)
    shutil.copy(tmp_path / "images/1/a.png", tmp_path / "images/1/c.png")
    found = listed(tmp_path)
    assert [one.image for one in found.found] == ["1/a", "1/b", "2/a"]
    assert found.left_out == {("images/1/c.png", "a copy of another photograph of its pose"): 1}
    shutil.copy(tmp_path / "images/1/b.png", tmp_path / "images/2/b.png")
    (fault,) = listed_photographs(tmp_path)[1]
    assert (fault.file, fault.value) == ("images/2/b.png", "2")
    assert_says(fault.expected, "photograph", "images/1/b.png", "pose 1", "same")


def test_everything_that_is_wrong_is_reported_at_once(tmp_path):
    folder = tmp_path / "images" / "1"
    saved(folder / "twice.jpg")
    saved(folder / "twice.png")
    saved(folder / "tiny.png", np.zeros((1, 1), np.uint8))
    saved(tmp_path / "images" / "nopose.jpg")
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "text.jpg").write_text("no picture at all")
    (folder / "bomb.png").write_bytes(bomb(60_000, 60_000))
    (folder / "damaged.tif").write_bytes(b"II*\0\x08\0\0\0\xff\xff")
    Image.fromarray(GREY.astype(np.float32)).save(folder / "deep.tif")
    _, faults = listed_photographs(tmp_path)
    found = {str(fault).split(": ", 1)[0]: str(fault).split(": ", 1)[1] for fault in faults}
    assert {name: [word for word in words if word in found[name]] for name, words in EXPECTED.items()} == EXPECTED
    assert found.keys() == EXPECTED.keys()


EXPECTED = {
    "images/1/twice.png": ["'1/twice'", "images/1/twice.jpg has it, too"],
    "images/1/tiny.png": ["'1 x 1'", "at least 16 px"],
    "images/nopose.jpg": ["a pose in its name", "from_name"],
    "images/1/empty.jpg": ["this file is empty"],
    "images/1/text.jpg": ["JPEG, PNG or TIFF"],
    "images/1/bomb.png": ["million pixels"],
    "images/1/damaged.tif": ["a TIFF with a damaged header"],
    "images/1/deep.tif": ["'32'", "8 or 16 bits"],
}


def test_an_entry_that_leads_to_no_photograph(tmp_path):
    saved(tmp_path / "a.png")
    (tmp_path / "table.csv").write_text("x\n1\n")
    for entry, words in (
        ({"path": "table.csv"}, "a photograph (.jpg"),
        ({"path": "none/*.jpg"}, "an existing file"),
        ({"path": "a.png", "from_name": r"x(?P<pose>\d)"}, "gives the pose"),
        ({"path": "a.png", "constants": {"pose": 1, "body": "b"}}, "one of camera, image, pose"),
        ({"path": "a.png", "constants": {"pose": 1}, "separator": ";"}, "one of constants, from_name"),
    ):
        _, faults = listed_photographs(tmp_path, **entry)
        assert len(faults) == 1
        assert words in str(faults[0])


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "deep.png", "deep.tif"])
def test_truncated_or_damaged_photographs_are_refused(tmp_path, name):
    path = saved(
        tmp_path / name, np.tile(GREY, (4, 4)) if "deep" not in name else np.tile(GREY, (4, 4)) * np.uint16(257)
    )
    content = path.read_bytes()
    head = read_head(path)
    for cut in (len(content) // 3, len(content) - 200):
        path.write_bytes(content[:cut])
        with pytest.raises(Unusable, match=r"an undamaged photograph|as JPEG, PNG or TIFF"):
            read_grey(path, head)
    path.write_bytes(content)
    assert read_grey(path, head).shape == (160, 240)


def test_damage_anywhere_is_a_fault_or_none_and_nothing_is_said_aside(tmp_path, capfd):
    rng = np.random.default_rng(3)
    exposure = {FOCAL: IFDRational(50), FOCAL_35: 75}
    files = [
        saved(tmp_path / f"{k}.{e}", tags={MODEL: "D"}, exposure=exposure) for k, e in enumerate(("jpg", "png", "tif"))
    ]
    files += [saved(tmp_path / "16.png", GREY * np.uint16(257)), tmp_path / "16.tif"]
    cv2.imwrite(str(files[-1]), np.dstack([GREY] * 3) * np.uint16(257))
    damaged, read = tmp_path / "damaged.bin", 0
    for turn in range(500):
        content = bytearray(files[turn % len(files)].read_bytes())
        for at in rng.integers(min(len(content), 300), size=rng.integers(1, 5)):
            content[at : at + rng.integers(0, 3)] = bytes(rng.integers(0, 256, rng.integers(0, 3)).astype(np.uint8))
        damaged.write_bytes(content)
        with suppress(Unusable):
            head = read_head(damaged)
            assert read_grey(damaged, head).shape == (head.height_px, head.width_px)
            read += 1
    assert 0 < read < 500
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("ending", ["heic", "HEIF", "webp", "cr2", "NEF", "dng", "gif", "bmp", "avif"])
@pytest.mark.parametrize("entry", [{}, {"path": "images"}, {"path": "images/*/*"}])
def test_a_picture_in_another_format_in_the_place_of_a_photograph_is_a_fault(tmp_path, ending, entry):
    saved(tmp_path / "images/1/a.jpg")
    (tmp_path / f"images/2.{ending}" if not entry else tmp_path / f"images/1/b.{ending}").write_bytes(b"picture")
    faults = listed_photographs(tmp_path, **entry)[1]
    assert len(faults) == 1
    assert f"export it from .{ending.lower()}" in faults[0].expected
    assert_says(faults[0].expected, "JPEG, PNG", "TIFF")


def test_raw_data_next_to_its_photograph_and_notes_are_counted(tmp_path):
    for name in ("images/1/a.jpg", "images/2/a.jpg"):
        saved(tmp_path / name)
    for name in ("images/1/a.CR2", "images/2/a.nef", "images/notes.txt", "images/2/plan.pdf", "images/.DS_Store"):
        (tmp_path / name).write_bytes(b"x")
    found = listed(tmp_path)
    assert [one.pose for one in found.found] == ["1", "2"]
    assert found.left_out == {
        ("images", "no photograph (.txt)"): 1,
        ("images/1", "no photograph (.cr2)"): 1,
        ("images/2", "no photograph (.nef)"): 1,
        ("images/2", "no photograph (.pdf)"): 1,
    }


def test_pipes_and_dead_links_among_photographs_are_named(tmp_path):
    saved(tmp_path / "images/1/a.jpg")
    os.mkfifo(tmp_path / "images/1/b.jpg")
    os.mkfifo(tmp_path / "images/1/control")
    (tmp_path / "images/1/c.png").symlink_to(tmp_path / "nowhere.png")
    log = FaultLog()
    found = listed(tmp_path, log)
    assert {fault.file: fault.expected.split("; ")[-1] for fault in log.faults()} == {
        "images/1/b.jpg": "this is a pipe",
        "images/1/c.png": "this is a link that leads nowhere",
    }
    assert found.left_out == {("images/1", "a pipe"): 1}


def test_photographs_that_no_pattern_reaches_are_reported(tmp_path):
    saved(tmp_path / "images/1/a.jpg")
    saved(tmp_path / "images/1/left/day2/a.jpg")
    saved(tmp_path / "images/2/a.jpg").rename(tmp_path / "images/2/a.Jpg")
    assert [(fault.file, says(fault.expected, "two folders down")) for fault in listed_photographs(tmp_path)[1]] == [
        ("images/1/left/day2/a.jpg", True),
        ("images/2/a.Jpg", False),
    ]
