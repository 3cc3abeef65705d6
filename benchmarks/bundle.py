"""Bundle adjustment compared with other libraries: python -m benchmarks.bundle.

60 images of 100 targets, 12,000 residuals, 663 unknowns: principal distance and two radial terms of one camera, all
images and points, from the same start. Ours ends with the covariance of everything, that of points with all other
points among it; pycolmap's has each point alone, everything else held fixed. A row whose sum of squares is not within
1e-6 of the least one prints no ratio; a library that is not installed prints "unmeasured". One thread and two, on
pinned processors, repeats interleaved; with --processor-time what a busy neighbour takes is not counted. Then a
campaign: 46 poses of 60 points, ten images each, one camera, ours alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from benchmarks.bundle_peers import PEERS, Solver
from benchmarks.bundle_problem import Problem, draw, sum_of_squares
from benchmarks.rows import record_row, timed_row
from benchmarks.timing import interleaved, pin, run_pinned, seconds_now, thread_counts
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.network import NetworkState

_OURS = "truing with covariance"
_OWN = "truing"
_WITH_COVARIANCE = (_OURS, "pycolmap with covariance")
SMALLEST = ("--repeats", "1", "--threads", "1", "--images", "4")


def ours(problem: Problem, covariance: bool) -> Solver:
    """Return our adjustment; with the covariance of everything where asked for."""

    def solve() -> NetworkState:
        found = adjust(problem.network, problem.start)
        if covariance:
            _ = found.covariance
        return found.state

    return solve


def solvers(problem: Problem, threads: int) -> dict[str, Solver]:
    """Return all solvers that load here; the others are named as unmeasured."""
    found = {_OURS: ours(problem, True), _OWN: ours(problem, False)}
    for name, factory in PEERS.items():
        try:
            found[name] = factory(problem, threads)
        except ImportError as error:
            print(f"{name:32} unmeasured ({str(error).splitlines()[0][:60]})")
    return found


def compare(images: int, threads: int, repeats: int, clock: Callable[[], float]) -> None:
    """Print milliseconds of every solver and, where it reached the least sum, how many times faster ours is."""
    print(f"\n{images} images of 100 targets, {threads} thread(s): milliseconds, minimum median maximum")
    problem = draw(1, images, 100)
    found = solvers(problem, threads)
    reached = {name: sum_of_squares(problem, solve()) for name, solve in found.items()}
    tasks: dict[str, Callable[[], object]] = dict(found)
    seconds = interleaved(tasks, repeats, clock)
    missed = [name for name, cost in reached.items() if not cost <= (1 + 1e-6) * min(reached.values())]
    unmeasured = [name for name in PEERS if name not in found]
    alone = [name for name in seconds if name not in _WITH_COVARIANCE]
    what = f"bundle adjustment of {images} images, {threads} thread(s)"
    for title, name, others, limit in (
        (f"{what}, with all covariances", _OURS, (*alone, _OWN), 5.0),
        (f"{what}, without covariance", _OWN, _WITH_COVARIANCE, 3.0),
    ):
        absent = [peer for peer in unmeasured if (peer in _WITH_COVARIANCE) == (name == _OURS)]
        record_row(timed_row(title, seconds, name, own=others, missed=missed, unmeasured=absent, least_ratio=limit))
    for name, s in seconds.items():
        excess = reached[name] / min(reached.values()) - 1
        print(f"{name:32} {_spread(s)}  {_verdict(name, excess, s / seconds[_OURS])}", flush=True)


def _spread(seconds: np.ndarray) -> str:
    return f"{1e3 * np.min(seconds):9.2f} {1e3 * np.median(seconds):9.2f} {1e3 * np.max(seconds):9.2f}"


def _verdict(name: str, excess: float, ratio: np.ndarray) -> str:
    """Return the ratio of its time to ours with covariance (median and range of the repeats), or why there is none."""
    if name == _OURS:
        return ""
    if not excess <= 1e-6:
        return f"no ratio: misses the least sum of squares by {excess:.1e}"
    return f"{np.median(ratio):.1f} times ours ({ratio.min():.1f} to {ratio.max():.1f})"


def campaign(poses: int, threads: int, repeats: int, clock: Callable[[], float]) -> None:
    """Print milliseconds of a whole campaign."""
    problem = draw(poses, 10, 60)
    seconds = interleaved({_OURS: ours(problem, True)}, repeats, clock)[_OURS]
    print(f"\n{poses} poses, {10 * poses} images, {60 * poses} points, {threads} thread(s)")
    print(f"{_OURS:32} {_spread(seconds)}", flush=True)


def main() -> None:
    """Measure all of it, one process per number of threads."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--images", type=int, default=60)
    parser.add_argument(
        "--threads", type=int, choices=(1, 2), help="measure here; both, each in a process, if not given"
    )
    parser.add_argument("--processor-time", action="store_true", help="seconds of the process in place of the clock's")
    options = parser.parse_args()
    if options.threads is None:
        further = ["--processor-time"] if options.processor_time else []
        for threads in thread_counts():
            run_pinned(
                "benchmarks.bundle",
                ["--repeats", str(options.repeats), "--images", str(options.images), *further],
                threads,
            )
        return
    pin(options.threads)
    clock = time.process_time if options.processor_time else seconds_now
    compare(options.images, options.threads, options.repeats, clock)
    campaign(max(2, round(options.images * 46 / 60)), options.threads, options.repeats, clock)


if __name__ == "__main__":
    main()
