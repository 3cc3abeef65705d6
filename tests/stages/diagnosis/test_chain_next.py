"""Next poses of a chain: other payloads to separate weight from angle, poses for precision, and no empty motion."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from tests.pipeline.test_power_of_chains import STATIONS, TARGETS, TOML
from truing.estimation.design.rival_design import Fitted
from truing.inference.fit import fit_model
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import call_stage, chain_tables
from truing.schemas.needs import Need
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, JointCompliance, JointGain
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.common.chain_candidates import joint_ranges, with_predicted_orientations
from truing.stages.diagnosis.chain_next import possible_poses
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.next_measurement import MeasuredPoints, Rivals, planned
from truing.stages.diagnosis.search import assembled_data
from truing.stages.power import chain_plan_of

_STIFF = "payload_kg = 5.0\ngravity = [0.0, 0.0, -1.0]\n"


def _campaign(folder: Path, elbow: float, targets: str = TARGETS) -> tuple[object, dict[str, pa.Table]]:
    """A planned arm whose last joint moves by ``elbow`` deg to either side: torque of the second follows its cosine."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(TOML.replace("[mechanism.tolerance]", f"{_STIFF}\n[mechanism.tolerance]"))
    (folder / "targets.csv").write_text(targets)
    rng, rows = np.random.default_rng(3), ["pose,role,time_s,first_deg,second_deg,third_deg"]
    for pose in range(40):
        a, b, c = rng.uniform((-120.0, -60.0, -elbow), (120.0, 60.0, elbow))
        rows.append(f"{pose},calibration,{30 * pose},{a:.3f},{b:.3f},{c:.3f}")
    (folder / "configurations.csv").write_text("\n".join(rows) + "\n")
    campaign = open_campaign(folder)
    settings = campaign.validated()
    return settings, chain_tables(campaign, settings)


def _diagnosed(folder: Path, elbow: float, cause: ChainCause, size: list[float]) -> dict[str, list[dict[str, object]]]:
    settings, tables = _campaign(folder, elbow)
    drawn = chain_plan_of(tables, settings).drawn((Effect(cause, np.array(size)),), np.random.default_rng(2))
    found = call_stage("diagnose", drawn, settings).artifacts
    return {name: found[name].to_pylist() for name in ("diagnosis", "next_poses")}


def _fitted(data: DiagnosisData[ChainModel], cause: ChainCause) -> Fitted:
    """The campaign fitted with one cause."""
    model, own = data.model.with_causes([cause]), data.calibration
    local = np.zeros((len(own.conditions.readings), model.local_size))
    fit = fit_model(model.predict, own.measured, own.frames, np.zeros(model.shared_size), local)
    rows = fit.whitened.rows
    return Fitted(model, fit.shared, np.linalg.inv(rows.T @ rows))


def test_compliance_and_eccentricity_are_separated_by_another_payload(tmp_path: Path) -> None:
    """With the last joint nearly at rest both move the second joint by its cosine; a payload separates them."""
    settings, tables = _campaign(tmp_path / "a", 1.0)
    compliance, eccentricity = JointCompliance("second", True, 25.0), JointEccentricity("second", True)
    effect = Effect(compliance, np.array([1e-5]))
    drawn = chain_plan_of(tables, settings).drawn((effect,), np.random.default_rng(2))
    data = assembled_data(drawn, settings)
    pair = _fitted(data, compliance), _fitted(data, eccentricity)
    ranges = joint_ranges(data.model.tree, settings, drawn["joints"], drawn["configurations"])
    measured = data.model.conditions.readings
    ranges = replace(ranges, low=measured.min(0), high=measured.max(0))
    instrument = MeasuredPoints(data.calibration.measured, data.calibration.frames).instrument()
    reach = partial(possible_poses, ranges, instrument)
    plans, advice = planned(reach, [], [Rivals(compliance, pair[0], eccentricity, pair[1])])
    (plan,) = plans
    assert plan.need == Need.RIVAL
    assert plan.choice.is_enough
    assert plan.choice.final >= 20.0
    assert any(row["payload_kg"] == 0.0 for row in plan.rows())
    assert "with a payload of 0 kg" in advice[compliance.key].words
    # The same poses, all with the payload that they were measured with, separate the two much worse.
    options = plan.options
    conditions = replace(options.conditions, payload_kg=np.full(len(options.words), 5.0))
    held = replace(options, conditions=with_predicted_orientations(data.model, conditions))
    (usual,), _ = planned(lambda _: held, [], [Rivals(compliance, pair[0], eccentricity, pair[1])])
    assert usual.effort > 2.0 * plan.effort


def test_a_finding_is_sharpened_by_poses_within_the_measured_range(tmp_path: Path) -> None:
    found = _diagnosed(tmp_path / "a", 80.0, JointGain("third"), [1.5e-3])
    (cause,) = [row for row in found["diagnosis"] if row["verdict"] == "found"]
    assert cause["cause"] == "joint-gain"
    rows = found["next_poses"]
    assert {row["need"] for row in rows} == {"precision"}
    for row in rows:
        assert abs(row["third_deg"]) <= 90.0
        assert row["sigma_expected"] < row["sigma_now"]
    readings = np.array([[row[f"{joint}_deg"] for joint in ("first", "second", "third")] for row in rows])
    assert np.abs(readings).max() > 10.0  # no motion of zero
    assert np.ptp(readings[:, 2]) > 60.0  # a gain shows between far readings of its joint
    assert "approached" not in str(cause["next_measurement"])  # a gain does not depend on it


@pytest.mark.parametrize("targets", [TARGETS, TARGETS + STATIONS], ids=["points", "distances"])
def test_the_promised_uncertainty_is_reached(targets: str, tmp_path: Path) -> None:
    """Measuring the plan reduces the uncertainty to the expected one, within a fifth."""
    settings, tables = _campaign(tmp_path / "a", 80.0, targets)
    effect = Effect(JointGain("third"), np.array([1.5e-3]))
    drawn = chain_plan_of(tables, settings).drawn((effect,), np.random.default_rng(2))
    first = call_stage("diagnose", drawn, settings).artifacts
    rows = first["next_poses"].to_pylist()
    own = tables["configurations"].to_pylist()
    last = len(own)
    for row in rows:
        for _ in range(row["times"]):
            extra = {name: row.get(name) for name in own[0] if name in row}
            own.append({**own[-1], **extra, "pose": last, "role": "calibration", "time_s": 30.0 * last})
            last += 1
    longer = {**tables, "configurations": pa.Table.from_pylist(own, schema=tables["configurations"].schema)}
    again = chain_plan_of(longer, settings).drawn((effect,), np.random.default_rng(2))
    second = call_stage("diagnose", again, settings).artifacts
    sigma = [_sigma(found["diagnosis"].to_pylist()) for found in (first, second)]
    promised = min(row["sigma_expected"] for row in rows)
    assert sigma[1] < sigma[0]
    assert 0.8 * promised < sigma[1] < 1.2 * promised


def _sigma(rows: list[dict[str, object]]) -> float:
    (row,) = [row for row in rows if row["verdict"] == "found"]
    return float(json.loads(str(row["parameters"]))["gain"]["sigma"])
