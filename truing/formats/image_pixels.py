"""The grey values of a photograph, as they stand in its file: not turned, not stretched."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.image_heads import NO_IMAGE, Head
from truing.formats.raw import Unusable

_DAMAGED = "a whole photograph; this one is damaged or ends early"


def read_grey(path: Path, head: Head) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Grey values (height, width) of a photograph, of colours their luminance (ITU-R BT.601).

    Raises Unusable where the file is damaged, or is not what its head told.
    """
    grey = _deep(path) if head.bits == 16 else _plain(path)
    if grey.shape != (head.height_px, head.width_px):
        raise Unusable(_DAMAGED, value=f"{grey.shape[1]} x {grey.shape[0]} px")
    return grey


def _plain(path: Path) -> NDArray[np.uint8]:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged tags, and of large images: heads are looked at before
            with Image.open(path, formats=("JPEG", "PNG", "TIFF")) as image:
                image.draft("L", image.size)  # a JPEG holds its luminance apart from its colours
                return np.asarray(image.convert("L"))
    except (*NO_IMAGE, Image.DecompressionBombError) as error:
        raise Unusable(_DAMAGED, value=_reason(error, path)) from error


def _deep(path: Path) -> NDArray[np.uint16]:
    """16 bits per value; colours of that depth are what one library alone reads, and what is damaged the other sees."""
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
        with _quiet(cv2):
            pixels = cv2.imdecode(content, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None or pixels.dtype != np.uint16:
            raise Unusable(_DAMAGED)
        codes = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}
        return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, codes[pixels.shape[2]])
    except (*NO_IMAGE, cv2.error) as error:
        raise Unusable(_DAMAGED, value=_reason(error, path)) from error


@contextmanager
def _quiet(cv2: Any) -> Iterator[None]:
    """What is wrong with a file is said as a fault, not by the library on its own."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _reason(error: Exception, path: Path) -> str:
    return str(error).replace(str(path), path.name)[:80]
