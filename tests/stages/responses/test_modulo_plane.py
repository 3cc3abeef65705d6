"""Targets at the attachments alone: K is known except for a plane, and rounding is not interpreted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Targets
from tests.blind.generator.schedule import at_rest, published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.stages.line import run_line

LAYOUT = Layout(
    name="attachments-alone",
    targets=Targets(base=8, platform=0, per_leg=0),
    faults=replace(DataFaults(), missing_share=0.02),
)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_platform_without_a_frame_of_its_own_has_no_rank_of_K_and_no_model_of_deformation(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    campaign = draw_campaign(LAYOUT, [at_rest(), *published_moves()], [MatrixDeformation(PUBLISHED_K)], rng)
    folder = write_campaign(campaign, tmp_path / "campaign", seed)
    tables, said = run_line(folder, "ingest", "pose", "deformation", "calibrate")
    figures = tables["deformation_errors"].to_pandas().query("model == 'matrix'").set_index("figure")["value"]
    assert figures["modulo_plane"] == 1.0
    assert "rank" not in figures
    assert set(tables["calibration"].column("deformation").to_pylist()) == {"none"}
    assert "fewer than three platform targets away from the attachments" in said["calibrate"].left_out
