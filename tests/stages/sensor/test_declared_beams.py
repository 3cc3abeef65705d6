"""Declared inclined or offset beams are part of the model, and no finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.effects import Effect
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.recording import AbbeOffset, CosineError, across
from tests.stages.benches import DEFORMATION, Bench, case_errors, entry_errors, layout
from tests.stages.line import run_line
from tests.tolerance import assert_between, assert_close
from truing.schemas.interferometer import Interferometer
from truing.simulation.bench.known_readings import BeamGeometry, Optics
from truing.stages.common.beam_rows import channel_rows
from truing.stages.common.declared_optics import declared_optics

ANGLE = 0.02
ASIDE = across(1, 0.7)
HIDDEN = (CosineError(1, ANGLE, ASIDE), AbbeOffset(0, (0.0, 0.0, 0.04)), AbbeOffset(2, (0.03, -0.02, 0.0)))
TOWARDS = (np.cos(ANGLE) * np.eye(3)[1] + np.sin(ANGLE) * np.array(ASIDE)).tolist()
BEAMS = f"""
[interferometer.beams]
dx = {{ arm_mm = [0.0, 0.0, 40.0] }}
dy = {{ direction = {TOWARDS} }}
dz = {{ arm_mm = [30.0, -20.0, 0.0] }}
"""


def _bench(folder: Path, channels: str, more: str, hidden: Sequence[Effect] = HIDDEN) -> Bench:
    drawn = draw_campaign(layout(channels), hidden, np.random.default_rng(4))
    write_campaign(drawn, folder, 4)
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write(more)
    tables, said = run_line(folder, *DEFORMATION)
    return Bench(folder, drawn, tables, said)


def test_displacements_and_compliance_are_the_platform_s_where_beams_are_declared(tmp_path):
    declared = _bench(tmp_path / "declared", "all", BEAMS)
    errors, entries = case_errors(declared), entry_errors(declared)
    assert np.abs(errors).max() < 5.0
    assert np.mean(entries**2) < 1.0 + 4.0 * np.sqrt(2.0 / 36.0)
    assert "corrected for the geometry of beams: dx by" in declared.outcomes["pose"].figure
    plain = _bench(tmp_path / "plain", "all", "")
    assert np.abs(case_errors(plain)).max() > 30.0
    assert np.abs(entry_errors(plain)).max() > 30.0


def test_the_geometry_of_beams_takes_unread_components_from_the_simulation(tmp_path):
    declared = _bench(tmp_path / "declared", "own", BEAMS)
    errors = case_errors(declared)
    assert np.isfinite(errors).sum(0).min() > 0
    assert np.isnan(errors).sum() > 4 * np.isfinite(errors).sum()
    assert np.nanmax(np.abs(errors)) < 5.0
    assert np.abs(entry_errors(declared)).max() < 4.0
    assert np.nanmax(np.abs(case_errors(_bench(tmp_path / "plain", "own", "")))) > 10.0


def test_without_a_simulation_a_component_that_holds_an_unknown_one_is_unknown():
    rows = np.eye(6)
    rows[2, 4] = 0.03
    read = np.array([[1.0, 2.0, 3.0, np.nan, np.nan, np.nan], [1.0, 2.0, 3.0, np.nan, 10.0, np.nan]])
    geometry = BeamGeometry(replace(Optics.plain(), rows=rows), None)
    found = geometry.solved(np.zeros((2, 6)), read, np.broadcast_to(np.eye(6), (2, 6, 6)))
    assert np.isnan([found.value[0, 2], found.added[0, 2]]).all()
    assert_close(found.value[0, :2], [1.0, 2.0], atol=1e-12)
    assert_close(found.value[1, :3], [1.0, 2.0, 2.7], atol=1e-12)
    assert np.isinf(found.covariance[0, 2, 2])
    assert_close(found.covariance[1][np.ix_([2, 4], [2, 4])], [[1.0009, -0.03], [-0.03, 1.0]], atol=1e-12)
    assert_close(found.added[1, 2], 0.3, atol=1e-12)


@pytest.mark.parametrize("channel", ["dy", "rx"])
def test_sigmas_are_those_of_rows_drawn_anew(channel):
    """Angles across a beam and its arm, drawn a thousand times, scatter the rows as the unknowns say."""
    rng = np.random.default_rng(6)
    beam = {"direction": [0.1, 2.0, -0.2] if channel == "dy" else [1.0, 0.02, 0.03], "direction_sigma_rad": 1e-3}
    beam |= {"arm_mm": [20.0, 5.0, 50.0], "arm_sigma_mm": 2.0} if channel == "dy" else {}
    found = declared_optics(Interferometer.model_validate({"beams": {channel: beam}}))
    k = ["dx", "dy", "dz", "rx"].index(channel)
    assert len(found.by_angle) == (4 if channel == "dy" else 2)
    unit = np.array(beam["direction"]) / np.linalg.norm(beam["direction"])
    drawn = []
    for _ in range(1000):
        other = {"direction": (unit + 1e-3 * rng.standard_normal(3)).tolist()}
        if channel == "dy":
            other["arm_mm"] = (np.array(beam["arm_mm"]) + 2.0 * rng.standard_normal(3)).tolist()
        drawn.append(channel_rows(Interferometer.model_validate({"beams": {channel: other}}).beams)[k])
    expected = found.by_angle[:, k].T @ found.by_angle[:, k]
    scatter = np.cov(np.array(drawn).T)
    is_observed = np.diag(expected) > 1e-12
    assert_between(float(np.mean(np.diag(scatter)[is_observed] / np.diag(expected)[is_observed])), 0.9, 1.1)
    spread = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (
        np.abs(scatter - expected)[np.ix_(is_observed, is_observed)].max()
        < 0.2 * spread[np.ix_(is_observed, is_observed)].max()
    )
