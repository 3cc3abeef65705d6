"""Data of the diagnosis without a mechanism, from the tables of a run; bodies that stand still."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.bodies import Body, Hidden, Layout, draw, without_survey, write
from tests.stages.line import run_line
from tests.tolerance import assert_between
from truing.estimation.rigid_poses.points import PosePoints
from truing.schemas.campaign import read_campaign
from truing.simulation.bodies.measured_bodies import evident_displacements
from truing.stages.diagnosis.body_points import assemble_bodies
from truing.stages.diagnosis.diagnosis_data import DiagnosisData

LAYOUT = Layout(poses=40)


def _gathered(folder: Path, layout: Layout, *hidden: Hidden, more: str = "") -> DiagnosisData:
    rng = np.random.default_rng(5)
    write(draw(layout, hidden, rng), folder, rng)
    toml = folder / "campaign.toml"
    toml.write_text(toml.read_text(encoding="utf-8") + more, encoding="utf-8")
    tables, _ = run_line(folder, "ingest", "pose")
    return assemble_bodies(tables, read_campaign(tomllib.loads(toml.read_text(encoding="utf-8"))))


def test_a_reference_that_hardly_moves_stands_still_and_the_frame_is_not_fitted(tmp_path: Path) -> None:
    found = _gathered(tmp_path / "c", LAYOUT)
    assert list(found.model.known.is_stationary) == [False, True]
    assert not found.calibration.frames.free
    assert found.held_out is not None
    jitter = found.model.known.jitter[1]
    size = np.sqrt(np.diag(jitter @ jitter.T))
    assert_between(float(size[:3].mean()), 0.6e-5, 1.4e-5, what="jitter, m (1e-5 drawn)")


def test_no_body_is_stationary_if_the_frame_changes_from_pose_to_pose(tmp_path: Path) -> None:
    free = Layout(bodies=(Body("tool", 5), Body("base", 5)), poses=12)
    found = _gathered(tmp_path / "c", free, more='\n[bodies]\nreference = "base"\n')
    assert not found.model.known.is_stationary.any()
    assert found.calibration.frames.free
    assert found.model.known.lead == 1


def test_a_body_that_should_stand_still_does_so_where_the_drives_do(tmp_path: Path) -> None:
    turned = Layout(bodies=(Body("mirror", 5),), poses=24, verification=0)
    rng = np.random.default_rng(5)
    folder = write(draw(turned, (), rng), tmp_path / "c", rng)
    toml = folder / "campaign.toml"
    toml.write_text(toml.read_text(encoding="utf-8") + '\n[bodies]\nstill = ["mirror"]\n', encoding="utf-8")
    tables, _ = run_line(folder, "ingest", "pose")
    found = assemble_bodies(tables, read_campaign(tomllib.loads(toml.read_text(encoding="utf-8"))))
    levels = len(set(tables["configurations"].column("elevation_deg").to_pylist()))
    assert list(found.model.known.levels) == [levels]
    assert found.model.layout["seat"].stop - found.model.layout["seat"].start == 6 * levels


def test_without_a_survey_the_shape_is_open_but_for_the_body_s_frame(tmp_path: Path) -> None:
    found = _gathered(tmp_path / "c", without_survey(LAYOUT))
    assert not found.model.known.surveyed.any()
    assert found.model.known.survey.modes.shape[-1] == (3 * 6 - 6) + (3 * 5 - 6)
    assert found.held_out is None


def test_without_configurations_the_order_of_the_poses_is_the_only_column(tmp_path: Path) -> None:
    found = _gathered(tmp_path / "c", Layout(poses=12, configured=False))
    assert set(found.calibration.conditions.covariates) == {"order"}
    assert list(found.calibration.conditions.covariates["order"]) == list(range(12))


def test_a_target_that_was_moved_far_and_labels_that_were_exchanged_leave_no_doubt(tmp_path: Path) -> None:
    hidden = Hidden("moved", "tool", 50.0), Hidden("swapped", "base", 1.0)
    found = _gathered(tmp_path / "c", LAYOUT, *hidden)
    assert {cause.id for cause in found.given} == {"target-moved", "targets-swapped"}


def test_a_body_with_too_few_targets_is_left_out_and_named(tmp_path: Path) -> None:
    found = _gathered(tmp_path / "c", Layout(bodies=(Body("tool", 5), Body("stick", 2)), poses=8))
    assert "body stick (no three targets seen together in three poses)" in found.left_out
    assert set(found.model.targets.bodies) == {"tool"}


def test_no_body_at_all_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="three targets"):
        _gathered(tmp_path / "c", Layout(bodies=(Body("stick", 2),), poses=8))


def test_a_marker_that_was_moved_far_is_one_thing_and_a_corner_alone_is_a_target() -> None:
    names = ("M.0", "M.1", "M.2", "M.3", "7")
    points = PosePoints((11, 12, 13), names, np.zeros((3, 5, 3)), np.zeros((3, 5, 3, 3)), np.ones((3, 5), bool))
    shape, order = np.arange(15.0).reshape(5, 3), np.array([2.0, 0.0, 1.0])
    both = [(1, k) for k in range(4)] + [(2, 3), (2, 4)]
    marker, corner, target = evident_displacements("plate", points, shape, order, both)
    assert (marker.subject, marker.from_pose, marker.from_order) == ("marker M", 12, 0.0)
    assert marker.corners == names[:4]
    assert marker.places == tuple(range(12))
    assert (corner.subject, target.subject, corner.from_pose) == ("target M.3", "target 7", 13)
