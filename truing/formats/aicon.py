"""AICON's files of an adjustment: image coordinates (.phc), interior orientations (.ior), scale bars (.scale).

Image coordinates are in mm from the centre of the format, y upwards. Conversion to pixels needs the format of the
camera (.ior) and the camera of each image (.eor). Lists of object points (.obc) are read as text.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.formats.compression import open_plain
from truing.formats.file_search import companion_files, format_suffix
from truing.formats.interior_orientation import Row, camera_row, from_millimetres
from truing.formats.raw import RawBatch, Unusable, Wanted, finite_numbers, integer_columns, one_batch
from truing.formats.source import RawFile

_LARGEST = 1 << 28
_PER_CAMERA = 5
_RAY = "image, point, x y in mm, their sigmas, residuals, three flags"
_INTERIOR = (
    "five lines of a camera: number, -999, Ck, xh, yh, A1, A2, R0; A3; B1, B2; C1, C2; "
    "width and height in mm, then in pixels"
)


@dataclass(frozen=True)
class AiconCamera:
    """A camera of an .ior file: its row of the table ``cameras``, its centre (2,) in px and its pixel pitch in mm."""

    row: Row
    centre_px: Array
    pitch_mm: float


def read_phc(raw: RawFile, path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the image points of a .phc file, in px; raises Unusable for a missing .ior or .eor file and for damaged
    ones."""
    companions = {format_suffix(companion_file): companion_file for companion_file in companion_files(raw.path)}
    if ".ior" not in companions:
        raise Unusable("an .ior file of the same name next to it, whose pixel size converts mm to px")
    cameras = {
        str(camera.row["camera"]): camera for camera in _cameras(_lines(companions[".ior"], companions[".ior"].name))
    }
    lines = _lines(path)
    rows = _numbers(lines, 11, _RAY)
    numbers = [row for row, _ in lines]
    if not numbers:
        raise Unusable(f"lines of {_RAY}")
    image, point = (integer_columns(rows[:, i], what, numbers) for i, what in enumerate(("images", "points")))
    names = _camera_of_image(companions.get(".eor"), cameras, image)
    chosen, which = np.unique(names, return_inverse=True)
    unknown = [name for name in chosen if name not in cameras]
    if unknown:
        raise Unusable(f"cameras of {companions['.ior'].name}", column="camera", value=", ".join(unknown))
    centre = np.array([cameras[name].centre_px for name in chosen])[which]
    pitch = np.array([cameras[name].pitch_mm for name in chosen])[which]
    columns = {
        "image": image.astype(str).astype(object),
        "camera": names.astype(object),
        "point": point.astype(str).astype(object),
        "x_px": centre[:, 0] + rows[:, 2] / pitch,
        "y_px": centre[:, 1] - rows[:, 3] / pitch,
        "own_sx": rows[:, 4] / pitch,
        "own_sy": rows[:, 5] / pitch,
        "used": (rows[:, 8:] == 1).all(axis=1).astype(int).astype(str).astype(object),
    }
    yield from one_batch(columns, wanted, lines=numbers)


def read_ior(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the cameras of an .ior file, in px; raises Unusable for a damaged file."""
    lines = _lines(path)
    rows = [camera.row for camera in _cameras(lines)]
    first = [row for row, _ in lines[::_PER_CAMERA]]
    yield from one_batch({name: [row[name] for row in rows] for name in rows[0]}, wanted, lines=first)


def read_scale(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the scale bars of a .scale file: number, name in quotation marks, two points, length, sigma, 1 if used."""
    bars: list[tuple[object, ...]] = []
    expected = 'a scale bar: number, "name", two points, length, sigma, flag'
    lines = _lines(path)
    for row, line in lines:
        before, _, after = line.rpartition('"')
        number, _, name = before.partition('"')
        words = after.split()
        if not name or len(words) != 5:
            raise Unusable(expected, row=row, value=line[:80])
        length, sigma = _numbers([(row, " ".join(words[2:4]))], 2, expected)[0]
        bars.append((f"{name} {number.strip()}", words[0], words[1], length, sigma, words[4]))
    names = ("bar", "first", "second", "length_mm", "sigma_mm", "used")
    yield from one_batch(
        {name: [bar[i] for bar in bars] for i, name in enumerate(names)}, wanted, lines=[row for row, _ in lines]
    )


def _lines(path: Path, name: str | None = None) -> list[tuple[int, str]]:
    with open_plain(path) as stream:
        content = stream.read(_LARGEST + 1)
    if len(content) > _LARGEST or b"\0" in content:
        where = "" if name is None else f" ({name})"
        raise Unusable(f"text of at most {_LARGEST >> 20} MB{where}")
    lines = enumerate(content.decode("utf-8", errors="replace").splitlines(), start=1)
    return [(row, line) for row, line in lines if line.strip()]


def _numbers(lines: list[tuple[int, str]], count: int, expected: str) -> Array:
    """Return lines of ``count`` finite numbers each (N, count); raises Unusable at the first other line."""
    return np.array([finite_numbers(line, expected, row, count) for row, line in lines]).reshape(-1, count)


def _cameras(lines: list[tuple[int, str]]) -> list[AiconCamera]:
    """Return cameras of five lines each."""
    if not lines or len(lines) % _PER_CAMERA:
        raise Unusable(_INTERIOR, value=f"{len(lines)} lines")
    return [_camera(lines[first : first + _PER_CAMERA]) for first in range(0, len(lines), _PER_CAMERA)]


def _camera(lines: list[tuple[int, str]]) -> AiconCamera:
    first, second, third, fourth, last = (
        _numbers([line], count, _INTERIOR)[0] for line, count in zip(lines, (8, 1, 2, 2, 4), strict=True)
    )
    number, _, ck, xh, yh, a1, a2, radius = first
    width_mm, _, width, height = last
    if min(last) <= 0 or ck >= 0:
        raise Unusable("Ck below 0, a width and a height above 0", row=lines[0][0], value=f"Ck = {ck}")
    pitch = width_mm / width
    (named,) = integer_columns(np.array([number]), "cameras", [lines[0][0]]).tolist()
    ten = from_millimetres([-ck, xh, yh, a1, a2, second[0], *third, *fourth], pitch)
    size = tuple(integer_columns(np.array([width, height]), "pixels", [lines[4][0]] * 2).tolist())
    row = camera_row(str(named), size, ten, radius_px=radius / pitch, pixel_um=1e3 * pitch)
    return AiconCamera(row, np.array([(width - 1) / 2, (height - 1) / 2]), pitch)


def _camera_of_image(eor: Path | None, cameras: dict[str, AiconCamera], image: Index) -> NDArray[np.str_]:
    """Return the camera of each image: from the .eor file, or the only camera."""
    if eor is None:
        if len(cameras) > 1:
            raise Unusable("an .eor file next to it, which names the camera of each image")
        return np.full(len(image), next(iter(cameras)))
    expected = f"lines of {eor.name}: image, camera, X Y Z, omega phi kappa, three numbers"
    table = _numbers(_lines(eor, eor.name), 11, expected)
    if not len(table):
        raise Unusable(expected)
    order = np.argsort(table[:, 0])
    index = np.clip(np.searchsorted(table[order, 0], image), 0, len(order) - 1)
    known = table[order[index], 0] == image
    if not known.all():
        raise Unusable(f"images of {eor.name}", column="image", value=str(image[~known][0]))
    return integer_columns(table[order[index], 1], f"cameras in {eor.name}").astype(str)
