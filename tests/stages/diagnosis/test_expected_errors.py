"""Errors of predictions that noise, scatter and the uncertainty of the fit explain together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from tests.blind.generator.arms import draw, write
from tests.tolerance import assert_between
from truing.pipeline.in_memory import stage_line

ARMS = (1, 2, 3, 4, 5, 6)


def _diagnosed(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of every pose, and the rows of the diagnosis."""
    tables = stage_line(folder).call("ingest", "pose", "diagnose").tables
    return tables["prediction"].to_pandas(), tables["diagnosis"].to_pandas()


def test_held_out_errors_are_those_of_noise_and_of_the_uncertain_fit(tmp_path: Path) -> None:
    """Few fitted poses: their uncertainty gives a quarter of the variance at held-out poses, in some arms a third."""
    ratios, shares = [], []
    for seed in ARMS:
        write(draw(seed, instrument="points-series", causes=(), poses=40), tmp_path / str(seed))
        errors, rows = _diagnosed(tmp_path / str(seed))
        held_out, floor = errors[errors["role"] == "verification"], rows["noise_floor"].dropna().iloc[-1]
        expected = floor**2 + held_out["sigma_of_fit"] ** 2
        ratios.append(np.mean(held_out["rms_after"] ** 2 / expected))
        shares.append(np.mean(held_out["sigma_of_fit"] ** 2 / expected))
    assert np.mean(shares) > 0.15
    assert_between(float(np.mean(ratios)), 0.7, 1.35, what="held-out variance over the expected one")


def test_scatter_next_to_a_found_cause_is_no_larger_than_what_that_cause_leaves(tmp_path: Path) -> None:
    """Before backlash is found, its effect counts as scatter of the same joint: a floor 1.3 times the errors."""
    causes = ("approach-scatter", "joint-backlash")
    write(draw(5, instrument="points-series", causes=causes, poses=60, strength=20.0), tmp_path / "arm")
    errors, rows = _diagnosed(tmp_path / "arm")
    assert set(causes) <= set(rows.loc[rows["verdict"].isin(["found", "suspected"]), "cause"])
    fitted = errors.loc[errors["role"] == "calibration", "rms_after"]
    floor = rows["noise_floor"].dropna().iloc[-1]
    assert_between(float(np.sqrt(np.mean(fitted**2)) / floor), 0.85, 1.15, what="rms error over the floor")
