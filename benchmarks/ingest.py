"""Ingest of ten million points compared with bare conversions of the same file to Parquet.

    python -m benchmarks.ingest [--rows 10000000] [--repeats 5] [--folder DIR]

Ours reads, maps, checks (finite numbers, unknown poses, duplicate points, missing bodies, units) and writes with its
provenance; the peers parse and write. Every run is a process of its own; runs are interleaved and pinned to the same
cores, all with Snappy. Peaks are VmHWM of the whole process. A row that did not write every point prints no figure.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row, timed_row
from benchmarks.timing import PROCESSOR_TIME, as_installed, thread_counts

SMALLEST = ("--rows", "600", "--repeats", "1")
_OURS = "truing ingest"
_TARGETS = 60

_MEASURE = """
import os, sys, time
wall, cpu = time.perf_counter(), time.process_time()
{body}
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
peak = next((line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")), "0")
import pyarrow.parquet as pq
print(wall, cpu, peak, pq.read_metadata(sys.argv[2]).num_rows)
"""

_PROGRAMS = {
    "truing ingest": """
from pathlib import Path
from truing.pipeline.artifacts import Stamp, write_artifacts
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.campaign import read_campaign
from truing.stages.ingest import DECLARATION, run
from truing.formats.source import CampaignFiles
import tomllib
folder, out = Path(sys.argv[1]), Path(sys.argv[2])
campaign = read_campaign(tomllib.loads((folder / "campaign.toml").read_text()))
source = CampaignFiles(folder, campaign, out.parent)
outcome = run({}, SettingsView(campaign, DECLARATION.settings), lambda *_: None, source)
write_artifacts(out.parent, outcome.artifacts, Stamp("ingest", "0", "benchmark", "0", tuple(outcome.artifacts)), ())
""",
    "polars scan + sink": """
import polars as pl
pl.scan_csv(sys.argv[1] + "/points.csv").sink_parquet(sys.argv[2], compression="snappy")
""",
    "duckdb copy": """
import duckdb
duckdb.sql(f"copy (from '{sys.argv[1]}/points.csv') to '{sys.argv[2]}' (format parquet, codec 'snappy')")
""",
    "pyarrow open_csv": """
import pyarrow.csv as pc, pyarrow.parquet as pq
reader = pc.open_csv(sys.argv[1] + "/points.csv")
with pq.ParquetWriter(sys.argv[2], reader.schema, compression="snappy") as writer:
    for batch in reader:
        writer.write_batch(batch)
""",
}

_CAMPAIGN = """
[campaign]
name = "many points"
kind = "photogrammetry"
[bodies]
reference = "base"
[noise]
point_mm = 0.005
"""


def make_campaign(folder: Path, rows: int) -> int:
    """A campaign of base and platform with 60 targets and a table of configurations; returns its number of points."""
    rng = np.random.default_rng(20)
    poses = -(-rows // _TARGETS)
    (folder / "campaign.toml").write_text(_CAMPAIGN)
    with (folder / "configurations.csv").open("w") as file:
        file.write("pose,role,time_s\n")
        file.writelines(f"{pose},calibration,{10.0 * pose}\n" for pose in range(1, poses + 1))
    place = rng.uniform(-200.0, 200.0, (_TARGETS, 3))
    names = [f"base,B{i:02d}" if i < 20 else f"platform,P{i:02d}" for i in range(_TARGETS)]
    with (folder / "points.csv").open("w") as file:
        file.write("pose,body,target,x_mm,y_mm,z_mm\n")
        for pose in range(1, poses + 1):
            seen = (place + rng.normal(0.0, 0.5, place.shape)).tolist()
            file.writelines(
                f"{pose},{name},{x:.4f},{y:.4f},{z:.4f}\n" for name, (x, y, z) in zip(names, seen, strict=True)
            )
    return poses * _TARGETS


def measure(name: str, folder: Path, threads: int) -> tuple[float, float, float, int]:
    """Wall and processor seconds, peak memory in MB and rows written, of one run in a process of its own."""
    with tempfile.TemporaryDirectory(dir=folder) as out:
        program = _MEASURE.format(body=textwrap.dedent(_PROGRAMS[name]))
        environment = {**as_installed(), "POLARS_MAX_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
        command = [sys.executable, "-c", program, str(folder), str(Path(out) / "observations.parquet")]
        if hasattr(os, "sched_setaffinity"):
            command = [sys.executable, "-c", _pinned(threads), *command]
        text = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
    wall, cpu, peak, rows = text.splitlines()[-1].split()
    return float(wall), float(cpu), int(peak) / 1024.0, int(rows)


def _pinned(threads: int) -> str:
    cores = sorted(os.sched_getaffinity(0))[:threads]
    return f"import os, sys; os.sched_setaffinity(0, {cores}); os.execv(sys.argv[1], sys.argv[1:])"


def compare(folder: Path, rows: int, repeats: int, threads: int) -> None:
    """Interleaved runs of all, printed with medians and ranges, and the ratio to the fastest peer."""
    runs = [{name: measure(name, folder, threads) for name in _PROGRAMS} for _ in range(repeats)]
    spent = 1 if os.environ.get(PROCESSOR_TIME) else 0
    seconds = {name: np.array([run[name][spent] for run in runs]) for name in _PROGRAMS}
    missed = {name for run in runs for name in _PROGRAMS if run[name][3] != rows}
    what = f"ingest of {rows:,} points, {threads} thread(s)"
    record_row(timed_row(what, seconds, _OURS, missed=missed, unit="s", least_ratio=0.9))
    record_row(Row(f"{what}: peak memory", max(run[_OURS][2] for run in runs), "MB"))
    print(f"\n{rows:,} rows, {threads} thread{'s' if threads > 1 else ''}, {repeats} interleaved repeats")
    print(f"{'':20} {'rows/s (median)':>16} {'min':>7} {'max':>7} {'CPU s':>6} {'peak MB':>8}")
    for name in _PROGRAMS:
        of_name = [run[name] for run in runs]
        if any(run[3] != rows for run in of_name):
            print(f"{name:20} did not write every row")
            continue
        speed = [rows / wall / 1e6 for wall, _, _, _ in of_name]
        cpu, peak = np.median([run[1] for run in of_name]), max(run[2] for run in of_name)
        print(f"{name:20} {np.median(speed):14.2f} M {min(speed):5.2f} M {max(speed):5.2f} M {cpu:6.2f} {peak:8.0f}")
    ratios = [run["polars scan + sink"][0] / run["truing ingest"][0] for run in runs]
    print(f"speed of truing over polars: {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


def main() -> None:
    """Make the file once, then measure with two threads and with one."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--rows", type=int, default=10_000_000)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--folder", type=Path, default=None, help="where the files are made; kept if given")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        rows = make_campaign(folder, given.rows)
        for threads in reversed(thread_counts()):
            compare(folder, rows, given.repeats, threads)


if __name__ == "__main__":
    main()
