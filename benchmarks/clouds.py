"""Poses of millions of points: processor time and memory of each stage, and the cost of a further point.

    python -m benchmarks.clouds [--points 500000 2000000 10000000] [--no-survey] [--folder DIR]

A base of 20 targets and a platform of 40 are measured in as many poses as the points require. The noise is 5 um; two of
a thousand points have gross errors. Each stage is a run of `truing run --only` in a process of its own: its processor
seconds contain the start of the program; peaks are those of the whole process by the operating system. The cost of a
further point is the difference to the size before: it stays the same where the cost is linear. Every row of poses and
residuals is counted.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row
from benchmarks.timing import as_installed

STAGES = ("ingest", "qa", "pose")
TARGETS, OF_BASE = 60, 20
SMALLEST = ("--points", "600")
_GOAL = (10_000_000, 60.0, 1000.0)  # points, s on two processors, MB
_NOISE_MM, _GROSS, _GROSS_MM = 0.005, 0.002, 3.0

_CAMPAIGN = """
[campaign]
name = "many poses"
kind = "photogrammetry"
[bodies]
reference = "base"
[noise]
point_mm = 0.005
"""


@dataclass(frozen=True)
class Cost:
    """One stage on a number of points: wall and processor time in s, peak memory in MB."""

    stage: str
    points: int
    wall: float
    cpu: float
    peak: float


def make_campaign(folder: Path, points: int, *, survey: bool = True, seed: int = 20) -> int:
    """Write a campaign of about this many points; returns their number."""
    import pyarrow as pa
    import pyarrow.csv as pc

    rng, poses = np.random.default_rng(seed), -(-points // TARGETS)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(_CAMPAIGN)
    plain = pc.WriteOptions(quoting_style="none")
    number = np.arange(1, poses + 1)
    role = pa.array(["calibration"]).take(pa.array(np.zeros(poses, np.int32)))
    pc.write_csv(
        pa.table({"pose": number, "role": role, "time_s": 10.0 * number}), folder / "configurations.csv", plain
    )
    place = rng.uniform(-200.0, 200.0, (TARGETS, 3))
    body = np.where(np.arange(TARGETS) < OF_BASE, "base", "platform")
    names = {"body": body, "target": np.array([f"T{k:02d}" for k in range(TARGETS)])}
    if survey:
        known = place + 0.4 * _NOISE_MM * rng.normal(size=place.shape)
        columns = {f"{axis}_mm": known[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"sigma_{axis}_mm": np.full(TARGETS, 0.4 * _NOISE_MM) for axis in "xyz"}
        pc.write_csv(pa.table({**names, **columns}), folder / "targets.csv", plain)
    schema = pa.schema([("pose", pa.int64()), ("body", "string"), ("target", "string")])
    schema = pa.schema([*schema, *(pa.field(f"{axis}_mm", pa.float64()) for axis in "xyz")])
    with pc.CSVWriter(folder / "points.csv", schema, write_options=plain) as file:
        for first in range(0, poses, 5000):
            some = number[first : first + 5000]
            xyz = np.round(_measured(place, len(some), rng).reshape(-1, 3), 4)
            columns = {
                "pose": np.repeat(some, TARGETS),
                **{name: np.tile(own, len(some)) for name, own in names.items()},
            }
            file.write_table(pa.table({**columns, **{f"{a}_mm": xyz[:, k] for k, a in enumerate("xyz")}}, schema))
    return poses * TARGETS


def _measured(place: np.ndarray, poses: int, rng: np.random.Generator) -> np.ndarray:
    """Return points (poses, TARGETS, 3) in mm: the platform moves before the base, both before the instrument."""
    from truing.estimation.rotation import exp_so3

    moved = np.broadcast_to(place, (poses, TARGETS, 3)).copy()
    for rows, turn, shift in ((slice(OF_BASE, None), 0.05, 20.0), (slice(None), 0.5, 1000.0)):
        R = exp_so3(turn * rng.normal(size=(poses, 3)))
        moved[:, rows] = moved[:, rows] @ np.swapaxes(R, 1, 2) + shift * rng.normal(size=(poses, 1, 3))
    moved += _NOISE_MM * rng.normal(size=moved.shape)
    gross = rng.random(moved.shape[:2]) < _GROSS
    moved[gross] += _GROSS_MM * rng.normal(size=(int(gross.sum()), 3))
    return moved


def measure(campaign: Path, out: Path, points: int) -> Iterator[Cost]:
    """Run the stages one after the other, each in a process of its own; raises if one fails or leaves rows out."""
    import pyarrow.parquet as pq

    for stage in STAGES:
        command = [sys.executable, "-m", "truing.pipeline", "run", str(campaign), "--out", str(out), "--only", stage]
        started = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, env=as_installed()) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
        peak = used.ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)
        yield Cost(stage, points, time.perf_counter() - started, used.ru_utime + used.ru_stime, peak)
    found = [pq.read_metadata(out / f"{name}.parquet").num_rows for name in ("residuals", "poses")]
    if found[0] != points or found[1] % (points // TARGETS):
        raise ValueError(f"found {found[0]} residuals and {found[1]} poses, expected {points} points")


def compare(folder: Path, sizes: Sequence[int], *, survey: bool = True) -> list[Cost]:
    """Measure all sizes in turn, and print each with the cost of a further point."""
    costs: list[Cost] = []
    print(f"{'points':>12} {'stage':8} {'wall s':>8} {'CPU s':>8} {'peak MB':>8} {'us per further point':>22}")
    for size in sizes:
        points = make_campaign(folder / f"{size}", size, survey=survey)
        for cost in measure(folder / f"{size}", folder / f"run-{size}", points):
            before = next((one for one in reversed(costs) if one.stage == cost.stage), None)
            costs.append(cost)
            more = "" if before is None else f"{1e6 * (cost.cpu - before.cpu) / (points - before.points):22.2f}"
            print(f"{points:12,} {cost.stage:8} {cost.wall:8.2f} {cost.cpu:8.2f} {cost.peak:8.0f} {more}", flush=True)
    _record_rows([cost for cost in costs if cost.points == max(cost.points for cost in costs)])
    return costs


def _record_rows(largest: Sequence[Cost]) -> None:
    points, seconds, memory = _GOAL
    is_goal = largest[0].points >= points
    what = f"poses of {largest[0].points:,} points: "
    record_row(Row(f"{what}all stages", sum(one.wall for one in largest), "s", limit=seconds if is_goal else None))
    record_row(Row(f"{what}peak memory", max(one.peak for one in largest), "MB", limit=memory if is_goal else None))


def main() -> None:
    """Measure the sizes of the command line."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--points", type=int, nargs="+", default=[500_000, 2_000_000, 10_000_000])
    arguments.add_argument("--no-survey", action="store_true", help="bodies without a survey: the shape is estimated")
    arguments.add_argument("--folder", type=Path, default=None, help="where files are made; kept if given")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        compare(given.folder or Path(temporary), given.points, survey=not given.no_survey)


if __name__ == "__main__":
    main()
