"""Processor time of the whole pipeline, stage by stage, and of the diagnosis of a long bench: python -m
benchmarks.line.

Every campaign runs in a process of its own, as `truing run` does. Processor time (user and system) is reported by
stage, because it depends less on other processes than wall-clock time; both are reported for the whole. Memory is the
largest that the operating system counted.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row
from benchmarks.timing import as_installed
from tests.blind.generator.axis import draw_layout, record
from tests.blind.generator.axis import write as write_axis
from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.effects import LoadEccentricity
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.force_sensor import LAYOUT
from tests.blind.generator.sensor.layout import AXES
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.campaign_run import CampaignRun
from truing.pipeline.entry import main as run_truing

SAMPLES = ("telescope", "force-sensor", "robot")
BENCH = "bench"
SMALLEST = ("--smallest",)
_SECONDS = 5.0  # limit of a sample, by the clock
_MEMORY_MB = 600.0  # limit of the bench
REPEATS = 2  # of every run of the force sensor's programme: 1,512 load steps
_BYTES_PER_UNIT = 1 if sys.platform == "darwin" else 1024  # of the largest memory, as the system counts it


@dataclass(frozen=True)
class Line:
    """One run: processor seconds by stage and of the whole process, seconds by the clock, largest memory in bytes."""

    stages: dict[str, float]
    processor_s: float
    clock_s: float
    memory: int


def write_bench(folder: Path, repeats: int = REPEATS) -> Path:
    """Write the force sensor's campaign with every run repeated: 756 load steps of seven channels each time."""
    layout = replace(LAYOUT, name=BENCH, programme=replace(LAYOUT.programme, repeats=repeats))
    offset = LoadEccentricity(AXES.index("fz"), (0.012, -0.008, 0.0))
    folder.mkdir(parents=True, exist_ok=True)
    write_campaign(draw_campaign(layout, [offset], np.random.default_rng(5)), folder, 5)
    return folder


def measure(campaign: Path, out: Path) -> Line:
    """Run a campaign in a process of its own, every stage anew."""
    command = [sys.executable, "-m", "benchmarks.line", "--one", str(campaign), "--out", str(out)]
    # As `truing run` sets before it loads numpy, which this module has loaded.
    environment = {**as_installed(), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return Line(**json.loads(done.stdout.splitlines()[-1]))


def _one(campaign: Path, out: Path) -> Line:
    """Run a campaign in this process."""
    started = time.perf_counter()
    with _reported_stages() as stages:
        sys.argv = ["truing", "run", str(campaign), "--out", str(out), "--force", "--quiet", "--qa", "warn"]
        try:
            run_truing()
        except SystemExit as end:
            if end.code:
                raise
    used = resource.getrusage(resource.RUSAGE_SELF)
    memory = used.ru_maxrss * _BYTES_PER_UNIT
    return Line(stages, used.ru_utime + used.ru_stime, time.perf_counter() - started, memory)


@contextmanager
def _reported_stages() -> Iterator[dict[str, float]]:
    """Note the processor seconds of every stage that is executed inside this context."""
    seconds: dict[str, float] = {}
    execute = CampaignRun.execute

    def timed(self: CampaignRun, stage: object, *more: object) -> str:
        before = time.process_time()
        words = execute(self, stage, *more)  # type: ignore[arg-type]
        seconds[stage.name] = time.process_time() - before  # type: ignore[attr-defined]
        return words

    CampaignRun.execute = timed  # type: ignore[assignment,method-assign]
    try:
        yield seconds
    finally:
        CampaignRun.execute = execute  # type: ignore[method-assign]


def table(lines: dict[str, Line]) -> str:
    """Put lines side by side: a row for each stage, for the whole, for the clock, and for memory."""
    names = list(dict.fromkeys(name for line in lines.values() for name in line.stages))
    rows = [(f"{name}, CPU s", [f"{line.stages.get(name, 0.0):.2f}" for line in lines.values()]) for name in names]
    rows.append(("whole, CPU s", [f"{line.processor_s:.2f}" for line in lines.values()]))
    rows.append(("whole, s by the clock", [f"{line.clock_s:.2f}" for line in lines.values()]))
    rows.append(("largest memory, MB", [f"{line.memory / 1e6:.0f}" for line in lines.values()]))
    head = f"{'':24}" + "".join(f"{name:>14}" for name in lines)
    return "\n".join([head, *(f"{words:24}" + "".join(f"{cell:>14}" for cell in cells) for words, cells in rows)])


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the samples and the bench."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaigns", nargs="*", type=Path, help="default: the samples, and the bench")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of each run of the bench (756 load steps each)")
    parser.add_argument("--smallest", action="store_true", help="one axis of some ten positions alone")
    parser.add_argument("--one", type=Path, help="run this campaign here, and print its figures as JSON")
    parser.add_argument("--out", type=Path, help="folder of that run")
    options = parser.parse_args(arguments)
    if options.one is not None:
        print(json.dumps(vars(_one(options.one, options.out))))
        return
    with tempfile.TemporaryDirectory() as home:
        if options.smallest:
            rng = np.random.default_rng(1)
            folders = [write_axis(record(draw_layout(rng), (), rng), Path(home) / "axis")]
        else:
            folders = options.campaigns or [
                *(Path("sample_data") / name for name in SAMPLES),
                write_bench(Path(home) / BENCH, options.repeats),
            ]
        names = [open_campaign(folder).name for folder in folders]
        lines = {name: measure(folder, Path(home) / "runs" / name) for name, folder in zip(names, folders, strict=True)}
    print(table(lines))
    for name, line in lines.items():
        is_bench = name == BENCH
        record_row(Row(f"whole line of {name}", line.clock_s, "s", limit=None if is_bench else _SECONDS))
        record_row(
            Row(f"whole line of {name}: memory", line.memory / 1e6, "MB", limit=_MEMORY_MB if is_bench else None)
        )


if __name__ == "__main__":
    main()
