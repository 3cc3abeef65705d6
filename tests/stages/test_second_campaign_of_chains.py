"""Chains fitted to one campaign predict a second one; functions of readings are constant beyond their ranges."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.stages.line import run_line, settings_of
from truing.estimation.rotation import log_so3
from truing.inference.fitter import Fitter
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.simulation.mechanisms.chains.causes import JointCompliance
from truing.simulation.mechanisms.chains.extended_model import identified_conditions, read_chain, write_chain
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity
from truing.simulation.mechanisms.chains.notations import DenavitHartenberg, tree_of_rows
from truing.simulation.mechanisms.chains.tree import Tree, axis_twist
from truing.stages.chain.prediction import conditions_of
from truing.stages.diagnosis.chain_points import assemble
from truing.stages.diagnosis.chain_results import text_of_model
from truing.stages.second_campaign.compared import SecondCampaign
from truing.stages.second_campaign.errors import second_campaign_errors

JOINTS = ("a", "b", "c")
ROWS = ((0.0, 90.0, 300.0), (400.0, 0.0, 0.0), (300.0, 0.0, 50.0))
SIGMA_MM, SIGMA_RAD = 0.01, 2e-5
TOML = """
[campaign]
name = "{name}"
kind = "photogrammetry"
[mechanism]
type = "chain"
joints = ["a", "b", "c"]
gravity = [0.0, 0.0, -1.0]
payload_kg = 5.0
dh = [{rows}]
[measurement]
frame = "campaign"
[noise]
displacement_mm = {mm}
rotation_rad = {rad}
"""


def _tree() -> Tree:
    return tree_of_rows([DenavitHartenberg(1e-3 * a, np.radians(al), 1e-3 * d, 0.0) for a, al, d in ROWS], JOINTS)


def _measured(folder: Path, seed: int, low: float, high: float, compliance: float = 2e-5) -> Path:
    """A campaign of an arm whose joints give way under its payload, readings within a range, and the base elsewhere."""
    rng = np.random.default_rng(seed)
    tree, count = _tree(), 60
    q = rng.uniform(low, high, (count, 3))
    _, moment = tree.gravity_load(q, np.array([0.0, 0.0, -1.0]), {tree.size - 1: (np.full(count, 5.0), np.zeros(3))})
    twists = np.zeros((count, tree.size, 6))
    for k in range(1, 4):
        twists[:, k] = compliance * moment[:, k, 2, None] * axis_twist(tree.nodes[k])
    frames = tree.frames(q, twists)
    at = rng.normal(size=3)
    vectors = log_so3(frames.R[:, -1]) + SIGMA_RAD * rng.normal(size=(count, 3))
    places = 1e3 * (frames.t[:, -1] + at) + SIGMA_MM * rng.normal(size=(count, 3))
    numbers = pd.DataFrame({"pose": np.arange(1, count + 1)})
    folder.mkdir()
    numbers.assign(**{f"{j}_rad": q[:, k] for k, j in enumerate(JOINTS)}).to_csv(
        folder / "configurations.csv", index=False
    )
    columns = {f"{x}_mm": places[:, k] for k, x in enumerate("xyz")} | {
        f"r{x}_rad": vectors[:, k] for k, x in enumerate("xyz")
    }
    numbers.assign(body="tip", **columns).to_csv(folder / "poses.csv", index=False)
    rows = ", ".join(f"{{ a_mm = {a}, alpha_deg = {al}, d_mm = {d} }}" for a, al, d in ROWS)
    (folder / "campaign.toml").write_text(TOML.format(name=folder.name, rows=rows, mm=SIGMA_MM, rad=SIGMA_RAD))
    return folder


def _second(folder: Path) -> SecondCampaign:
    tables, _ = run_line(folder, "ingest", "pose")
    return SecondCampaign(str(folder / "campaign.toml"), settings_of(folder), tables)


def _model(folder: Path, *causes: type) -> str:
    second = _second(folder)
    settings = read_campaign(tomllib.loads((folder / "campaign.toml").read_text()))
    data = assemble(second.tables, settings)
    fitter = Fitter(data.model, data.calibration, None, 0)
    scene = fitter.fitted(()).scene
    return text_of_model(fitter.fitted(tuple(c for kind in causes for c in kind().candidates(scene))), settings)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    home = tmp_path_factory.mktemp("chains")
    return _measured(home / "first", 1, -1.2, 1.2), _measured(home / "second", 2, 0.5, 2.5)


def test_a_compliance_of_one_campaign_predicts_other_poses_to_their_noise(folders: tuple[Path, Path]) -> None:
    text = _model(folders[0], JointCompliance)
    rows = second_campaign_errors(text, _second(folders[1]), {})[0].to_pandas().set_index(["prediction_by", "quantity"])
    assert set(rows.index.get_level_values("quantity")) == {"position of tip", "orientation of tip"}
    assert (rows["count"] == 60).all()
    for quantity in ("position of tip", "orientation of tip"):
        nominal, extended = rows.loc[("nominal", quantity)], rows.loc[("extended", quantity)]
        assert nominal["rms_error"] > 5.0 * nominal["noise_rms"]
        # 6 of 360 numbers are fitted anew; 15 more were fitted to as many poses elsewhere.
        assert 0.8 < extended["rms_error"] / extended["noise_rms"] < 2.0


def test_another_chain_is_refused(folders: tuple[Path, Path]) -> None:
    text, second = _model(folders[0]), _second(folders[1])
    extended = read_chain(text)
    nodes = extended.tree.nodes
    elsewhere = tuple(replace(node, t=node.t + 1e-3) if node.joint == "b" else node for node in nodes)
    moved = replace(extended, tree=replace(extended.tree, nodes=elsewhere))
    renamed = replace(extended, tree=replace(extended.tree, readings=("a", "c", "b")))
    with pytest.raises(CampaignFaults, match="same nominal place of joint b"):
        second_campaign_errors(write_chain(moved), second, {})
    with pytest.raises(CampaignFaults, match=r"mechanism\.joints"):
        second_campaign_errors(write_chain(renamed), second, {})


def test_functions_of_a_reading_are_held_where_no_pose_was_measured(folders: tuple[Path, Path]) -> None:
    """A sine that was fitted to part of a turn is known there alone; a prediction beyond holds its last value."""
    extended = read_chain(_model(folders[0], JointEccentricity))
    assert np.all(np.abs(extended.measured) < 1.2)
    table = _second(folders[1]).tables["configurations"]
    conditions = conditions_of(extended, table)
    inside = replace(conditions, readings=np.clip(conditions.readings, *extended.measured))
    first, second = (identified_conditions(extended, own).deviations for own in (conditions, inside))
    assert np.array_equal(first, second)
    assert not np.array_equal(conditions.readings, inside.readings)
