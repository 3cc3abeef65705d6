"""From light to a file: vignetting, photons, read noise, grey levels, EXIF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.blind.generator.quaternions import Array
from tests.photographs.lens import Lens

Grey = NDArray[np.uint8]
EXIF_BLOCK, MODEL, MAKE, FOCAL_LENGTH, FOCAL_35, RESOLUTION_X, RESOLUTION_Y, RESOLUTION_UNIT = (
    0x8769, 0x0110, 0x010F, 0x920A, 0xA405, 0xA20E, 0xA20F, 0xA210,
)  # fmt: skip


@dataclass(frozen=True)
class Sensor:
    """Blur of the lens (one sigma, px), grey levels of a white target at the nominal distance, and electrons per grey
    level. Read noise and black level are in grey levels. Then follow vignetting beyond the fourth power of the cosine,
    and a gradient of the light over the format."""

    blur_px: float = 0.75
    white: float = 150.0
    electrons: float = 70.0
    read_noise: float = 0.5
    vignetting: float = 0.25
    black: float = 4.0
    gradient: tuple[float, float] = (0.10, -0.06)

    def expose(self, light: Array, lens: Lens, rng: np.random.Generator | None) -> Grey:
        """Grey levels of light (height, width); without random numbers nothing but rounding is uncertain."""
        height, width = light.shape
        x = (np.arange(width) - lens.origin_px.real) / lens.focal_px
        y = ((np.arange(height) - lens.origin_px.imag) / lens.focal_px)[:, None]
        square = x**2 + y**2
        half = width / 2 / lens.focal_px
        shade = (1 - self.vignetting * square) / (1 + square) ** 2
        shade = shade * (1 + self.gradient[0] * x / half + self.gradient[1] * y / half)
        level = self.white * light * shade
        if rng is not None:
            variance = np.maximum(level, 0.0) / self.electrons + self.read_noise**2
            level = level + np.sqrt(variance) * rng.standard_normal(level.shape)
        return np.clip(np.round(level + self.black), 0, 255).astype(np.uint8)


def save(grey: Grey, path: Path, lens: Lens, quality: int = 90) -> None:
    """Write JPEG or PNG by the ending of the name, with the camera's metadata."""
    options = {"quality": quality} if path.suffix == ".jpg" else {}
    Image.fromarray(grey).save(path, exif=_exif(lens), **options)


def _exif(lens: Lens) -> Image.Exif:
    exif = Image.Exif()
    exif[MAKE], exif[MODEL] = "Truing", lens.name
    own = exif.get_ifd(EXIF_BLOCK)
    focal_mm = lens.focal_px * lens.pitch_um / 1000
    diagonal = np.hypot(lens.width_px, lens.height_px) * lens.pitch_um / 1000
    own[FOCAL_LENGTH] = round(focal_mm, 1)
    own[FOCAL_35] = round(focal_mm * 43.27 / diagonal)
    own[RESOLUTION_X] = own[RESOLUTION_Y] = round(1e4 / lens.pitch_um, 2)
    own[RESOLUTION_UNIT] = 3  # centimetres
    return exif
