"""The good campaigns that the broken ones are made from: short cuts of the samples, in which nothing is wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.conftest import PROJECT
from tests.cut_telescope import cut_telescope

BENCH = PROJECT / "sample_data" / "force-sensor"
_OWN_CHANNEL = {("fx", "dx"), ("fy", "dy"), ("fz", "dz"), ("mx", "rx"), ("my", "ry"), ("mz", "rz")}


def telescope(folder: Path) -> Path:
    """A telescope in nine poses."""
    return cut_telescope(folder)


def bench(folder: Path) -> Path:
    """A force sensor loaded along each axis once, its own channel watched."""
    shutil.copytree(BENCH, folder)
    header, *rows = (folder / "interferometer.csv").read_text().splitlines()
    kept = [row for row in rows if tuple(row.split(",")[i] for i in (3, 5)) in _OWN_CHANNEL]
    (folder / "interferometer.csv").write_text("\n".join([header, *kept]) + "\n")
    runs = {row.split(",")[0] for row in kept}
    header, *rows = (folder / "signals.csv").read_text().splitlines()
    signals = [row for row in rows if row.split(",")[0] in runs]
    (folder / "signals.csv").write_text("\n".join([header, *signals]) + "\n")
    return folder


CAMPAIGNS = {"telescope": telescope, "bench": bench}
