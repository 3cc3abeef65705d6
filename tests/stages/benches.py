"""Loaded sensors of the independent generator, processed by the stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.effects import Effect
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import ARCSEC, CHANNELS, LOADS, Layout, Programme, Tolerance
from tests.stages.line import run_line
from truing.stages.declaration import Outcome

MOVED = ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad")
SI = np.array([1e-3] * 3 + [1.0] * 3)
READING_SI = np.array([1e-6] * 3 + [ARCSEC] * 3)
DEFORMATION = ("ingest", "pose", "deformation")
TOLERANCE = Tolerance(stiffness=0.02)


@dataclass(frozen=True)
class Bench:
    """A drawn bench campaign, and the results of the stages."""

    folder: Path
    drawn: Campaign
    tables: dict[str, Any]
    outcomes: dict[str, Outcome]

    def frame(self, name: str) -> pd.DataFrame:
        """A table as a frame."""
        return self.tables[name].to_pandas()

    @property
    def compliance(self) -> np.ndarray:
        """The true compliance (6, 6)."""
        return self.drawn.truth.machine.compliance


def layout(channels: str = "separate", **changes: Any) -> Layout:
    """A bench with uncertain legs; ``programme`` is replaced as a whole."""
    return Layout(**{"name": "bench", "tolerance": TOLERANCE, "programme": Programme(channels=channels), **changes})


def bench(
    folder: Path, made: Layout, seed: int, effects: Sequence[Effect] = (), stages: Sequence[str] = DEFORMATION
) -> Bench:
    """A campaign written to a folder and run through stages."""
    drawn = draw_campaign(made, effects, np.random.default_rng(seed))
    write_campaign(drawn, folder, seed)
    tables, outcomes = run_line(folder, *stages)
    return Bench(folder, drawn, tables, outcomes)


def case_errors(made: Bench) -> np.ndarray:
    """Displacements (K, 6) of the load cases less the true ones, over their sigmas; NaN where unknown."""
    cases = made.frame("displacement")
    true = cases[list(LOADS)].to_numpy() @ made.compliance.T
    sigma = np.sqrt(np.stack([cases[f"cov_{k}_{k}"].to_numpy() for k in range(6)], axis=1))
    return (cases[list(MOVED)].to_numpy() * SI - true) / sigma


def entry_errors(made: Bench, model: str = "matrix") -> np.ndarray:
    """Entries of a measured compliance less the true ones, over their sigmas."""
    rows = made.frame("compliance")
    rows = rows[rows["model"] == model]
    i = [CHANNELS.index(name) for name in rows["response"]]
    j = [("fx", "fy", "fz", "mx", "my", "mz").index(name) for name in rows["load"]]
    return ((rows["coefficient"] - made.compliance[i, j]) / rows["sigma"]).to_numpy()


def bench_with_a_gross_error(folder: Path) -> Path:
    """A small bench loaded along z and about x; its reading dz at step 7 of run 1 is 40 um off."""
    small = Layout("by-hand", tolerance=TOLERANCE, programme=Programme(axes=("fz", "mx")), signals=6)
    write_campaign(draw_campaign(small, [], np.random.default_rng(3)), folder, 1)
    readings = pd.read_csv(folder / "interferometer.csv")
    wrong = (readings["run"] == 1) & (readings["step"] == 7) & (readings["channel"] == "dz")
    readings.loc[wrong, "reading"] += 40.0
    readings.to_csv(folder / "interferometer.csv", index=False)
    return folder
