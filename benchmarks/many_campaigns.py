"""Many campaigns in one call: python -m benchmarks.many_campaigns [--campaigns 1000 --workers 2 --scheduler local].

Processor time per campaign of one call of `truing run` on Dask, over that of a call for a single campaign; memory of
the largest process; bytes that one campaign sends over the network, reads and writes. Campaigns are drawn: base and
platform of six targets each in eight poses, other noise in each. Processor times count all processes of a call, starts
included. The benchmark fails if a campaign is missing in the table of all, or did not end well.
"""

from __future__ import annotations

import argparse
import pickle
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from benchmarks.rows import Row, record_row
from benchmarks.timing import as_installed
from truing.pipeline.run_campaign import JobPlan, RunOptions, StageSelection, run_job

SMALLEST = ("--campaigns", "2", "--singles", "1", "--workers", "1", "--scheduler", "", "--only", "ingest")
_POSES, _TARGETS, _SIGMA_MM = 8, 6, 0.005
_CAMPAIGN = """[campaign]
name = "{name}"
kind = "photogrammetry"

[bodies]
reference = "base"

[noise]
point_mm = {sigma}
"""


def write_campaign(folder: Path, number: int) -> Path:
    """A small campaign with noise of its own; the platform moves by a millimetre from pose to pose."""
    rng = np.random.default_rng(number)
    place = folder / f"c{number:04d}"
    place.mkdir(parents=True)
    (place / "campaign.toml").write_text(_CAMPAIGN.format(name=place.name, sigma=_SIGMA_MM))
    names = [f"{body},{body[0]}{k}" for body in ("base", "platform") for k in range(_TARGETS)]
    targets = rng.uniform(-200.0, 200.0, (2 * _TARGETS, 3))
    moves = np.zeros((_POSES, 2 * _TARGETS, 3))
    moves[:, _TARGETS:] = rng.normal(0.0, 1.0, (_POSES, 1, 3))
    seen = targets + moves + rng.normal(0.0, _SIGMA_MM, moves.shape)
    _write_points(place / "targets.csv", "body,target", dict(zip(names, targets, strict=True)))
    rows = {f"{pose},{name}": seen[pose, k] for pose in range(_POSES) for k, name in enumerate(names)}
    _write_points(place / "points.csv", "pose,body,target", rows)
    return place


def _write_points(file: Path, heads: str, rows: dict[str, np.ndarray]) -> None:
    lines = [f"{name},{x:.4f},{y:.4f},{z:.4f}\n" for name, (x, y, z) in rows.items()]
    file.write_text(f"{heads},x_mm,y_mm,z_mm\n{''.join(lines)}")


@dataclass(frozen=True)
class Call:
    """Processor time of all processes of a call, and the peak memory of the largest one."""

    processor_s: float
    peak_mb: float


def call(places: Sequence[Path], out: Path, *words: str) -> Call:
    """Run campaigns by the command line; raises CalledProcessError."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "truing.pipeline", "run", *map(str, places), "--out", str(out), "-q", *words]
    subprocess.run(command, check=True, env=as_installed())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Call(spent, after.ru_maxrss / 1024.0)


def sent_bytes(place: Path, out: Path, stage: str | None) -> int:
    """Bytes of a campaign's task, up to a stage or whole, and of its result, as they go over the network."""
    job = JobPlan(out, RunOptions(StageSelection(only=stage)), several=True).job(place)
    return len(pickle.dumps(job)) + len(pickle.dumps(run_job(job)))


def size_of(folder: Path) -> int:
    """Bytes of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def measure(campaigns: int, singles: int, words: Sequence[str], stage: str | None) -> None:
    """Print and record all figures of runs up to a stage, None for whole runs."""
    only = () if stage is None else ("--only", stage)
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        places = [write_campaign(folder / "campaigns", number) for number in range(campaigns)]
        single = float(np.median([call(places[:1], folder / f"single{k}", *only).processor_s for k in range(singles)]))
        whole = call(places, folder / "all", *words, *only)
        _check(folder / "all", campaigns)
        each = whole.processor_s / campaigns
        own, how = f"{campaigns:,} campaigns in one call", " ".join(words) or "one process"
        print(f"{own} ({how}): {each:.2f} CPU s each; one alone {single:.2f} CPU s; ratio {each / single:.2f}")
        record_row(Row(f"{own}: processor time of each over that of one alone", each / single, "", limit=1.2))
        record_row(Row(f"{own}: processor time of each", each, "s"))
        record_row(Row(f"{own}: memory of the largest process", whole.peak_mb, "MB"))
        record_row(Row("one campaign over the network", sent_bytes(places[0], folder / "here", stage) / 1e3, "kB"))
        record_row(Row("one campaign read from disk", size_of(places[0]) / 1e3, "kB"))
        record_row(Row("one campaign written to disk", size_of(folder / "single0") / 1e6, "MB"))


def _check(out: Path, campaigns: int) -> None:
    """Raise RuntimeError unless all campaigns ended well."""
    codes = pq.read_table(out / "campaigns.parquet")["exit_code"].to_pylist()
    if codes != [0] * campaigns:
        raise RuntimeError(f"found {codes.count(0)} good campaigns among {len(codes)}; expected {campaigns}")


def main() -> None:
    """Measure one call of many campaigns."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=1000)
    parser.add_argument("--singles", type=int, default=3, help="calls of a single campaign")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scheduler", default="local", help="as of `truing run`; empty: processes without Dask")
    parser.add_argument("--only", metavar="STAGE", help="run up to this stage; absent: all stages")
    options = parser.parse_args()
    scheduler = ["--scheduler", options.scheduler] if options.scheduler else []
    measure(options.campaigns, options.singles, ["--workers", str(options.workers), *scheduler], options.only)


if __name__ == "__main__":
    main()
