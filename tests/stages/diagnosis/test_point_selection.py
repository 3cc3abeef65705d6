"""Points of the diagnosis: moved and exchanged targets are kept, gross errors are not."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import TargetMoved, TargetsSwapped
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.stages.line import run_line
from tests.tolerance import assert_between
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.causes.targets import TargetsSwapped as Swapped
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.mechanism_points import assemble

SHIFT_MM = (0.3, -0.2, 0.1)


@dataclass(frozen=True)
class Seen:
    """A campaign, the data compared by the diagnosis, and its columns and fitted poses in the same order."""

    campaign: Campaign
    gathered: DiagnosisData
    columns: list[int]
    rows: NDArray

    @property
    def kept(self) -> NDArray:
        return self.gathered.calibration.measured.is_observed

    @property
    def gross(self) -> NDArray:
        record = self.campaign.record
        return (record.gross & record.is_observed)[self.rows][:, self.columns]

    @property
    def good(self) -> NDArray:
        record = self.campaign.record
        return (~record.gross & record.is_observed)[self.rows][:, self.columns]

    def column(self, body: str, target: str) -> int:
        targets = self.gathered.model.targets
        return list(zip(targets.bodies, targets.names, strict=True)).index((body, target))


@pytest.fixture(scope="module", params=["platform", "leg2"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Eight poses before its end a target moves, before that two labels are exchanged in three poses; 3 % gross errors,
    8 % losses."""
    rng = np.random.default_rng(77)
    layout = Layout(
        name="faulty",
        faults=DataFaults(0.08, 0.03),
        targets=Targets(base=8, platform=7, per_leg=4),
        noise=Noise(0.006),
        surroundings=Surroundings(shuffled=True),
    )
    moves = [at_rest(), *random_moves(24, 6, rng)]
    plain = draw_campaign(layout, moves, [], np.random.default_rng(78))
    body, (first, second, moved) = request.param, _names(plain, request.param)
    start = plain.schedule.pose[int(np.argsort(plain.schedule.time_s)[-8])]
    swapped = tuple(plain.schedule.pose[row] for row in np.argsort(plain.schedule.time_s)[[3, 8, 12]])
    hidden = [TargetMoved(body, moved, SHIFT_MM, start), TargetsSwapped(body, (first, second), swapped)]
    campaign = draw_campaign(layout, moves, hidden, np.random.default_rng(78))
    folder = write_campaign(campaign, tmp_path_factory.mktemp("faulty") / "campaign", 78)
    tables, _ = run_line(folder, "ingest", "pose")
    gathered = assemble(tables, read_campaign(tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))))
    marks, targets = campaign.marks, gathered.model.targets
    columns = [marks.index(*pair) for pair in zip(targets.bodies, targets.names, strict=True)]
    rows = np.array([campaign.schedule.pose.index(int(pose)) for pose in gathered.calibration.conditions.poses])
    return Seen(campaign, gathered, columns, rows)


def _names(campaign: Campaign, body: str) -> tuple[str, str, str]:
    first, second, moved = (campaign.marks.name[k] for k in campaign.marks.of(body)[[0, 2, 3]])
    return first, second, moved


def test_gross_errors_are_left_out_and_little_else(seen: Seen) -> None:
    assert seen.gross.sum() > 30
    assert_between(float((seen.kept & seen.gross).sum() / seen.gross.sum()), 0.0, 0.1, what="gross errors kept")
    assert_between(float((~seen.kept & seen.good).sum() / seen.good.sum()), 0.0, 0.01, what="good points lost")


def test_a_target_that_was_moved_late_is_kept(seen: Seen) -> None:
    moved = next(effect for effect in seen.campaign.truth.effects if isinstance(effect, TargetMoved))
    column, schedule = seen.column(moved.body, moved.target), seen.campaign.schedule
    late = schedule.rank[seen.rows] >= schedule.rank[schedule.pose.index(moved.from_pose)]
    good = late & seen.good[:, column]
    assert good.sum() >= 4
    assert_between(float((seen.kept[:, column] & good).sum() / good.sum()), 0.7, 1.0, what="poses kept")


def test_exchanged_labels_are_reported_by_body_targets_and_poses(seen: Seen) -> None:
    hidden = next(effect for effect in seen.campaign.truth.effects if isinstance(effect, TargetsSwapped))
    record, marks = seen.campaign.record, seen.campaign.marks
    pair = [marks.index(hidden.body, target) for target in hidden.targets]
    (found,) = seen.gathered.given
    assert isinstance(found, Swapped)
    assert (found.body, found.targets) == (hidden.body, hidden.targets)
    poses = np.array([seen.campaign.schedule.pose.index(pose) for pose in hidden.poses])
    whole = (record.is_observed & ~record.gross)[np.ix_(poses, pair)].all(1)
    assert (
        {pose for pose, fine in zip(hidden.poses, whole, strict=True) if fine} <= set(found.poses) <= set(hidden.poses)
    )


def test_every_point_left_out_is_reported(seen: Seen) -> None:
    """Those of the fit of poses are in its residuals; all others are reported here, gross errors at attachments."""
    isolated = {(point.pose, point.subject) for point in seen.gathered.isolated}
    targets, poses = seen.gathered.model.targets, seen.gathered.calibration.conditions.poses
    rows, columns = np.nonzero(seen.gross & ~seen.kept)
    gone = {(poses[b], f"{targets.bodies[k]} {targets.names[k]}") for b, k in zip(rows, columns, strict=True)}
    attachments = {point for point in gone if point[1].startswith("platform A")}
    assert attachments <= isolated
    assert len(isolated - gone) <= 2
