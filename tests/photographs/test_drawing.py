"""The renderer agrees with geometry, and other software reads its pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.blind.generator.quaternions import Array
from tests.photographs.drawing import Fineness, collected, patch, radiance
from tests.photographs.lens import Lens, View, direction
from tests.photographs.markers import charuco, chessboard, marker
from tests.photographs.patterns import Cells, Colours, Dot, Ring
from tests.photographs.ring_words import ring_words, segments
from tests.photographs.scene import Decal, Scene, decal
from tests.photographs.sensor import Sensor, save
from tests.photographs.stations import looking

LENS = Lens(width_px=640, height_px=480, focal_px=900.0)
UP = np.array([0.0, 0.0, 1.0])


def camera(x: float, y: float, z: float, roll: float = 0.0) -> View:
    centre = np.array([[x, y, z]])
    return View(looking(centre, np.zeros((1, 3)), np.array([roll]))[0], centre[0])


def imaged(view: View, points: Array, lens: Lens = LENS) -> Array:
    pixel = lens.image_of(direction(view.seen(points)))
    return np.stack([pixel.real, pixel.imag], axis=-1)


def on_decal(thing: Decal, u: Array, v: Array) -> Array:
    return thing.centre + u[..., None] * thing.right + v[..., None] * thing.down


@pytest.mark.parametrize("place", [(0.0, 0.0), (130.0, 90.0), (-180.0, -60.0)])
def test_a_circle_covers_the_enclosed_share_of_each_pixel(place: tuple[float, float]) -> None:
    view, dot = camera(-250.0, -420.0, 500.0, roll=0.3), Dot(4.0, 9.0)
    thing = decal("dot", dot, np.array([*place, 0.0]), UP)
    on = patch(thing, LENS, view, samples=3)
    assert on is not None
    albedo, opacity = dot(on.u, on.v)
    ground = dot.colours.ground
    share = (albedo - ground) * opacity / (dot.colours.mark - ground)
    # By samples: pixels alone alias, and their centroid with them.
    rows, columns = (part.start - 0.5 + (np.arange(n) + 0.5) / 3 for part, n in zip(on.box, share.shape, strict=True))
    centroid = np.array([(share * columns).sum(), (share * rows[:, None]).sum()]) / share.sum()
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    outline = imaged(view, on_decal(thing, 4.0 * np.cos(angle), 4.0 * np.sin(angle)))
    expected_area, expected = _polygon(outline)
    assert abs(share.sum() / 9 / expected_area - 1) < 1e-3
    assert np.hypot(*(centroid - expected)) < 5e-4


def test_in_whatever_phase_of_the_pixels_a_blurred_circle_keeps_its_centroid() -> None:
    view, rng = camera(-250.0, -420.0, 500.0, roll=0.3), np.random.default_rng(6)
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for place in rng.uniform(-60.0, 60.0, (6, 2)):
        thing, fineness = (
            decal("dot", Dot(4.0, 12.0, Colours(ground=0.0)), np.array([*place, 0.0]), UP),
            Fineness(3, 0.75),
        )
        on = patch(thing, LENS, view, fineness.samples, fineness.margin_px)
        assert on is not None
        light = collected(thing.pattern(on.u, on.v)[0], fineness)
        rows, columns = (np.arange(part.start, part.stop) for part in on.box)
        centroid = np.array([(light * columns).sum(), (light * rows[:, None]).sum()]) / light.sum()
        _, expected = _polygon(imaged(view, on_decal(thing, 4.0 * np.cos(angle), 4.0 * np.sin(angle))))
        assert np.hypot(*(centroid - expected)) < 5e-4


def _polygon(corners: Array) -> tuple[float, Array]:
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    return abs(cross.sum()) / 2, ((corners + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def test_there_are_as_many_ring_codes_as_are_known() -> None:
    # Of six beads, with two or four white ones and two of them opposite, by hand; the others are printed numbers.
    assert ring_words(6) == (0b001001, 0b001111, 0b010111, 0b011011)
    assert [len(ring_words(bits)) for bits in (8, 12, 14)] == [13, 147, 516]


@pytest.mark.parametrize(("bits", "number"), [(8, 3), (12, 57), (14, 211)])
def test_a_ring_shows_its_word_clockwise_from_the_front(bits: int, number: int) -> None:
    thing = decal("ring", Ring(8.0, segments(bits, number)), np.zeros(3), UP)
    view = camera(0.0, -1.0, 400.0)
    light = radiance(LENS, view, Scene((), (thing,), nominal_mm=400.0), blur_px=0.7)
    angle = 2 * np.pi * (np.arange(bits) + 0.5) / bits
    at = np.round(imaged(view, on_decal(thing, 20.0 * np.cos(angle), 20.0 * np.sin(angle)))).astype(int)
    lit = light[at[:, 1], at[:, 0]] > 0.5
    assert tuple(lit.tolist()) == segments(bits, number)
    # In the picture, where y is down, the angle grows clockwise.
    right, down = imaged(view, on_decal(thing, np.array([0.0, 9.0, 0.0]), np.array([0.0, 0.0, 9.0])))[1:] - imaged(
        view, np.zeros(3)
    )
    assert right[0] * down[1] - right[1] * down[0] > 0


def _photograph(pattern: Cells, view: View) -> tuple[Array, Decal]:
    thing = decal("board", pattern, np.zeros(3), UP)
    scene = Scene((), (thing,), nominal_mm=500.0)
    return Sensor().expose(radiance(LENS, view, scene, blur_px=0.7, samples=2), LENS, np.random.default_rng(4)), thing


@pytest.mark.parametrize(("dictionary", "number"), [("4X4_50", 17), ("APRILTAG_36h11", 5), ("6X6_250", 101)])
def test_markers_are_read_by_the_library_whose_bits_they_are(dictionary: str, number: int) -> None:
    edge = 120.0
    grey, thing = _photograph(marker(dictionary, number, edge), camera(120.0, -150.0, 450.0, roll=0.8))
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    asked = cv2.aruco.DetectorParameters()
    asked.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, numbers, _ = cv2.aruco.ArucoDetector(known, asked).detectMarkers(grey)
    assert np.ravel(numbers).tolist() == [number]
    u, v = edge / 2 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]], float)
    expected = imaged(camera(120.0, -150.0, 450.0, roll=0.8), on_decal(thing, u, v))
    assert np.abs(corners[0][0] - expected).max() < 0.25


def test_corners_of_boards_are_where_geometry_has_them() -> None:
    view = camera(60.0, -180.0, 420.0, roll=0.2)
    grey, thing = _photograph(chessboard(8, 6, 25.0), view)
    u, v = np.meshgrid(25.0 * (np.arange(7) - 3), 25.0 * (np.arange(5) - 2))
    expected = imaged(view, on_decal(thing, u.ravel(), v.ravel()))
    start = np.ascontiguousarray(expected[:, None] + np.array([0.8, -0.6]), dtype=np.float32)
    corners = cv2.cornerSubPix(grey, start, (5, 5), (-1, -1), (3, 60, 1e-5))[:, 0]
    off = corners - expected
    assert np.abs(off.mean(axis=0)).max() < 0.02
    assert off.std(axis=0).max() < 0.05


def test_a_charuco_board_is_read_whole() -> None:
    view = camera(60.0, -180.0, 420.0, roll=0.2)
    grey, _ = _photograph(charuco(7, 5, 30.0), view)
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    _, numbers, _, _ = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((7, 5), 8, 6, known)).detectBoard(grey)
    assert sorted(np.ravel(numbers).tolist()) == list(range(24))


@pytest.mark.parametrize("ending", ["jpg", "png"])
def test_a_file_gives_its_camera_and_focal_length(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"photograph.{ending}"
    save(np.full((LENS.height_px, LENS.width_px), 40, np.uint8), path, LENS)
    with Image.open(path) as image:
        exif = image.getexif()
        assert exif[0x0110] == LENS.name
        assert abs(float(exif.get_ifd(0x8769)[0x920A]) - LENS.focal_px * LENS.pitch_um / 1000) < 0.05
