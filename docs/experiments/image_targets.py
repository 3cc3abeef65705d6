"""How well circular targets are measured, in rendered photographs: the tables of docs/targets-in-images.md.

    python -m docs.experiments.image_targets

renders them, measures and renews the tables; a minute.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from docs.experiments.marked_tables import renew, table
from tests.estimation.image_targets.scenes import GROUND, dots, errors, rings
from truing.estimation.image_targets.circles import CirclePlan, measure_circles
from truing.estimation.image_targets.ring_codes import ring_code

PAGE = Path(__file__).parents[1] / "targets-in-images.md"
# semi-minor axis px, tilt degrees, blur px, noise grey levels
SHAPES = [(3, 0, 0.5, 1), (3, 0, 1.5, 5), (3, 60, 1.0, 2), (5, 0, 1.0, 2), (5, 60, 1.5, 5), (8, 0, 1.0, 2)]
SHAPES += [(8, 60, 1.0, 2), (15, 0, 0.5, 1), (15, 60, 1.5, 5), (30, 0, 1.0, 2)]
CODED = [(8, 4, 0.7), (8, 10, 1.0), (12, 5, 1.0), (12, 5, 1.5), (14, 5, 0.7), (14, 10, 1.0)]
COPIES, CODES = 81, 25
WIDTH, HEIGHT = 4000, 3000


def centres() -> str:
    """Dots of some sizes, tilts, blurs and noises: bias, scatter and what the covariance says of it."""
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
    """Seconds of one core for a photograph of twelve million pixels with some hundred coded targets."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    code = ring_code(12)
    rows = []
    for minor, blur, times in ((4, 1.0, 12), (8, 1.0, 12)):
        tile = rings(rng, (minor * 1.2, minor), blur, 2.0, 12, rng.choice(code.words, CODES)).grey
        grey = np.clip(np.rint(GROUND + 2.0 * rng.normal(size=(HEIGHT, WIDTH))), 0, 255).astype(np.uint8)
        h, w = tile.shape
        for k in range(times):
            y, x = (k // 4) * (HEIGHT // 3), (k % 4) * (WIDTH // 4)
            grey[y : y + h, x : x + w] = tile[: HEIGHT - y, : WIDTH - x]
        plan = CirclePlan(codes=(code,))
        measure_circles(grey, plan)
        spent = []
        for _ in range(3):
            start = time.process_time()
            found = measure_circles(grey, plan)
            spent.append(time.process_time() - start)
        rows.append([str(found.count), f"{minor}", f"{blur}", f"{min(spent):.2f}"])
    return table(["targets", "semi-minor axis, px", "blur, px", "s"], rows)


TABLES: Mapping[str, Callable[[], str]] = {"centres": centres, "codes": codes, "speed": speed}

if __name__ == "__main__":
    renew(PAGE, TABLES)
