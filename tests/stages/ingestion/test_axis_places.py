"""Angles and displacements from points or poses of what an axis moves, against movements that were put in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.stages.line import settings_of
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.schemas.faults import CampaignFaults
from truing.stages.ingestion.axis_places import angles, displacements
from truing.stages.ingestion.axis_rows import ingest

SIGMA_MM = 1e-3
STANDS = Rotation.from_rotvec([0.5, -0.3, 0.8])  # of the instrument, anywhere
TARGETS = np.array([[200.0, 0.0, 5.0], [-100.0, 150.0, 20.0], [30.0, -180.0, 0.0]])
COMMAND = np.random.default_rng(1).uniform(-170.0, 170.0, 60)


def seen(rng: np.random.Generator, turn_deg: NDArray, shift_mm: NDArray, targets: NDArray) -> NDArray:
    """Places (B, T, 3), mm, of targets on a body that turns about its z and moves along it; one in ten is missed."""
    turned = np.stack([Rotation.from_euler("z", a, degrees=True).apply(targets) for a in turn_deg])
    moved = turned + np.outer(shift_mm, [0.0, 0.0, 1.0])[:, None]
    places = STANDS.apply(moved.reshape(-1, 3)).reshape(moved.shape) + SIGMA_MM * rng.normal(size=moved.shape)
    places[rng.uniform(size=places.shape[:2]) < 0.1 * (len(targets) > 1)] = np.nan
    return places


def without_mean(values: NDArray) -> NDArray:
    """Differences from the mean, without whole turns."""
    away = (values - values[np.isfinite(values)][0] + 180.0) % 360.0 - 180.0
    return np.asarray(away - np.nanmean(away))


@pytest.mark.parametrize("targets", [TARGETS, TARGETS[:1]])
def test_angles_are_those_of_the_movement_to_the_noise_of_the_points(targets: NDArray) -> None:
    found = angles(seen(np.random.default_rng(2), COMMAND, 0.0 * COMMAND, targets), COMMAND)
    assert found is not None
    away = without_mean(found - COMMAND)
    assert np.nanstd(away) < 2.0 * np.degrees(SIGMA_MM / 180.0)
    assert np.isfinite(found).mean() > 0.9


def test_an_axis_that_wanders_sideways_has_the_same_angles_of_a_figure() -> None:
    """A runout of 0.1 mm would be 100 arc seconds at a single target."""
    rng = np.random.default_rng(3)
    places = seen(rng, COMMAND, 0.0 * COMMAND, TARGETS) + 0.1 * rng.normal(size=(len(COMMAND), 1, 3))
    found = angles(places, COMMAND)
    assert found is not None
    assert np.nanstd(without_mean(found - COMMAND)) < 2.0 * np.degrees(SIGMA_MM / 180.0)


def test_displacements_are_those_along_the_movement() -> None:
    rng = np.random.default_rng(4)
    found = displacements(seen(rng, 0.0 * COMMAND, COMMAND * (1.0 + 1e-4), TARGETS), COMMAND)
    slope = np.polyfit(COMMAND[np.isfinite(found)], found[np.isfinite(found)], 1)[0]
    assert abs(slope - 1.0 - 1e-4) < 4 * SIGMA_MM / np.std(COMMAND) / np.sqrt(len(COMMAND))


def test_one_target_on_a_short_arc_gives_no_angles() -> None:
    """Its radius, and with it the size of every angle, would be uncertain."""
    assert angles(seen(np.random.default_rng(5), COMMAND / 4.0, 0.0 * COMMAND, TARGETS[:1]), COMMAND / 4.0) is None


TOML = """
[campaign]
name = "axis"
kind = "photogrammetry"
[mechanism]
type = "axis"
kind = "linear"
command = "command_mm"
[noise]
measured_mm = 0.001
"""


def written(folder: Path, column: str = "") -> Path:
    (folder / "campaign.toml").write_text(TOML, encoding="utf-8")
    rows = "".join(f"{k},{60 * k},{10 * k}{',0' * bool(column)}\n" for k in range(1, 7))
    (folder / "configurations.csv").write_text(f"pose,time_s,command_mm{column}\n{rows}", encoding="utf-8")
    places = "".join(f"{k},table,A,{10.01 * k},0,0\n" for k in range(1, 7))
    (folder / "points.csv").write_text(f"pose,body,target,x_mm,y_mm,z_mm\n{places}", encoding="utf-8")
    return folder


def test_points_of_a_campaign_are_the_outside_instrument(tmp_path: Path) -> None:
    folder = written(tmp_path)
    settings = settings_of(folder)
    table = ingest(settings, CampaignFiles(folder, settings), FaultLog()).artifacts["configurations"]
    measured = np.array(table["measured_mm"].to_pylist(), float)
    assert np.allclose(np.diff(measured), 10.01)


def test_points_next_to_a_column_of_the_instrument_are_a_fault(tmp_path: Path) -> None:
    folder = written(tmp_path, ",measured_mm")
    settings = settings_of(folder)
    with pytest.raises(CampaignFaults, match="points"):
        ingest(settings, CampaignFiles(folder, settings), FaultLog())
