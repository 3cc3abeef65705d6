"""Tables of docs/diagnosis.md: the diagnosis of the sample campaign, and the number of draws that its search needs.

python -m docs.experiments.diagnosis
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq

from docs.experiments.calibration import run_folder
from docs.experiments.marked_tables import renew, table

if TYPE_CHECKING:
    from truing.inference.selection import CauseDiagnosis

DOCS = Path(__file__).resolve().parents[1]
CAMPAIGN = DOCS.parent / "sample_data" / "telescope"
_SHOWN = 5  # rows of the diagnosis
DRAWS, SEEDS = (100, 400, 1600), 6


@cache
def sample() -> CauseDiagnosis:
    """Return all that is decided on the sample campaign."""
    from tests.stages.line import run_line
    from truing.schemas.campaign import read_campaign
    from truing.stages.diagnosis.search import assembled_data, search_causes

    settings = read_campaign(tomllib.loads((CAMPAIGN / "campaign.toml").read_text(encoding="utf-8")))
    return search_causes(assembled_data(run_line(CAMPAIGN, "ingest", "pose")[0], settings), settings, lambda *_: None)


def _left(name: str) -> list[dict[str, Any]]:
    """Return the rows of a table that a run of the sample leaves."""
    rows: list[dict[str, Any]] = pq.read_table(run_folder("diagnose") / f"{name}.parquet").to_pylist()
    return rows


def sample_table() -> str:
    """Return the first rows of the sample's diagnosis."""
    heads = ["", "verdict", "p", "probability", "log10 odds", "signal to noise", "rms, µm", "held out, µm", "floor, µm"]
    rows = []
    for row in _left("diagnosis")[:_SHOWN]:
        rms = [f"{row[f'{kind}rms_before']:.2f} → {row[f'{kind}rms_after']:.2f}" for kind in ("", "heldout_")]
        odds = f"{row['log_evidence'] / np.log(10):.1f}"
        numbers = [f"{row['p_value']:.2g}", f"{row['probability']:.2f}", odds, f"{row['signal_to_noise']:.1f}"]
        name = f"`{row['cause']}` {row['subject']}".strip()
        rows.append([name, row["verdict"], *numbers, *rms, f"{row['noise_floor']:.2f}"])
    return table(heads, rows)


def pulls_table() -> str:
    """Return the sums of squared pulls without and with what was found."""
    rows = [
        [row["model"], f"{row['chi_square']:.0f}", str(row["freedom"]), f"{row['lower']:.0f} to {row['upper']:.0f}"]
        for row in _left("pull_sums")
    ]
    return table(["model", "pulls squared, summed", "independent", "95 % band"], rows)


@cache
def signal_needed(draws: int) -> tuple[float, float]:
    """Return the signal-to-noise from which the best gain of one leg is found, mean and scatter over seeds."""
    from scipy.special import fdtri

    level = 0.45 * 0.05
    found = []
    for seed in range(SEEDS):
        closing = sample().search
        search = replace(closing, draws=draws, rng=np.random.default_rng(seed))
        group = search.null.group_of("actuator-gain", 1)
        limit = search.null.threshold(group, level)
        freedom = search.noise.freedom(group.input_share)
        found.append(float(np.sqrt(fdtri(1, freedom - 1, 1.0 - limit))))
    return float(np.mean(found)), float(np.std(found, ddof=1))


def draws_table() -> str:
    """Return the table of the signal-to-noise ratio needed for acceptance, by number of draws."""
    rows = [
        [str(draws), f"{mean:.2f}", f"{scatter:.2f}"] for draws in DRAWS for mean, scatter in [signal_needed(draws)]
    ]
    return table(["draws", "signal to noise needed", "scatter between seeds"], rows)


TABLES = {"sample": sample_table, "pulls": pulls_table, "draws": draws_table}

if __name__ == "__main__":
    renew(DOCS / "diagnosis.md", TABLES)
