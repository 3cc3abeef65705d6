"""Measurements of a chain: correlated poses, and distances next to points, with their frames."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from tests.simulation.mechanisms.chains.made_arms import arm, campaign
from tests.tolerance import assert_close
from truing.pipeline.command_line import app
from truing.simulation.mechanisms.chains.distances import DistanceModel
from truing.simulation.mechanisms.chains.motor_encoders import motor_terms
from truing.simulation.mechanisms.chains.target_causes import DistanceOffset
from truing.stages.common.chain_measurements import MeasuredLinks, measured_links, reference_link

COUNT = 4


def _poses(rng: np.random.Generator, body: str = "tip") -> tuple[pa.Table, np.ndarray]:
    """Measured poses of a link, and their full covariances (B, 6, 6), m and rad."""
    half = rng.normal(size=(COUNT, 6, 6)) * np.array([1e-5] * 3 + [1e-4] * 3)[:, None]
    covariance = half @ np.swapaxes(half, -1, -2)
    vectors = rng.normal(size=(COUNT, 6)) * np.array([500.0] * 3 + [0.5] * 3)
    columns = dict(zip(("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad"), vectors.T, strict=True))
    columns |= {f"cov_{i}_{j}": covariance[:, i, j] for i in range(6) for j in range(i, 6)}
    return pa.table({"pose": list(range(COUNT)), "body": [body] * COUNT, **columns}), covariance


def _measured(rng: np.random.Generator, *bodies: str) -> tuple[MeasuredLinks, np.ndarray]:
    tables, covariances = zip(*(_poses(rng, body) for body in bodies), strict=True)
    found = measured_links({"measured_poses": pa.concat_tables(tables)}, arm(), tuple(range(COUNT)))
    return found, covariances[0]


def test_a_position_and_an_orientation_with_covariance_weigh_as_one_pose() -> None:
    rng = np.random.default_rng(3)
    measured, covariance = _measured(rng, "tip")
    own = measured.decoupled()
    away = rng.normal(size=(COUNT, 6)) * 1e-4
    whole = np.einsum("bi,bij,bj->b", away, np.linalg.inv(covariance), away)
    model = campaign(rng, COUNT, 1, orientation=True)
    model = model.at(replace(model.conditions, coupling=measured.coupling))
    parts = model._decoupled(away.reshape(COUNT, 2, 3))
    squares = np.einsum("bki,bkij,bkj->b", parts, np.linalg.inv(own.cov), parts)
    assert_close(squares / whole, np.ones(COUNT), atol=1e-7)
    assert (np.linalg.det(own.cov[:, 0]) < np.linalg.det(measured.cov[:, 0])).all()


def test_measured_poses_need_an_instrument_that_stood_still() -> None:
    measured, _ = _measured(np.random.default_rng(4), "tip", "link2")
    with pytest.raises(ValueError, match="stood still"):
        reference_link(SimpleNamespace(is_frame_fixed=False), measured)  # type: ignore[arg-type]
    assert reference_link(SimpleNamespace(is_frame_fixed=True), measured) is None  # type: ignore[arg-type]


def test_derivatives_of_coordinates_and_distances_on_the_same_channels() -> None:
    rng = np.random.default_rng(5)
    model = campaign(rng, 6, 2, orientation=True)
    channels = model.channels
    coupling = np.zeros((6, 3, 3, 3))
    coupling[:, 1] = rng.normal(size=(6, 3, 3))
    conditions = replace(model.conditions, coupling=coupling)
    mixed = DistanceModel(
        model.tree,
        channels,
        replace(model.known, reading_sigma=np.full(5, 1e-4)),
        conditions,
        ends=np.array([[0, 1]]),
        coordinates=np.indices((3, 3)).reshape(2, -1).T,
    ).with_causes([DistanceOffset("P1", 3, 3.0)])
    shared, local = 0.01 * rng.normal(size=mixed.shared_size), rng.normal(size=(6, 5))
    found = mixed.predict(shared, local)
    assert found.values.shape == (6, 10, 1)
    assert mixed.channel_names[-2:] == ("tip z", "P0 to P1")
    assert mixed.is_angle.tolist() == [False] * 6 + [True] * 3 + [False]
    assert len(set(mixed.channel_groups)) == 3
    plain = replace(model, known=mixed.known).at(conditions).points(shared, local)
    assert_close(found.values[:, :9, 0], plain.reshape(6, -1), atol=0)
    off = mixed.points(np.zeros(mixed.shared_size), local)
    one = DistanceOffset("P1", 3, 3.0)
    longer = np.zeros(mixed.shared_size)
    longer[mixed.layout[one.key]] = 1e-3 / mixed.effect_sigma(one)
    assert_close(
        (mixed.points(longer, local) - off)[:, :, 0], 1e-3 * np.outer(np.arange(6) >= 3, np.arange(10) == 9), atol=1e-12
    )
    for j, step in enumerate(1e-4 * np.eye(mixed.shared_size)):
        slope = (mixed.points(shared + step, local) - mixed.points(shared - step, local)) / 2e-4
        assert_close(found.by_shared[..., j], slope, atol=2e-8)
    for j, step in enumerate(1e-3 * np.eye(5)):
        slope = (mixed.points(shared, local + step) - mixed.points(shared, local - step)) / 2e-3
        assert_close(found.by_local[..., j], slope, atol=1e-9)


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of points next to distances to stations; a joint has an error once per turn."""
    made = draw(1, instrument="points-and-distances", causes=("joint-eccentricity",), strength=15.0, poses=50)
    return write(made, tmp_path_factory.mktemp("beside") / "arm")


def _diagnosed(campaign: Path) -> list[dict[str, Any]]:
    done = CliRunner().invoke(app, ["run", str(campaign), "--only", "diagnose", "--out", str(campaign) + "-run"])
    assert done.exit_code == 0, done.output
    return pq.read_table(str(campaign) + "-run/diagnosis.parquet").to_pylist()


def test_distances_next_to_points_are_evaluated_together(beside: Path) -> None:
    rows = _diagnosed(beside)
    (hidden,) = json.loads(beside.with_name("arm.truth.json").read_text(encoding="utf-8"))["effects"]
    (found,) = [row for row in rows if row["verdict"] == "found"]
    assert (found["cause"], found["subject"]) == (hidden["cause"], hidden["subject"])
    sizes = json.loads(found["parameters"])
    for name in ("sine", "cosine"):
        assert abs(sizes[name]["value"] - hidden["parameters"][name]["value"]) < 4.0 * sizes[name]["sigma"]
        assert 0.0 < sizes[name]["sigma"] < 0.3 * abs(hidden["parameters"]["sine"]["value"])
    fitted = pq.read_table(str(beside) + "-run/prediction.parquet").to_pandas()
    assert len(fitted) == 50
    assert fitted["rms_after"].mean() < fitted["rms_before"].mean()


def test_distances_next_to_points_need_one_frame(beside: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(beside, tmp_path / "arm")
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(text.replace('frame = "campaign"', 'frame = "series"'), encoding="utf-8")
    table = pyarrow.csv.read_csv(folder / "configurations.csv")
    if "series" not in table.schema.names:
        table = table.append_column("series", pa.array(["a", "b"] * (len(table) // 2)))
        pyarrow.csv.write_csv(table, folder / "configurations.csv")
    done = CliRunner().invoke(app, ["run", str(folder), "--only", "diagnose", "--out", str(tmp_path / "run")])
    assert "stood still" in " ".join(done.output.split())


def test_a_motor_encoder_is_compared_with_its_joint() -> None:
    rng = np.random.default_rng(8)
    machine = campaign(rng, 80).machine
    q, came, torque = machine.readings[:, 1], machine.approach[:, 1], machine.torque(1)
    hidden = {"lost_motion": 3e-4, "wind_up": 2e-5, "sine 1": 4e-4, "cosine 1": -2e-4}
    away = 3e-4 * came + 2e-5 * torque + 4e-4 * np.sin(q) - 2e-4 * np.cos(q)
    motor = -101.0 * (q + 0.3 + away + 2e-5 * rng.normal(size=80))
    motor[5] = np.nan
    terms = {term.parameter: term for term in motor_terms(machine, 1, motor)}
    assert abs(terms["ratio"].value + 101.0) < 0.1
    for name, size in hidden.items():
        assert abs(terms[name].value - size) < 3.5 * terms[name].sigma < 0.5 * abs(size)
    assert 1.5e-5 < terms["remainder"].value < 2.5e-5 < 1e-4 < terms["difference"].value


def test_a_term_that_poses_do_not_determine_has_no_size() -> None:
    machine = campaign(np.random.default_rng(8), 80).machine
    terms = {term.parameter: term for term in motor_terms(machine, 0, machine.readings[:, 0])}
    assert terms["wind_up"].value is None  # its axis is vertical
    assert abs(terms["ratio"].value - 1.0) < 1e-9
    assert not motor_terms(machine, 0, np.where(np.arange(80) < 9, machine.readings[:, 0], np.nan))


def test_a_motor_encoder_of_a_campaign_is_on_the_page_and_no_cause_follows_it(beside: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(beside, tmp_path / "arm")
    table = pyarrow.csv.read_csv(folder / "configurations.csv")
    column = next(name for name in table.schema.names if name.endswith(("_deg", "_rad")))
    joint, unit = column.rsplit("_", 1)
    motor = 50.0 * table.column(column).to_numpy() + np.random.default_rng(1).normal(0.0, 0.05, len(table))
    pyarrow.csv.write_csv(table.append_column(f"{joint}_motor_{unit}", pa.array(motor)), folder / "configurations.csv")
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert done.exit_code == 0, done.output
    rows = {row["parameter"]: row for row in pq.read_table(tmp_path / "run" / "motor_encoders.parquet").to_pylist()}
    assert {row["joint"] for row in rows.values()} == {joint}
    assert abs(rows["ratio"]["value"] - 50.0) < 4.0 * rows["ratio"]["sigma"]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "ratio of motor to joint" in page
    found = pq.read_table(tmp_path / "run" / "diagnosis.parquet").to_pylist()
    assert not any("motor" in row["follows"] + row["settings"] for row in found)
