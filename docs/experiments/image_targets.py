"""Tables of docs/targets-in-images.md: accuracy of circular targets in rendered photographs.

    python -m docs.experiments.image_targets

renders them, measures and renews the tables; a minute.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from docs.experiments.marked_tables import renew, table
from tests.estimation.image_targets.planes import CORNERS, exposed, homography, marker_pattern, plane_picture
from tests.estimation.image_targets.scenes import GROUND, dots, errors, rings
from truing.estimation.image_targets.circles import CirclePlan, measure_circles
from truing.estimation.image_targets.image_noise import estimate_noise
from truing.estimation.image_targets.ring_codes import family_of_rings, ring_code
from truing.estimation.image_targets.square_markers import measure_markers
from truing.formats.image_files import read_grey, read_head
from truing.schemas.photographs import MARKERS, RINGS, USUAL

PAGE = Path(__file__).parents[1] / "targets-in-images.md"
# semi-minor axis px, tilt degrees, blur px, noise grey levels
SHAPES = [(3, 0, 0.5, 1), (3, 0, 1.5, 5), (3, 60, 1.0, 2), (5, 0, 1.0, 2), (5, 60, 1.5, 5), (8, 0, 1.0, 2)]
SHAPES += [(8, 60, 1.0, 2), (15, 0, 0.5, 1), (15, 60, 1.5, 5), (30, 0, 1.0, 2)]
CODED = [(8, 4, 0.7), (8, 10, 1.0), (12, 5, 1.0), (12, 5, 1.5), (14, 5, 0.7), (14, 10, 1.0)]
COPIES, CODES = 81, 25
WIDTH, HEIGHT = 4000, 3000


def centres() -> str:
    """Dots of some sizes, tilts, blurs and noises: bias, scatter, and scatter by the covariance."""
    heads = ["semi-minor axis, px", "tilt", "blur, px", "noise", "found", "bias, px", "scatter, px", "stated, px"]
    rows = []
    for minor, tilt, blur, noise in SHAPES:
        rng = np.random.default_rng([minor, tilt, int(10 * blur), noise])
        scene = dots(rng, (minor / np.cos(np.radians(tilt)), minor), blur, noise, 9, copies=COPIES // 9)
        _, error, covariance = errors(measure_circles(scene.grey, CirclePlan()), scene.centre)
        stated = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 2)
        bias, scatter = np.linalg.norm(error.mean(0)), np.sqrt(np.mean(error**2))
        shape = [str(minor), f"{tilt}°", f"{blur}", str(noise), f"{len(error)} of {COPIES}"]
        rows.append([*shape, f"{bias:.4f}", f"{scatter:.4f}", f"{stated:.4f}"])
    return table(heads, rows)


def codes() -> str:
    """Coded targets of some sizes and blurs: read, misread, and the scatter of their centres."""
    heads = ["family", "semi-minor axis, px", "blur, px", "read right", "read wrong", "scatter, px", "stated, px"]
    rows = []
    for bits, minor, blur in CODED:
        rng = np.random.default_rng([bits, minor, int(10 * blur)])
        code = ring_code(bits)
        scene = rings(rng, (minor * 1.3, minor), blur, 2.0, bits, rng.choice(code.words, CODES))
        found = measure_circles(scene.grey, CirclePlan(codes=(code,)))
        match, error, covariance = errors(found, scene.centre)
        word = {-1: 0} | dict(zip(code.numbers, code.words, strict=True))
        right = sum(m >= 0 and word[n] == scene.word[m] for m, n in zip(match, found.code, strict=True))
        wrong = int((found.code >= 0).sum()) - right
        stated = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 2)
        shape = [f"`ring{bits}`", str(minor), f"{blur}", f"{right} of {CODES}", str(wrong)]
        rows.append([*shape, f"{np.sqrt(np.mean(error**2)):.4f}", f"{stated:.4f}"])
    return table(heads, rows)


def speed() -> str:
    """Seconds of one core for photographs of twelve million pixels: of circles and their codes, and of all there is."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    rows = []
    for minor, blur in ((4, 1.0), (8, 1.0)):
        word = rng.choice(ring_code(12).words, CODES)
        tile = rings(rng, (minor * 1.2, minor), blur, 2.0, 12, word).grey
        for across in (0, 2):
            grey = np.clip(np.rint(GROUND + 2.0 * rng.normal(size=(HEIGHT, WIDTH))), 0, 255).astype(np.uint8)
            for k in range(12):
                spot = grey[(k // 4) * (HEIGHT // 3) :, (k % 4) * (WIDTH // 4) :]
                spot[: tile.shape[0], : tile.shape[1]] = tile
                for n in range(across**2):
                    y, x = 140 * (n // 2), 600 + 140 * (n % 2)
                    spot[y : y + 140, x : x + 140] = _marker(
                        rng, "aruco4x4_50" if k < 6 else "apriltag36h11", 4 * k + n
                    )
            targets, markers, circles, everything = _timed(grey)
            rows.append([str(targets), f"{minor}", str(markers), f"{circles:.2f}", f"{everything:.2f}"])
    return table(["circles", "semi-minor axis, px", "markers", "circles alone, s", "all kinds, from the file, s"], rows)


def _marker(rng: np.random.Generator, family: str, code: int) -> np.ndarray:
    """A photograph (140, 140) of a marker 80 px wide, turned."""
    a = rng.uniform(0.0, 6.28)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    corners = 80.0 * (CORNERS - 0.5) @ turn.T + 69.5
    return exposed(plane_picture(marker_pattern(family, code), homography(corners), 140, 0.8, fine=4), rng)


def _timed(grey: np.ndarray) -> tuple[int, int, float, float]:
    """Numbers of circles and markers, and seconds for the usual circles and for all kinds from a JPEG."""
    plan = CirclePlan(codes=tuple(map(family_of_rings, [family for family in USUAL if family in RINGS])))
    families = tuple(family for family in USUAL if family in MARKERS)
    with TemporaryDirectory() as folder:
        path = Path(folder, "photograph.jpg")
        cv2.imwrite(str(path), grey, [cv2.IMWRITE_JPEG_QUALITY, 92])
        circles, everything = [], []
        for _ in range(4):
            start = time.process_time()
            seen = read_grey(path, read_head(path))
            noise = estimate_noise(seen)
            markers = len(measure_markers(seen, families, noise).code) // 4
            between = time.process_time()
            found = measure_circles(seen, plan, noise)
            circles.append(time.process_time() - between)
            everything.append(time.process_time() - start)
    return found.count, markers, min(circles), min(everything)


TABLES: Mapping[str, Callable[[], str]] = {"centres": centres, "codes": codes, "speed": speed}

if __name__ == "__main__":
    renew(PAGE, TABLES)
