"""First answer of `truing power` for a planned campaign: python -m benchmarks.power [--poses 40 --repeats 3].

Processor seconds of the command for the sample telescope, cut to this many poses, all causes, by theory alone: what the
command prints and writes before it simulates campaigns. Loading the program is included.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row

SMALLEST = ("--poses", "8", "--repeats", "1")
_SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "telescope"


def planned(folder: Path, poses: int) -> Path:
    """The sample as a plan of its first poses, without points."""
    shutil.copytree(_SAMPLE, folder)
    (folder / "points.csv").unlink()
    head, *rows = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    (folder / "configurations.csv").write_text("\n".join([head, *rows[:poses]]) + "\n", encoding="utf-8")
    return folder


def first_answer(campaign: Path, out: Path) -> float:
    """Processor seconds of one call; raises CalledProcessError."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "truing.pipeline", "power", str(campaign), "--draws", "0", "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure it several times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        campaign = planned(Path(home) / "plan", options.poses)
        spent = [first_answer(campaign, Path(home) / "power.parquet") for _ in range(options.repeats)]
    print(f"{options.poses} poses, all causes: {min(spent):.1f} {np.median(spent):.1f} {max(spent):.1f} CPU s")
    what = f"truing power, {options.poses} poses, all causes: first answer, processor time"
    record_row(Row(what, float(np.median(spent)), "s", limit=60.0))


if __name__ == "__main__":
    main()
