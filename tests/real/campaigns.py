"""Campaigns of real measurements: their folders, and a run of each through the command line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
DEFAULT_DATA = "../../../../shared/data"  # as the campaigns reach it from their own folder
# One thread, for others run next to it; and large arrays, which come and go, keep their pages (glibc; else unheeded).
FRUGAL = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": "1000000000",
    "MALLOC_TRIM_THRESHOLD_": "2000000000",
}
# The longest first, one to a call; all others share one, and what a call takes to start.
LONG = ("so-lat-vstars", "irb120-faro", "so-lat-stability")
# Campaigns of seconds run in this process, as far as their figures need: the stages that are asked for by name.
BRIEF = {
    "fareke-file1": ("qa",),
    "fareke-file2": ("qa", "calibrate"),
    "fareke-file3": ("qa",),
    "optical-ft-ur3e": ("calibrate",),
    "sps01-stewart-force": ("calibrate",),
    "sios-nmm-quadrature": ("qa",),
    "ess-slit-iso230": ("deformation", "diagnose"),
}
NAMES = tuple(sorted(path.parent.name for path in HERE.glob("*/campaign.toml")))


def data_folder() -> Path:
    """Folder of the real measurements: TRUING_REAL_DATA, by default next to the project."""
    return Path(os.environ.get("TRUING_REAL_DATA", PROJECT.parent / "shared" / "data")).resolve()


def prepare(name: str, folder: Path) -> Path:
    """A copy of a campaign's own files whose paths lead to the data, wherever they lie."""
    copy = folder / name
    shutil.copytree(HERE / name, copy)
    text = (copy / "campaign.toml").read_text(encoding="utf-8")
    (copy / "campaign.toml").write_text(text.replace(DEFAULT_DATA, data_folder().as_posix()), encoding="utf-8")
    return copy


def run_all(names: Sequence[str], folder: Path) -> None:
    """Run every campaign, two calls at a time, the longest first."""
    calls = [[name] for name in LONG if name in names]
    calls.append([name for name in names if name not in (*LONG, *BRIEF)])
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda own: run(own, folder), filter(None, calls)))
    for name in names:
        if name in BRIEF:
            run_here(name, folder, BRIEF[name])


def run_here(name: str, folder: Path, stages: Sequence[str]) -> None:
    """Bring some stages of a campaign about, and what they need."""
    from truing.pipeline.console import RunConsole
    from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaign, usable_campaign

    campaign, out = usable_campaign(prepare(name, folder)), folder / "runs" / name
    for stage in stages:
        wish = RunOptions(StageSelection(only=stage), accept_failed_checks=True)
        run_campaign(campaign, out, wish, RunConsole(quiet=True))


def tables_of(names: Sequence[str], folder: Path) -> dict[str, dict[str, pd.DataFrame]]:
    """Every table that the runs of campaigns left in a folder."""
    files = {name: _place(name, folder).glob("*.parquet") for name in names}
    return {name: {path.stem: pd.read_parquet(path) for path in own} for name, own in files.items()}


def _place(name: str, folder: Path) -> Path:
    several = folder / "runs" / "several" / name
    return several if several.is_dir() else folder / "runs" / name


def run(names: Sequence[str], folder: Path) -> None:
    """Run campaigns in one call, from their raw files to their reports."""
    out = folder / "runs" / (names[0] if len(names) == 1 else "several")
    places = [str(prepare(name, folder)) for name in names]
    command = [sys.executable, "-m", "pipeline", "run", *places, "--out", str(out), "--qa=warn", "--quiet"]
    done = subprocess.run(command, cwd=PROJECT, env=os.environ | FRUGAL, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{', '.join(names)} ended with {done.returncode}:\n{done.stderr}")
    assert all((_place(name, folder) / "report.html").is_file() for name in names)
