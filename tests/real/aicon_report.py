"""AICON 3D Studio's report of a bundle adjustment, with all numbers for the comparison."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PARTS = {
    "camera": "Innere Orientierungen",
    "images": "Äussere Orientierungen",
    "points": "Objektpunkte",
    "rays": "Bildkoordinaten",
    "bar": "Strecken",
}
_COUNTS = {
    "observations": r"Anzahl der Beobachtungen\s*:\s*(\d+)",
    "unknowns": r"Anzahl der Unbekannten\s*:\s*(\d+)",
    "conditions": r"Anzahl der Bedingungen\s*:\s*(\d+)",
    "redundancy": r"Gesamtredundanz\s*:\s*(\d+)",
    "sigma0_mm": r"S0:\s*([\d.]+)",
}
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_OF_CAMERA = r"(?:Ck|Xh|Yh|A1|A2|B1|B2)"


@dataclass(frozen=True)
class Report:
    """Counts; of the camera Ck Xh Yh A1 A2 B1 B2: values and sigmas (7, 2), correlations (7, 7); per image X Y Z
    omega phi kappa (I, 6), their sigmas (I, 6), sigmas of the rotations about the axes (I, 3), correlations of centre
    and rotations with the camera (I, 6, 7); per point number, X Y Z, sigmas (P, 7); per ray point, image, x, y,
    residuals, a-priori sigmas, redundancy numbers, test values (N, 12); of the bar two points, length, residual,
    redundancy number, sigma. Lengths in mm."""

    counts: dict[str, float]
    camera: Array
    camera_correlation: Array
    images: Array
    image_sigmas: Array
    axis_sigmas: Array
    image_correlation: Array
    points: Array
    rays: Array
    bar: tuple[float, ...]


def read_report(path: Path) -> Report:
    """The numbers of a report."""
    page = gzip.decompress(path.read_bytes())
    text = re.sub(r"<[^>]*>", " ", page.decode("utf-8", errors="replace")).replace("&nbsp;", " ")
    parts = {name: _part(text, heading) for name, heading in _PARTS.items()}
    images = list(_images(parts["images"]))
    values, sigmas, axes, correlations = (np.array([image[i] for image in images]) for i in range(4))
    return Report(
        {name: float(re.findall(pattern, text)[0]) for name, pattern in _COUNTS.items()},
        np.array(list(_pairs(parts["camera"]))),
        _correlation(parts["camera"]),
        values,
        sigmas,
        axes,
        correlations,
        np.array([row[:7] for row in _rows(parts["points"], 9)]),
        np.array(list(_rows(parts["rays"], 12))),
        next(tuple(row) for row in _rows(parts["bar"].replace("---", ""), 7)),
    )


def _part(text: str, heading: str) -> str:
    """Text between a heading and the next one."""
    after = re.split(rf"\*\*\* {heading} \*\*\*", text)[1]
    return after.split("***")[0]


def _rows(text: str, count: int) -> Iterator[list[float]]:
    """Lines that hold the given number of numbers and nothing else."""
    for line in text.splitlines():
        words = line.split()
        if len(words) == count and all(_NUMBER.fullmatch(word) for word in words):
            yield [float(word) for word in words]


def _pairs(text: str) -> Iterator[tuple[float, float]]:
    """Value and sigma of each parameter of the camera that is not fixed."""
    for _, value, sigma in re.findall(rf"({_OF_CAMERA})\s*:\s*(\S+)\s+(\d\S+)", text):
        yield float(value), float(sigma)


def _correlation(text: str) -> Array:
    lines = re.findall(rf"^ ?{_OF_CAMERA}((?:\s+-?\d\.\d{{3}})+)\s*$", text, re.MULTILINE)
    found = np.zeros((len(lines), len(lines)))
    for place, line in enumerate(lines):
        found[place, : place + 1] = [float(word) for word in line.split()]
    return found + np.tril(found, -1).T


def _images(text: str) -> Iterator[tuple[list[float], list[float], list[float], list[list[float]]]]:
    """Position and angles, their sigmas, sigmas about the axes, correlations with the camera, image by image."""
    lines = [words for line in text.splitlines() if (words := [w for w in line.split() if w not in ("air", "rad")])]
    for at, words in enumerate(lines):
        if len(words) == 9 and _NUMBER.fullmatch(words[0]) and lines[at + 3][0].startswith("Korrelation"):
            first, second, third = ([float(word) for word in lines[at + i]] for i in range(3))
            yield (
                first[2:5] + second[:3],
                first[5:8] + second[3:6],
                third[:3],
                [[float(word) for word in lines[at + 4 + i][1:]] for i in range(6)],
            )
