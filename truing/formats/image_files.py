"""Photographs: headers (size, camera, time, focal length) and grey values.

Tags as in CIPA DC-008 (Exif 3.0) and TIFF 6.0. Headers are often incomplete or wrong: values that are not finite and
positive count as missing.
"""

from __future__ import annotations

import math
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import Unusable

SMALLEST = 16  # pixels each way; a single target needs as many
_MODEL, _ORIENTATION, _WHEN, _EXIF_IFD = 0x0110, 0x0112, 0x0132, 0x8769
_TAKEN, _SPLIT_SECOND, _FOCAL, _FOCAL_35, _SERIAL = 0x9003, 0x9291, 0x920A, 0xA405, 0xA431
_WIDTH_TAKEN, _PLANE_X, _PLANE_UNIT = 0xA002, 0xA20E, 0xA210
_WIDTH, _HEIGHT, _BITS, _SAMPLES = 256, 257, 258, 277
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # inch, cm, mm, um
_DIAGONAL_35_MM = math.hypot(36.0, 24.0)
_TURNED = {
    2: "mirrored",
    3: "upside down",
    4: "mirrored upside down",
    5: "mirrored on its side",
    6: "on its side",
    7: "mirrored on its side",
    8: "on its side",
}
NO_IMAGE = (SyntaxError, ValueError, KeyError, TypeError, IndexError, EOFError, OverflowError, struct.error, OSError)
"""Errors of reading a damaged photograph."""
_DAMAGED = "an undamaged photograph; this one is damaged or ends early"


@dataclass(frozen=True)
class ImageHeader:
    """Size of an image in pixels, bits of a grey value, and if recorded: camera model and serial number, focal length
    in mm, principal distance in px with its source, time of the camera's clock, orientation."""

    width_px: int
    height_px: int
    bits: int
    model: str = ""
    serial: str = ""
    focal_mm: float | None = None
    principal_distance_px: float | None = None
    principal_distance_from: str | None = None
    taken_at: str | None = None
    turned: str = ""


def read_head(path: Path, sensor_width_mm: float | None = None) -> ImageHeader:
    """Return the header of a JPEG, PNG or TIFF; raises Unusable without one, or for an unsuitable image.

    ``sensor_width_mm``: longer side of the sensor, if known.
    """
    if not path.stat().st_size:
        raise Unusable("a photograph; this file is empty")
    width, height, bits, tags, exif = _tags(path)
    if min(width, height) < SMALLEST:
        raise Unusable(f"an image of at least {SMALLEST} px each way", value=f"{width} x {height}")
    if bits not in (8, 16):
        raise Unusable("8 or 16 bits of a grey value", value=str(bits))
    distance, distance_source = _principal_distance(exif, width, height, sensor_width_mm)
    return ImageHeader(
        width,
        height,
        bits,
        model=_text(tags.get(_MODEL)),
        serial=_text(exif.get(_SERIAL)),
        focal_mm=_number(exif.get(_FOCAL)),
        principal_distance_px=distance,
        principal_distance_from=distance_source,
        taken_at=_time_of_exposure(exif.get(_TAKEN) or tags.get(_WHEN), exif.get(_SPLIT_SECOND)),
        turned=_TURNED.get(int(_number(tags.get(_ORIENTATION)) or 1), ""),
    )


def _tags(path: Path) -> tuple[int, int, int, dict[int, object], dict[int, object]]:
    """Return width, height, bits, tags of the image and those of its exposure."""
    from PIL import Image

    with path.open("rb") as file:
        start = file.read(26)
    if start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _tiff_tags(path)
    try:
        with warnings.catch_warnings():
            # Pillow's limit warns about cameras of a hundred megapixels; twice that is refused.
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("JPEG", "PNG")) as image:
                bits = start[24] if start[:4] == b"\x89PNG" else 8
                exif = _exif(image)
                return image.width, image.height, 8 if bits < 8 else bits, *exif
    except Image.DecompressionBombError as error:
        raise Unusable(f"an image of at most {2 * (Image.MAX_IMAGE_PIXELS or 0) // 10**6} million pixels") from error
    except NO_IMAGE as error:
        raise Unusable("a photograph as JPEG, PNG or TIFF", value=str(error).replace(str(path), path.name)) from error


def _exif(image: Any) -> tuple[dict[int, Any], dict[int, Any]]:
    try:
        exif = image.getexif()
        return dict(exif), dict(exif.get_ifd(_EXIF_IFD))
    except NO_IMAGE:
        return {}, {}


def _tiff_tags(path: Path) -> tuple[int, int, int, dict[int, object], dict[int, object]]:
    """Return the same for a TIFF, including those with pixels that the library cannot open."""
    from PIL import Image
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged tags; relevant ones are checked below
            header = file.read(8)
            if header[2] == 43:  # BigTIFF
                header += file.read(8)
            directory = ImageFileDirectory_v2(header)
            file.seek(directory.next)
            directory.load(file)
            tags, exif = dict(directory), {}
            if _number(tags.get(_EXIF_IFD)):
                inner = ImageFileDirectory_v2(header, group=_EXIF_IFD)
                file.seek(int(tags[_EXIF_IFD]))
                inner.load(file)
                exif = dict(inner)
            width, height = int(tags[_WIDTH]), int(tags[_HEIGHT])
            bits = int(max(tags.get(_BITS, (1,))))
    except NO_IMAGE as error:
        raise Unusable("a photograph as JPEG, PNG or TIFF", value="a TIFF with a damaged header") from error
    if width * height > 2 * (Image.MAX_IMAGE_PIXELS or width * height):
        raise Unusable(f"an image of at most {2 * (Image.MAX_IMAGE_PIXELS or 0) // 10**6} million pixels")
    return width, height, 8 if bits < 8 else bits, tags, exif


def _principal_distance(
    exif: dict[int, object], width: int, height: int, sensor_width_mm: float | None
) -> tuple[float | None, str | None]:
    """Return a start value of the principal distance in px with its source, the most reliable available."""
    longer = max(width, height)
    focal, focal_35 = _number(exif.get(_FOCAL)), _number(exif.get(_FOCAL_35))
    if focal and sensor_width_mm:
        return focal * longer / sensor_width_mm, "focal length and sensor_width_mm"
    plane, unit = _number(exif.get(_PLANE_X)), _MM_PER_UNIT.get(int(_number(exif.get(_PLANE_UNIT)) or 2))
    if focal and plane and unit:
        width_taken = _number(exif.get(_WIDTH_TAKEN)) or width
        reduced = longer / max(width_taken, longer) if width_taken > longer else 1.0  # the image was reduced afterwards
        distance_px = focal * plane / unit * reduced
        if 0.2 < distance_px / longer < 50.0:  # such tags are sometimes wrong by powers of ten
            return distance_px, "focal length and resolution of the focal plane"
    if focal_35:
        return focal_35 * math.hypot(width, height) / _DIAGONAL_35_MM, "focal length for 35 mm film"
    return None, None


def _number(value: Any) -> float | None:
    """Return a finite number above zero; None for anything else."""
    if isinstance(value, tuple) and len(value) == 1:
        value = value[0]
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and 0.0 < number < 1e9 else None


def _text(value: object) -> str:
    if not isinstance(value, str):
        return ""
    return " ".join("".join(c if c.isprintable() else " " for c in value).split())[:80]


def _time_of_exposure(value: object, split_second: object) -> str | None:
    match = re.fullmatch(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)", _text(value))
    if match is None or match[1] == "0000":
        return None
    split = _text(split_second)
    return f"{match[1]}-{match[2]}-{match[3]}T{match[4]}" + (f".{split}" if split.isdecimal() else "")


def read_grey(path: Path, head: ImageHeader) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the grey values (height, width) of a photograph; for colours the luminance (ITU-R BT.601).

    Raises Unusable if the file is damaged or contradicts its header.
    """
    grey = _deep(path) if head.bits == 16 else _plain(path)
    if grey.shape != (head.height_px, head.width_px):
        raise Unusable(_DAMAGED, value=f"{grey.shape[1]} x {grey.shape[0]} px")
    return grey


def _plain(path: Path) -> NDArray[np.uint8]:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged tags and large images: the header is already checked
            with Image.open(path, formats=("JPEG", "PNG", "TIFF")) as image:
                image.draft("L", image.size)  # a JPEG stores luminance separately from colour
                return np.asarray(image.convert("L"))
    except (*NO_IMAGE, Image.DecompressionBombError) as error:
        raise Unusable(_DAMAGED, value=_reason(error, path)) from error


def _deep(path: Path) -> NDArray[np.uint16]:
    """Return 16 bits per value; only OpenCV reads colours of that depth, only Pillow detects damage."""
    import cv2
    from PIL import Image

    try:
        with path.open("rb") as file:
            content = np.frombuffer(file.read(), np.uint8)
        if bytes(content[:4]) == b"\x89PNG":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                with Image.open(path, formats=("PNG",)) as image:
                    image.verify()
        with _silenced(cv2):
            pixels = cv2.imdecode(content, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None or pixels.dtype != np.uint16:
            raise Unusable(_DAMAGED)
        codes = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}
        return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, codes[pixels.shape[2]])
    except (*NO_IMAGE, cv2.error) as error:
        raise Unusable(_DAMAGED, value=_reason(error, path)) from error


@contextmanager
def _silenced(cv2: Any) -> Iterator[None]:
    """Suppress OpenCV's messages about a file; faults report them."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _reason(error: Exception, path: Path) -> str:
    return str(error).replace(str(path), path.name)[:80]
