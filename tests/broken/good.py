"""Good campaigns that the broken ones are made from: shortened samples without any fault."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

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


def axis(folder: Path) -> Path:
    """Positioning runs of an axis: six targets up and down in five cycles, in the order taken."""
    folder.mkdir(parents=True)
    rng, rows = np.random.default_rng(230), []
    for cycle in range(1, 6):
        for way, side, targets in (("forward", 0.002, range(6)), ("backward", -0.002, reversed(range(6)))):
            for k in targets:
                at = 100.0 * k + 10.0 + 0.004 * np.sin(k) + side + rng.normal(0.0, 0.0005)
                rows.append(f"X,{100 * k + 10},{way},{cycle},{at:.4f}")
    (folder / "positioning.csv").write_text("\n".join(["run,target_mm,direction,cycle,position_mm", *rows]) + "\n")
    (folder / "campaign.toml").write_text('[campaign]\nname = "axis"\nkind = "interferometer"\n')
    return folder


CAMPAIGNS = {"telescope": telescope, "bench": bench, "axis": axis}
