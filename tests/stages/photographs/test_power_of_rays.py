"""Simulated rays with the network of a run: their scatter, hidden effects, and questions about them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.stages.line import settings_of
from truing.pipeline.artifacts import Stamp, write_table
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.console import RunConsole
from truing.pipeline.executor import Workforce
from truing.pipeline.power_command import PowerOptions, asks_for_ray_causes, plan_of_rays, power_campaign
from truing.pipeline.problems import ExitCode
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults
from truing.simulation.cause import Effect
from truing.simulation.detection_trials import subject_class
from truing.simulation.photographs.causes.camera_instability import CameraInstability
from truing.stages.diagnosis.ray_points import assemble_rays
from truing.stages.power import ray_plan_of
from truing.stages.simulated_campaigns.plan import NEEDS, RayPlan


@pytest.fixture(scope="module")
def plan(adjusted: Any) -> RayPlan:
    _, folder, tables = adjusted
    return ray_plan_of(tables, settings_of(folder))


def _jump(plan: RayPlan, size_px: float) -> Effect:
    order = plan.rays.covariates["order"]
    last = int(np.argmax(order))
    cause = CameraInstability("camera", ("c",), since=float(order[last]), from_pose=plan.rays.poses[last])
    return Effect(cause, np.array([size_px]))


def test_channels_of_drawn_rays_are_off_by_noise_alone(adjusted: Any, plan: RayPlan) -> None:
    """Numbers that are known beforehand, the lengths of bars, are drawn too."""
    _, folder, _ = adjusted
    settings, rng = settings_of(folder), np.random.default_rng(3)
    known = [n for n, number in enumerate(plan.rays.parameters) if number.sigma]
    scale = np.array([number.scale for number in plan.rays.parameters])
    sigma = np.array([plan.rays.parameters[n].sigma for n in known], float)
    mean = np.array([plan.rays.parameters[n].mean for n in known])
    assert len(known) == 2
    effect, root, squares = _jump(plan, 0.7), plan.rays.root, []
    moved = np.einsum("bkt,bt->bk", root, effect.cause.moved(plan.rays, effect.values) / scale)
    assert np.abs(moved).max() > 3
    reported = plan.rays.is_observed.ravel()
    expected = (moved + root[:, :, known] @ (mean / scale[known])).ravel()[reported]
    by_known = (root[:, :, known] * (sigma / scale[known])).reshape(-1, len(known))[reported]
    inverse = np.linalg.inv(np.eye(len(expected)) + by_known @ by_known.T)
    for _ in range(40):
        found = assemble_rays(plan.drawn([effect], rng), settings)[0].calibration.measured
        off = found.values[..., 0].ravel()[reported] - expected
        squares.append(off @ inverse @ off / len(off))
    assert abs(np.mean(squares) - 1.0) < 4.0 * np.sqrt(2 / (40 * reported.sum()))


def test_nothing_but_scores_is_drawn(plan: RayPlan) -> None:
    drawn = plan.drawn((), np.random.default_rng(1))
    assert set(drawn) == {*NEEDS}
    for name in NEEDS:
        before, after = plan.tables[name], drawn[name]
        same = [c for c in before.column_names if before.column(c).equals(after.column(c))]
        assert set(before.column_names) - set(same) == ({"score"} if name == "ray_statistics" else set())


@pytest.fixture
def run(adjusted: Any, tmp_path: Path) -> Path:
    """Folder of a run."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in NEEDS:
        table: pa.Table = adjusted[2][name]
        write_table(folder / ARTIFACTS[name].file, ARTIFACTS[name], table, Stamp("bundle", "", "lab", "0", ()))
    return folder


def test_a_run_s_network_is_drawn_from(adjusted: Any, run: Path, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("truing.pipeline.power_command.folder_next_to_run", lambda *_, **__: run)
    monkeypatch.setattr("truing.stages.power._THRESHOLD_DRAWS", 100)
    wish = PowerOptions(("scale-bar-temperature", "camera-instability"), draws=0)
    assert (
        power_campaign(adjusted[1], wish, Workforce(1), tmp_path / "power.csv", RunConsole(quiet=False))
        is ExitCode.DONE
    )
    sizes = (tmp_path / "power.csv").read_text(encoding="utf-8").splitlines()
    assert {line.split(",")[0].strip('"') for line in sizes[1:]} == {*wish.causes}
    assert "Rays are simulated, not photographs" in (tmp_path / "power.html").read_text(encoding="utf-8")


def test_without_a_run_there_is_no_network(adjusted: Any, tmp_path: Path) -> None:
    with pytest.raises(CampaignFaults, match="rays of three poses or more"):
        plan_of_rays(tmp_path, settings_of(adjusted[1]))


def test_rays_and_points_are_asked_for_apart(adjusted: Any) -> None:
    campaign = open_campaign(adjusted[1])
    assert asks_for_ray_causes(("camera-instability",), campaign)
    assert not asks_for_ray_causes(("actuator-gain",), campaign)
    assert not asks_for_ray_causes((), campaign)
    with pytest.raises(CampaignFaults, match="in a call of their own"):
        asks_for_ray_causes(("camera-instability", "actuator-gain"), campaign)


def test_wrong_rays_are_not_drawn(plan: RayPlan) -> None:
    assert plan.with_gross(0.0) is plan
    with pytest.raises(ValueError, match="--gross: expected 0"):
        plan.with_gross(0.01)


def test_one_camera_and_one_bar_are_single_places() -> None:
    subjects = ("camera left", "bar S", "")
    assert [subject_class(subject) for subject in subjects] == ["one camera", "one bar", "the whole"]
