"""A wave of a wrong period that imitates a scale error and a wave is replaced by both, next to the other causes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.stages.line import run_line

TARGETS = np.array([0, 37, 81, 118, 163, 205, 244, 289, 331, 370, 418, 452, 500.0])
TOML = """
[campaign]
name = "axis"
kind = "photogrammetry"
[mechanism]
type = "axis"
kind = "linear"
command = "command_mm"
[noise]
measured_mm = 0.0003
"""


def test_four_causes_at_few_targets_are_found_with_the_right_period(tmp_path: Path) -> None:
    rng = np.random.default_rng(41)
    sense = np.tile(np.repeat([1, -1], len(TARGETS)), 3)
    at = np.concatenate([TARGETS, TARGETS[::-1]] * 3)
    warm = np.round(20.3 + 0.9 * np.arange(len(at)) * 45 / 6000, 3)
    error = 3.0 * np.sin(2.0 * np.pi * at / 93.0 + 0.7) - 2.0 * sense - 0.018 * at + 0.018 * (warm - 20.3) * at
    measured = at + 1e-3 * (error + rng.normal(0.0, 0.3, len(at)))
    head = "pose,role,time_s,command_mm,approach,measured_mm,material_temperature_c"
    rows = [f"{k + 1},calibration,{45 * k},{at[k]:g},{sense[k]},{measured[k]:.6f},{warm[k]}" for k in range(len(at))]
    (tmp_path / "campaign.toml").write_text(TOML)
    (tmp_path / "configurations.csv").write_text("\n".join([head, *rows]) + "\n")
    table = run_line(tmp_path, "ingest", "diagnose")[0]["diagnosis"].to_pandas()
    found = {row.cause: json.loads(row.parameters) for row in table[table["verdict"] == "found"].itertuples()}
    assert set(found) == {"lost-motion", "scale-error", "axis-growth", "periodic-error"}
    truth = {
        ("lost-motion", "backlash"): 2e-3,
        ("axis-growth", "growth"): 18e-6,
        ("periodic-error", "period"): 93.0,
        ("periodic-error", "amplitude"): 3e-3,
    }
    for (cause, name), value in truth.items():
        own = found[cause][name]
        assert abs(own["value"] - value) < 4.0 * own["sigma"], (cause, name, own)
        assert own["sigma"] < 0.1 * value
