"""Statements of uncertainty agree with the tables that they state, and their parts are complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.cut_telescope import SAMPLE, cut_telescope
from tests.sensor_campaign import campaign_toml, measured, write_campaign
from tests.stages.line import run_line
from truing.estimation.sensor.budget import BY_LOADS, coefficient_parts
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, Estimator
from truing.estimation.sensor.load_table import load_table
from truing.estimation.uncertainty_budget import Source, root_mean_square

Frames = dict[str, pd.DataFrame]
CHAIN = """[signals.chain]
rated_load_n = 1000.0
output_mv_per_v = 2.0
output_sigma_mv_per_v = 0.01
supply_v = 10.0
"""


def _frames(folder: Path, *stages: str) -> Frames:
    tables, _ = run_line(folder, *stages, "uncertainty")
    return {name: table.to_pandas() for name, table in tables.items() if hasattr(table, "to_pandas")}


@pytest.fixture(scope="module")
def telescope(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    return _frames(cut_telescope(tmp_path_factory.mktemp("gum") / "t"), "ingest", "pose", "deformation", "calibrate")


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    folder = tmp_path_factory.mktemp("gum") / "sensor"
    write_campaign(
        folder, *measured(np.random.default_rng(5)), campaign_toml(more="load_n = 2.0\nload_nm = 0.1\n" + CHAIN)
    )
    return _frames(folder, "ingest", "pose", "deformation", "calibrate")


def _of(frames: Frames, result: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    stated, parts = frames["uncertainty"], frames["uncertainty_budget"]
    own = parts[(parts["result"] == result) & (parts["evaluation"] != "not evaluated")]
    return stated[(stated["result"] == result) & stated["stated"]], own


@pytest.mark.parametrize(
    ("campaign", "results"),
    [("telescope", ("pose", "calibration", "accuracy")), ("sensor", ("compliance", "G_B", "G_B'", "load", "accuracy"))],
)
def test_parts_of_every_result_sum_to_its_uncertainty(request: Any, campaign: str, results: tuple[str, ...]) -> None:
    frames = request.getfixturevalue(campaign)
    for result in results:
        stated, parts = _of(frames, result)
        assert len(stated), result
        place = ["subject", "quantity"]
        squares = (parts["contribution"] ** 2).groupby([parts[name] for name in place]).sum()
        reported = stated.set_index(place)["standard_uncertainty"] ** 2
        assert squares.reindex(reported.index).to_numpy() == pytest.approx(reported.to_numpy(), rel=1e-9)
        shares = parts.groupby(place)["share_of_variance"].sum()
        assert shares.to_numpy() == pytest.approx(1.0, abs=1e-9)
        product = stated["coverage_factor"] * stated["standard_uncertainty"]
        assert product.to_numpy() == pytest.approx(stated["expanded_uncertainty"].to_numpy())


def test_poses_are_stated_with_the_uncertainty_that_their_table_has(telescope: Frames) -> None:
    stated, parts = _of(telescope, "pose")
    table = telescope["poses"]
    rows = table[table["default"] & (table["body"] == "platform")]
    own = stated[stated["quantity"] == "pz"]
    assert own["estimate"].tolist() == pytest.approx(rows["pz_mm"].tolist())
    assert own["standard_uncertainty"].tolist() == pytest.approx((1e3 * np.sqrt(rows["cov_2_2"])).tolist(), rel=1e-6)
    assert {"points of platform, as declared", "survey of base, as declared"} <= set(parts["input_source"])


def test_numbers_of_the_mechanism_are_stated_with_the_sigma_of_the_chosen_calibration(telescope: Frames) -> None:
    choice, table = telescope["model_choice"], telescope["calibration"]
    chosen = choice[(choice["figure"] == "chosen") & (choice["value"] == 1.0)].iloc[0]
    rows = table[(table["model"] == chosen["model"]) & (table["deformation"] == chosen["deformation"])]
    stated, parts = _of(telescope, "calibration")
    assert stated["standard_uncertainty"].tolist() == pytest.approx(rows["sigma"].tolist(), rel=1e-3)
    assert {"readings of the actuators", "tolerance of the lower joints"} <= set(parts["input_source"])
    # so few poses leave the directions of the actuators to their tolerance
    own = parts[(parts["quantity"] == "u_x of leg 1") & parts["input_source"].str.startswith("tolerance of the dir")]
    assert own["share_of_variance"].item() > 0.5


def test_noise_beyond_what_was_declared_is_of_type_a(tmp_path: Path) -> None:
    folder = cut_telescope(tmp_path / "t")
    points = pd.read_csv(folder / "points.csv")
    assert not [name for name in points if name.startswith("sigma")]
    settings = (folder / "campaign.toml").read_text().replace("point_mm = 0.005", "point_mm = 0.002")
    (folder / "campaign.toml").write_text(settings)
    _, parts = _of(_frames(folder, "ingest", "pose"), "pose")
    beyond = parts[parts["input_source"] == "scatter of the points of platform beyond that"]
    declared = parts[parts["input_source"] == "points of platform, as declared"]
    assert set(beyond["evaluation"]) == {"A"}
    ratio = np.sqrt(1.0 + (beyond["contribution"].to_numpy() / declared["contribution"].to_numpy()) ** 2)
    dof = beyond["degrees_of_freedom"].iloc[0]
    assert ratio == pytest.approx(2.5, abs=2.5 * 4.0 / np.sqrt(2.0 * dof))


def test_the_sensitivity_of_the_cells_is_a_source_of_the_matrix_of_leg_forces(sensor: Frames) -> None:
    stated = sensor["uncertainty"].set_index("result")
    volts, forces = stated.loc["G_B"], stated.loc["G_B'"]
    assert np.allclose(forces["estimate"], 0.02 * volts["estimate"].to_numpy(), rtol=1e-12)
    tolerance = 0.005 * np.abs(forces["estimate"])
    expected = np.hypot(0.02 * volts["standard_uncertainty"].to_numpy(), tolerance.to_numpy())
    assert np.allclose(forces["standard_uncertainty"], expected, rtol=1e-12)
    parts = sensor["uncertainty_budget"].query('result == "G_B\'" and input_source.str.contains("cells")')
    assert np.allclose(np.sort(parts["contribution"]), np.sort(tolerance), rtol=1e-12)
    assert set(parts["evaluation"]) == {"B"}


def test_entries_are_stated_with_the_sigma_of_their_tables(sensor: Frames) -> None:
    table = sensor["compliance"]
    entries, parts = _of(sensor, "compliance")
    rows = table[table["model"] == "matrix"]
    assert entries["standard_uncertainty"].tolist() == pytest.approx(rows["sigma"].tolist(), rel=1e-9)
    assert {"noise of the readings", "applied loads, as declared"} <= set(parts["input_source"])
    matrix = sensor["sensor_matrix"]
    rows = matrix[matrix["chosen"] & (matrix["matrix"] == "G_B")]
    entries, _ = _of(sensor, "G_B")
    assert entries["estimate"].tolist() == pytest.approx(rows["value"].tolist())
    ratio = entries["standard_uncertainty"].to_numpy() / rows["sigma"].to_numpy()
    assert np.all(ratio >= 1.0 - 1e-9)
    by_case = rows["sigma_by_case"].to_numpy() / rows["sigma"].to_numpy()
    assert ratio[ratio > 1.0 + 1e-9] == pytest.approx(by_case[ratio > 1.0 + 1e-9])


@pytest.mark.parametrize("estimator", ["weighted", "errors in both"])
def test_errors_of_signals_and_of_loads_each_do_to_a_calibration_what_is_stated(estimator: Estimator) -> None:
    rng = np.random.default_rng(6)
    loads, gain = np.repeat([-1.0, 1.0], 20)[:, None] * np.tile(np.eye(2), (20, 1)), np.array([[2.0, 0.5], [0.3, -1.0]])
    signal, load = np.diag([1e-4, 4e-4]), np.diag([1e-4, 1e-5])
    model, names = CalibrationModel(estimator, "forward", zero="common"), ("fx", "fy")
    draws = 150 if estimator == "weighted" else 40
    for errs, source in ((signal, Source("signals", "B")), (load, BY_LOADS)):
        found = []
        for _ in range(draws):
            noise = rng.normal(size=(40, 2)) * np.sqrt(np.diag(errs))
            seen, reported = (noise, 0.0) if errs is signal else (0.0, noise)
            table = load_table(loads @ gain.T + seen, loads + reported, signal_cov=signal, load_cov=load).named(
                loads=names
            )
            fit = fit_calibration(table, model)
            found.append(np.concatenate([fit.matrix, fit.zeros], 1).ravel())
        stated = np.diag(coefficient_parts(fit, table, Source("signals", "B"))[source])
        ratio = np.sum(np.var(found, axis=0, ddof=1) / stated) / len(stated)
        # draws of six numbers; those of a row are independent here
        assert abs(ratio - 1.0) < 4.0 * np.sqrt(2.0 / (draws * len(stated)))


def test_loads_from_one_reading_err_as_far_as_is_stated(sensor: Frames) -> None:
    """The rms error of 102 held-out readings, nearly all of it their own noise, is that of a reading as stated."""
    stated, _ = _of(sensor, "load")
    held, _ = _of(sensor, "accuracy")
    ratio = held["estimate"].to_numpy() / stated["standard_uncertainty"].to_numpy()
    assert np.all(np.abs(ratio - 1.0) < 4.0 / np.sqrt(2.0 * 102.0))


def test_a_root_mean_square_of_few_errors_scatters_as_is_stated() -> None:
    rng = np.random.default_rng(3)
    draws = [root_mean_square(rng.normal(size=40)) for _ in range(800)]
    scatter = np.std([value for value, _ in draws])
    typical = np.sqrt(np.mean([reported.standard[0] ** 2 for _, reported in draws]))
    assert typical == pytest.approx(scatter, rel=0.12)
    assert draws[0][1].dof == pytest.approx([39.0])


def test_a_result_without_uncertainty_gives_the_reason(tmp_path: Path) -> None:
    frames = _frames(cut_telescope(tmp_path / "t"), "ingest", "pose")
    left = frames["uncertainty"][~frames["uncertainty"]["stated"]]
    assert set(left["result"]) == {"calibration", "cause", "accuracy"}
    assert left["reason"].str.len().min() > 10


def test_stated_intervals_of_poses_and_geometry_cover_the_truth(telescope: Frames) -> None:
    """Of 54 components and 42 numbers as the sample was simulated, one in twenty may lie outside, more by chance."""
    truth = json.loads((SAMPLE.parent / "telescope.truth.json").read_text())
    geometry, poses = truth["geometry"], {f"{pose['pose']}": pose for pose in truth["poses"]}
    built = {f"{name}_{axis} of leg {leg + 1}": geometry[f"{name}_mm"][leg][k]
             for name in "ab" for leg in range(6) for k, axis in enumerate("xyz")}  # fmt: skip
    built |= {f"l of leg {leg + 1}": length for leg, length in enumerate(geometry["length_mm"])}
    off = []
    for row in _of(telescope, "pose")[0].itertuples():
        true = poses[row.subject.rpartition(" ")[2]]
        place = true["p_mm" if row.quantity[0] == "p" else "rotation_vector_rad"]["xyz".index(row.quantity[1])]
        off.append(abs(row.estimate - place) / row.expanded_uncertainty)
    assert len(off) == 54
    off += [
        abs(row.estimate - built[row.quantity]) / row.expanded_uncertainty
        for row in _of(telescope, "calibration")[0].itertuples()
        if row.quantity in built
    ]
    assert len(off) == 96
    assert np.mean(np.array(off) > 1.0) < 0.12  # twelve or more: a chance of 1 in 250, were they independent
    assert np.mean(np.array(off) < 0.5) < 0.85  # normal: 0.67; no uncertainty that is merely large
