"""Reliable timing on a busy machine: pinned processes, interleaved repeats, minimum, median and maximum."""

from __future__ import annotations

import argparse
import compileall
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

# Where this variable is set, processor time counts in place of the clock's, on one thread alone.
PROCESSOR_TIME = "TRUING_BENCHMARK_PROCESSOR_TIME"
_SHORTEST = 0.02  # s
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def seconds_now() -> float:
    """The clock, or the processor time of this process where that is asked for."""
    return time.process_time() if os.environ.get(PROCESSOR_TIME) else time.perf_counter()


def thread_counts() -> tuple[int, ...]:
    """Numbers of threads to measure with: processor time of two threads would add up."""
    return (1,) if os.environ.get(PROCESSOR_TIME) else (1, 2)


@cache
def as_installed() -> dict[str, str]:
    """The environment of a process that finds the program's bytecode, which every installation compiles."""
    for folder in ("truing", "schemas", "stages", "pipeline"):
        compileall.compile_dir(Path(__file__).parents[1] / folder, quiet=2)
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def run_pinned(module: str, arguments: list[str], threads: int) -> None:
    """Run a module in a process of its own that has so many processors, and so many threads in every library."""
    environment = {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, str(threads))}
    command = [sys.executable, "-m", module, *arguments, "--threads", str(threads)]
    subprocess.run(command, env=environment, check=True)


def pin(threads: int) -> None:
    """Keep this process on its last processors, as many as threads; nothing where the system cannot."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-threads:])


def threads_and_repeats(module: str, description: str) -> tuple[int, int, float] | None:
    """Threads, repeats and share of the full size that a command line asks for; None where processes of their own have
    measured."""
    arguments = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--repeats", type=int, default=9)
    arguments.add_argument("--threads", type=int, default=0, help="measure in this process, with so many threads")
    arguments.add_argument("--share", type=float, default=1.0, help="of the full sizes")
    given = arguments.parse_args()
    if given.threads:
        pin(given.threads)
        return given.threads, given.repeats, given.share
    for threads in thread_counts():
        run_pinned(module, ["--repeats", str(given.repeats), "--share", str(given.share)], threads)
    return None


def interleaved(
    tasks: dict[str, Callable[[], object]], repeats: int, clock: Callable[[], float] = seconds_now
) -> dict[str, np.ndarray]:
    """Return seconds (repeats,) per call of every task by a clock, one repeat of all after the other.

    Each is called once unmeasured, except for a single repeat, and within a repeat as often as fills 20 ms.
    """
    if repeats > 1:
        for task in tasks.values():
            task()
    first = {name: _seconds(task, 1, clock) for name, task in tasks.items()}
    calls = {name: 1 + int(_SHORTEST / first[name]) for name in tasks}
    long = {name for name in tasks if calls[name] == 1}  # the call that tells how long it takes is its first repeat
    runs = [
        {
            name: first[name] if repeat == 0 and name in long else _seconds(task, calls[name], clock) / calls[name]
            for name, task in tasks.items()
        }
        for repeat in range(repeats)
    ]
    return {name: np.array([run[name] for run in runs]) for name in tasks}


def _seconds(task: Callable[[], object], calls: int, clock: Callable[[], float]) -> float:
    start = clock()
    for _ in range(calls):
        task()
    return clock() - start


def spread(rates: np.ndarray) -> str:
    """Return 'minimum median maximum' of rates per second, with a common unit."""
    unit, name = (1e6, "M") if np.median(rates) >= 1e6 else (1e3, "k")
    low, middle, high = np.min(rates) / unit, np.median(rates) / unit, np.max(rates) / unit
    return f"{low:9.2f} {middle:9.2f} {high:9.2f} {name}/s"
