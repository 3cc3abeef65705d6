"""Spoil good campaigns by hand, many times: ``python -m tests.belonging FIRST LAST [SLIP]``; prints counts."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from tests.belonging.load_slips import SLIPS, Tables
from tests.belonging.load_slips_reported import RIGHT, counted, judge
from tests.blind.generator.sensor.case import hide, layouts_for
from truing.schemas.faults import CampaignFaults

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "force-sensor"


def spoil_many(first: int, last: int, only: str = "") -> Counter[tuple[str, str]]:
    """Every slip in the sample (even seeds) or in a blind campaign, with seeds first to last - 1."""
    reported: Counter[tuple[str, str]] = Counter()
    for seed in range(first, last):
        with tempfile.TemporaryDirectory() as place:
            good = Path(place) / "good"
            if seed % 4 == 0:
                shutil.copytree(SAMPLE, good)
            else:
                kinds = layouts_for(())
                hide((), kinds[seed % len(kinds)], 8.0, seed).write(good)
            for number, (name, spoil) in enumerate(SLIPS.items()):
                if only not in name:
                    continue
                bad = Path(place) / f"bad-{number}"
                shutil.copytree(good, bad)
                tables = Tables(bad)
                made = spoil(tables, np.random.default_rng([seed, number]))
                if made is None:
                    continue
                tables.write()
                try:
                    found = judge(bad, made)
                    how, rows = found.how, found.rows
                except CampaignFaults:
                    how, rows = "refused", []
                reported[name, how] += 1
                if how not in (RIGHT, "refused"):
                    said = "; ".join(f"{row['state']} {row['reason_code']} {row['slips']}" for row in rows)
                    sys.stderr.write(f"{seed} {name} -> {how} | {made.subjects} {made.factor} | {said[:400]}\n")
    return reported


if __name__ == "__main__":
    sys.stdout.write(counted(spoil_many(int(sys.argv[1]), int(sys.argv[2]), " ".join(sys.argv[3:]))) + "\n")
