"""Time per pose for points without names and for scans, and coverage of a scan's pose covariance.

python -m benchmarks.unlabelled [--trials 400]
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row
from benchmarks.timing import PROCESSOR_TIME, interleaved, pin, run_pinned, thread_counts
from truing.estimation.labels.labelling import label_bodies, label_points
from truing.estimation.rotation import exp_so3, log_so3
from truing.estimation.scans.registration import refine_scan, register_scan

SMALLEST = ("--trials", "2", "--threads", "1", "--points", "10000")
_SIGMA = 5e-6
_SCAN_NOISE = 5e-5
# 95 % of a chi-square of six degrees of freedom.
_ELLIPSOID = 12.592


def _moved(rng: np.random.Generator, survey: np.ndarray) -> np.ndarray:
    cloud = survey @ exp_so3(rng.normal(size=3)).T + rng.normal(size=3)
    return cloud + rng.normal(scale=_SIGMA, size=cloud.shape)


def _labelling() -> None:
    rng, tasks = np.random.default_rng(0), {}
    for n in (20, 100, 500):
        survey = rng.uniform(-0.3, 0.3, (n, 3))
        cloud = _moved(rng, np.r_[survey[n // 4 :], rng.uniform(-0.4, 0.4, (n // 4, 3))])
        tasks[f"{n} targets, a quarter missing, as many strangers"] = lambda c=cloud, s=survey: label_points(
            c, s, _SIGMA
        )
    sizes = {"base": 14, "platform": 18, **{f"leg{i}": 4 for i in range(1, 7)}}
    bodies = {name: rng.uniform(-0.15, 0.15, (n, 3)) for name, n in sizes.items()}
    cloud = np.concatenate([_moved(rng, survey) for survey in bodies.values()])
    tasks["eight bodies of 56 targets in one cloud"] = lambda: label_bodies(cloud, bodies, _SIGMA)
    for name, seconds in interleaved(tasks, 7).items():
        record_row(Row(f"labels: {name}", 1e3 * float(np.median(seconds)), "ms"))
        print(f"  {name:<52} {1e3 * seconds.min():8.1f} {1e3 * np.median(seconds):8.1f} {1e3 * seconds.max():8.1f} ms")


def _surface(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    x, y, z = (d / np.linalg.norm(d, axis=1)[:, None]).T
    radius = 0.1 * (1 + 0.15 * x * y + 0.2 * z**2 - 0.1 * x**3 + 0.1 * np.sin(3 * y) + 0.08 * x * z)
    return np.c_[1.2 * x, y, 0.7 * z] * radius[:, None]


def _scan(rng: np.random.Generator, n: int, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A noisy reference of n points, and a noisy scan of one side of the body."""
    reference, scan = _surface(rng, n), _surface(rng, n)
    scan = scan[scan[:, 0] + 0.3 * scan[:, 1] > -0.02] @ R.T + t
    return tuple(cloud + rng.normal(scale=_SCAN_NOISE, size=cloud.shape) for cloud in (reference, scan))


def _registration(most: int) -> None:
    R, t = exp_so3(np.array([0.5, -1.3, 2.0])), np.array([0.3, 0.1, -0.5])
    register_scan(*_scan(np.random.default_rng(1), 3000, R, t)[::-1])
    for n in (size for size in (10_000, 100_000, 1_000_000) if size <= most):
        reference, scan = _scan(np.random.default_rng(0), n, R, t)
        wall, cpu = time.perf_counter(), time.process_time()
        fit = register_scan(scan, reference)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        spent = cpu if os.environ.get(PROCESSOR_TIME) else wall
        record_row(Row(f"registration of a scan of {n:,} points", spent, "s"))
        sigma = 1e6 * np.sqrt(fit.covariance[0, 0]) if fit.covariance is not None else np.nan
        print(f"  {n:>9,} reference, {len(scan):>9,} scan points: {fit.status}, {wall:6.1f} s, {cpu:6.1f} CPU s, "
              f"sigma_x {sigma:.2f} um, peak {_peak_mb():.0f} MB")  # fmt: skip


def _peak_mb() -> float:
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), np.nan)


def _coverage(trials: int) -> None:
    R, t = exp_so3(np.array([0.5, -1.3, 2.0])), np.array([0.3, 0.1, -0.5])
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = R, t
    squared, enlarged = [], 0
    for seed in range(trials):
        reference, scan = _scan(np.random.default_rng(seed), 10_000, R, t)
        fit = refine_scan(scan, reference, start)
        T = fit.T_measurement_reference
        error = np.r_[T[:3, 3] - t, log_so3(T[:3, :3] @ R.T)]
        squared.append(error @ np.linalg.solve(fit.covariance, error))
        enlarged += fit.noise_ratio > 1
    inside = np.mean(np.array(squared) < _ELLIPSOID)
    record_row(Row(f"share of {trials} scans inside their 95 % ellipsoid", 100 * float(inside), "%"))
    print(f"  95 % ellipsoid of {trials} scans of 5,600 points: covers {100 * inside:.1f} % (+- "
          f"{100 * np.sqrt(0.95 * 0.05 / trials):.1f}), mean squared error {np.mean(squared):.2f} of 6, "
          f"covariance enlarged in {100 * enlarged / trials:.1f} %")  # fmt: skip


def main() -> None:
    """Measure in a pinned process, with one thread and with two."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--points", type=int, default=1_000_000, help="of the largest scan")
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    if arguments.threads is None:
        for threads in thread_counts():
            words = ["--trials", str(arguments.trials), "--points", str(arguments.points)]
            run_pinned("benchmarks.unlabelled", words, threads)
        return
    pin(arguments.threads)
    print(f"threads {arguments.threads}: labelling, minimum median maximum", flush=True)
    _labelling()
    print("registration of a scan of one side, nothing known of the pose", flush=True)
    _registration(arguments.points)
    if arguments.threads == 1:
        _coverage(arguments.trials)


if __name__ == "__main__":
    main()
