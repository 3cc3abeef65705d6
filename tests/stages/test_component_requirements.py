"""Requirements of a chain and of an axis are decided by the error of the extended model where it was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from tests.ignored_causes import search_only
from tests.tolerance import assert_between, assert_close
from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.stages.diagnosis.component_errors import _Channels, _motion

TARGETS = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.2], [0.1, 0.1, 0.1]])


def _channels(motion: np.ndarray, noise: np.ndarray, seen: np.ndarray | None = None) -> _Channels:
    """Targets of bodies that are displaced by motions (B, 6) about the origin, with noise (B, 4, 3)."""
    turn = Rotation.from_rotvec(motion[:, 3:]).as_matrix()
    gap = motion[:, None, :3] + np.einsum("bij,kj->bki", turn - np.eye(3), TARGETS) + noise
    size = np.broadcast_to(np.eye(3), (*gap.shape, 3)) * np.array([1.0, 2.0, 3.0, 4.0])[:, None, None] ** 2
    every = np.ones(gap.shape[:2], bool) if seen is None else seen
    return _Channels(gap, size, every, np.broadcast_to(TARGETS, gap.shape), np.zeros(4, bool), np.zeros(4, int))


def test_the_motion_of_a_body_is_that_of_its_targets_at_their_mean() -> None:
    motion = np.random.default_rng(3).normal(0.0, 1e-6, (5, 6))
    found, _ = _motion(_channels(motion, np.zeros((5, 4, 3))), np.tile(TARGETS.mean(0), (5, 1)))
    assert_close(found[:, 3:], motion[:, 3:], atol=1e-11)
    assert_close(found[:, :3], motion[:, :3] + np.cross(motion[:, 3:], TARGETS.mean(0)), atol=1e-11)


def test_the_variances_are_those_of_repeated_measurements() -> None:
    draws = 20000
    noise = np.random.default_rng(4).normal(size=(draws, 4, 3)) * np.array([1.0, 2.0, 3.0, 4.0])[:, None]
    found, cov = _motion(_channels(np.zeros((draws, 6)), noise), np.zeros((draws, 3)))
    ratio = found.var(0) / np.diagonal(cov[0])
    assert_close(ratio, np.ones(6), atol=5.0 * np.sqrt(2.0 / draws))


@pytest.mark.parametrize(("kept", "shown"), [((0, 1, 2), 6), ((0, 1), 3), ((2,), 3), ((), 0)])
def test_fewer_than_three_targets_show_no_rotation(kept: tuple[int, ...], shown: int) -> None:
    is_observed = np.isin(np.arange(4), kept)[None]
    found, _ = _motion(_channels(np.full((1, 6), 1e-3), np.zeros((1, 4, 3)), is_observed), np.zeros((1, 3)))
    assert np.isfinite(found).sum() == shown


def _verdict(campaign: Path, requirement: str) -> tuple[dict[str, dict[str, object]], dict[str, object], Path]:
    """Rows of requirements by component, the row of the verdict, and the run."""
    text = (campaign / "campaign.toml").read_text(encoding="utf-8")
    (campaign / "campaign.toml").write_text(f"{text}\n[requirement]\n{requirement}\n", encoding="utf-8")
    run = search_only(campaign).with_name("run")
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(run)])
    assert done.exit_code == 0, done.output
    rows = {row["component"]: row for row in pq.read_table(run / "requirements.parquet").to_pylist()}
    sections = {row["section"]: row for row in pq.read_table(run / "verdict.parquet").to_pylist()}
    return rows, sections["requirements"], run


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["poses", "points-pose", "points-campaign"])
def test_limits_far_above_and_below_the_error_are_distinguished(tmp_path: Path, instrument: str) -> None:
    made = draw(31, layout="industrial-6r", instrument=instrument, notation="urdf", causes=(), poses=60)
    campaign = write(made, tmp_path / "arm")
    rows, verdict, run = _verdict(campaign, "x_mm = 1.0\ny_mm = 1.0e-6")
    assert rows["x"]["verdict"] == "meets"
    assert rows["y"]["verdict"] in ("fails", "undecided")
    assert verdict["reason_code"] in ("not-met", "undecided")
    errors = [row for row in pq.read_table(run / "component_errors.parquet").to_pylist() if row["component"] == "x"]
    held = np.array([row["missed"] for row in errors if row["role"] == "verification"])
    # without a hidden effect the errors are those of the measurement, and little of the fit
    sigma = np.sqrt(np.mean([row["sigma"] ** 2 for row in errors if row["role"] == "verification"]))
    assert_between(np.sqrt(np.mean(held**2)) / sigma, 0.5, 2.5, what="error over noise")


@pytest.mark.slow
def test_a_component_that_was_not_measured_is_asked_for(tmp_path: Path) -> None:
    made = draw(5, layout="scara", instrument="distances", notation="urdf", causes=(), poses=40)
    rows, verdict, run = _verdict(write(made, tmp_path / "arm"), "x_mm = 1.0\nrz_deg = 1.0")
    assert {row["verdict"] for row in rows.values()} == {"not evaluated"}
    assert verdict["state"] == "not tested"
    needs = pq.read_table(run / "next_measurements.parquet").to_pylist()
    assert needs[0]["need"] == "requirement"
    assert "requirement rz" in needs[0]["purpose"] or "requirement x" in needs[0]["purpose"]


def test_limits_on_loads_are_those_of_a_sensor_alone() -> None:
    limits = {"fz_n": 1.0}
    with pytest.raises(CampaignFaults, match=r"key requirement\.fz_n: found '1'; expected no such key"):
        read_campaign({"campaign": {"name": "a", "kind": "photogrammetry"}, "requirement": limits})
    sensor = read_campaign({"campaign": {"name": "a", "kind": "interferometer"}, "requirement": limits})
    assert sensor.requirement.of_loads() == limits


@pytest.mark.parametrize(("unit", "given", "wrong"), [("rotary", "x_mm", "x_mm"), ("linear", "rx_deg", "rx_deg")])
def test_an_axis_has_one_limit_of_its_unit(unit: str, given: str, wrong: str) -> None:
    column = "command_deg" if unit == "rotary" else "command_mm"
    mechanism = {"type": "axis", "kind": unit, "command": column}
    fitting = {"rotary": {"ry_deg": 0.1, "rz_deg": 0.1}, "linear": {"y_mm": 0.1, "z_mm": 0.1}}[unit]
    document = {"campaign": {"name": "c", "kind": "photogrammetry"}, "mechanism": mechanism}
    with pytest.raises(CampaignFaults) as error:
        read_campaign({**document, "requirement": {given: 0.1, **fitting}})
    expected = {f"requirement.{wrong}", f"requirement.{list(fitting)[1]}"}
    assert {fault.column for fault in error.value.faults} == expected
    assert read_campaign({**document, "requirement": dict(list(fitting.items())[:1])})
