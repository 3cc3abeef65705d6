"""Adjustment of a large network: python -m benchmarks.large_network.

Photographs in rows over a surface, each of a part of its points, adjusted with the covariance of every image and every
point, exactly as in small networks; then as `truing run` does it: start values from nothing, robust start, every ray
tested. One process per size, so that its peak memory is its own. Seconds are those of the processor. The first size is
that of a public network (romabundledemo of DBAT), from start values 7.3 s in that program and 1.9 s for covariances.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.rows import Row, record_row
from benchmarks.timing import run_pinned
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.named_adjustment import Choices, adjust_network
from truing.estimation.bundle.network import (
    Bars,
    ImagePoints,
    KnownPoints,
    Markers,
    NamedNetwork,
    Network,
    NetworkState,
    Rays,
    in_camera_axes,
    project,
)
from truing.estimation.rotation import exp_so3

SIGMA_PX = 0.1
WIDTH, HEIGHT = 6000, 4000
# Rows and columns of photographs, points, and most rays of a photograph.
_GOAL = "public"  # its limits are 10 s and 2 GB
SIZES = {_GOAL: (6, 10, 26_321, 1_510), "large": (10, 20, 100_000, 5_000)}
SMALLEST_SIZE = (3, 4, 1_500, 400)
SMALLEST = ("--smallest",)
_HEIGHT, _STEP = 4.0, 1.0  # m
_INTERIOR = np.array([5000.0, 4.0, -3.0, -1.2e-9, 0, 0, 0, 0, 0, 0])
_FREE = ("c", "x0", "y0", "A1", "A2")


def draw(rows: int, columns: int, points: int, most: int, seed: int = 5) -> tuple[Network, NetworkState]:
    """Return the network without gross errors, and the true state."""
    rng = np.random.default_rng(seed)
    size = np.array([rows, columns]) * _STEP + 1.5
    xyz = np.column_stack([rng.uniform(0, size, (points, 2)), np.zeros(points)])
    xyz[:, 2] = 0.25 * np.sin(1.7 * xyz[:, 0]) * np.cos(1.3 * xyz[:, 1]) + 0.1 * rng.normal(size=points)
    place = np.array([(i, j) for i in range(rows) for j in range(columns)], float) * _STEP + 1.2
    count = len(place)
    centre = np.column_stack([place, np.full(count, _HEIGHT)]) + 0.1 * rng.normal(size=(count, 3))
    quarter = exp_so3(np.pi / 2 * (np.arange(count) % 3 == 0)[:, None] * [0.0, 0.0, 1.0])
    R = np.diag([1.0, -1.0, -1.0]) @ exp_so3(0.12 * rng.normal(size=(count, 3))) @ quarter
    truth = NetworkState(_INTERIOR[None], R, centre, xyz, np.empty(0))
    camera = Camera("camera", WIDTH, HEIGHT, free=_FREE)
    nothing = Rays(*(np.zeros(0, np.int64),) * 2, np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, np.int64))
    bare = Network(
        (camera,), np.zeros(count, int), np.zeros(count, int), np.zeros(points, int), nothing, Bars.none(),
        KnownPoints.none(),
    )  # fmt: skip
    seen = [_seen(rng, bare, truth, image, most) for image in range(count)]
    image, point = np.repeat(np.arange(count), [len(own) for own in seen]), np.concatenate(seen)
    xy = project(bare, truth, image, point) + SIGMA_PX * rng.normal(size=(len(image), 2))
    cov = np.tile(SIGMA_PX**2 * np.eye(2), (len(image), 1, 1))
    return replace(bare, rays=Rays(image, point, xy, cov, np.zeros(len(image), np.int64))), truth


def _seen(rng: np.random.Generator, bare: Network, truth: NetworkState, image: int, most: int) -> np.ndarray:
    every = np.arange(len(truth.points))
    xy = project(bare, truth, np.full(len(every), image), every)
    u = in_camera_axes(truth, np.full(len(every), image), every)
    near = np.hypot(u[:, 0], u[:, 1]) < u[:, 2]  # further out, the polynomial of the lens folds the plane
    inside = np.flatnonzero(near & ((xy > 20) & (xy < [WIDTH - 20, HEIGHT - 20])).all(axis=1))
    return np.sort(rng.choice(inside, min(most, len(inside)), replace=False))


def disturbed(truth: NetworkState, seed: int = 6) -> NetworkState:
    """Return a start that is off by a centimetre, a fifth of a degree and one percent of the principal distance."""
    rng = np.random.default_rng(seed)
    return replace(
        truth,
        interior=np.where(np.arange(10) == 0, 1.01 * truth.interior, 0.0),
        R=exp_so3(np.deg2rad(0.2) * rng.normal(size=truth.centre.shape)) @ truth.R,
        centre=truth.centre + 0.01 * rng.normal(size=truth.centre.shape),
        points=truth.points + 0.01 * rng.normal(size=truth.points.shape),
    )


def measure(name: str, size: tuple[int, int, int, int]) -> None:
    """Print seconds and peak memory of one size."""
    network, truth = draw(*size)
    used = determinable(network).rays
    rays, images, points = int(used.sum()), len(network.image_pose), len(np.unique(network.rays.point[used]))
    print(f"\n{name}: {images} photographs, {points:,} points, {rays:,} rays")
    clock = time.process_time()
    found = adjust(network, disturbed(truth), used=used)
    adjusted, clock = time.process_time() - clock, time.process_time()
    found.covariance.point_blocks()
    found.covariance.images(0)
    covariance, clock = time.process_time() - clock, time.process_time()
    print(
        f"  from start values: adjustment {adjusted:.2f} s ({found.iterations} steps), covariances {covariance:.2f} s"
    )
    print(f"  sigma0 {found.variance_factor**0.5:.3f}; peak memory {_peak_mb():.0f} MB", flush=True)
    what = f"{images} photographs, {points:,} points, {rays:,} rays"
    is_goal = name == _GOAL
    record_row(Row(f"{what}: adjusted with covariances", adjusted + covariance, "s", limit=10.0 if is_goal else None))
    record_row(Row(f"{what}: peak memory", _peak_mb(), "MB", limit=2000.0 if is_goal else None))
    named, table = _named(network)
    choices = Choices("free", 0.001, True, True, {})
    interior = np.where(np.arange(10) == 0, 1.01 * _INTERIOR, 0.0)[None]
    clock = time.process_time()
    whole = adjust_network(named, table, interior, choices, lambda done, total, what: None)
    seconds = time.process_time() - clock
    print(f"  from nothing, every ray tested: {seconds:.2f} s, {whole.screened.rounds} rounds of tests")
    print(f"  peak memory {_peak_mb():.0f} MB", flush=True)


def _named(network: Network) -> tuple[NamedNetwork, ImagePoints]:
    rays, points = network.rays, len(network.point_pose)
    names = np.array([str(number) for number in range(points)], object)
    nobody, images = np.full(points, "", object), np.array([str(n) for n in range(len(network.image_pose))], object)
    named = NamedNetwork(
        network, (1,), images, names, nobody, nobody, ("circle",), np.arange(rays.count), (), Markers.none()
    )
    of_ray = nobody[rays.point]
    none = np.full(rays.count, np.nan)
    table = ImagePoints(
        rays.image, np.zeros(rays.count, np.int64), names[rays.point], of_ray, of_ray, rays.xy_px, rays.cov_px2,
        rays.kind, ("circle",), np.column_stack([none, none]), none,
    )  # fmt: skip
    return named, table


def _peak_mb() -> float:
    """Return the peak memory of this process; `ru_maxrss` would be that of an earlier program too."""
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024


def main() -> None:
    """Measure every size, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SIZES, help="measure this size alone, in this process")
    parser.add_argument("--smallest", action="store_true", help="measure a small network in this process")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    if given.smallest:
        measure("smallest", SMALLEST_SIZE)
    elif given.size:
        measure(given.size, SIZES[given.size])
    else:
        for name in SIZES:
            run_pinned("benchmarks.large_network", ["--size", name], 1)
            sys.stdout.flush()


if __name__ == "__main__":
    main()
