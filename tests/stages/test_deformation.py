"""The deformation stage recovers the published K within its uncertainty, in an unbiased frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import InPlaneDeformation, LinearDeformation, MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Targets
from tests.blind.generator.schedule import published_moves
from tests.sentences import assert_says
from tests.stages.line import run_line

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "telescope"
LINE = ("ingest", "pose", "deformation")

K = 1e-3 * np.array(
    [
        [16, 0, -8, 12, -2, -20],
        [0, 20, -17, -1, 13, -13],
        [-2, -15, 14, 2, -9, 9],
        [6, -12, 4, 14, -16, 2],
        [-12, 7, 0, -15, 14, 4],
        [-20, -1, 10, -10, 2, 19],
    ]
)


@pytest.fixture(scope="module")
def sample():
    tables, said = run_line(SAMPLE, *LINE)
    return {name: table.to_pandas() for name, table in tables.items()}, said["deformation"]


def _coefficients(tables, model):
    rows = tables["deformation_models"]
    return rows[rows["model"] == model]


def _figures(tables, model):
    rows = tables["deformation_errors"]
    rows = rows[(rows["model"] == model) & rows["leg"].isna() & rows["subject"].isna()]
    return dict(zip(rows["figure"], rows["value"], strict=True))


def _band(dof: int) -> tuple[float, float]:
    return float(chi2.ppf(0.0005, dof)), float(chi2.ppf(0.9995, dof))


def test_sample_campaign_returns_the_published_matrix(sample):
    tables, _ = sample
    matrix = _coefficients(tables, "matrix")
    z = (matrix["coefficient"].to_numpy() - K.ravel()) / matrix["sigma"].to_numpy()
    low, high = _band(36)
    assert low < (z**2).sum() < high
    assert np.abs(z).max() < 4.0  # 36 normal deviates: beyond 4 once in 440 campaigns


def test_kappa_is_the_regression_of_the_matrix_on_its_own_actuator(sample):
    tables, _ = sample
    configurations = tables["configurations"]
    fitted = configurations[configurations["role"] != "verification"]
    drive = fitted[[f"rho{i}_mm" for i in range(1, 7)]].to_numpy() - 10.0
    centred = drive - drive.mean(axis=0)
    expected = (centred * (drive @ K.T)).sum(axis=0) / (centred**2).sum(axis=0)
    linear = _coefficients(tables, "linear")
    # The linear model's stated deviation is widened by what it cannot explain; here only noise tells the two apart.
    noise = linear["sigma"].to_numpy() / _figures(tables, "linear")["noise_ratio"]
    z = (linear["coefficient"].to_numpy() - expected) / noise
    assert (z**2).sum() < _band(6)[1]
    assert expected.mean() == pytest.approx(0.0132, abs=0.0002)


def test_residuals_of_the_matrix_agree_with_the_declared_noise(sample):
    tables, _ = sample
    figures = _figures(tables, "matrix")
    dof = int(figures["degrees_of_freedom"])
    low, high = _band(dof)
    assert low < dof * figures["noise_ratio"] ** 2 < high
    assert _figures(tables, "linear")["noise_ratio"] > 3.0


def test_matrix_earns_its_parameters_and_verification_shows_it(sample):
    tables, _ = sample
    assert _figures(tables, "matrix")["p_value_over_linear"] < 1e-20
    heldout = {model: _figures(tables, model)["verification_rms_error"] for model in ("none", "linear", "matrix")}
    assert heldout["matrix"] < 0.6 * min(heldout["linear"], heldout["none"])


def test_shifts_are_the_true_ones_within_their_sigma(tmp_path):
    squares, across = [], []
    for seed in range(6):
        folder = _campaign(
            tmp_path / str(seed), Layout(name="bodies", targets=Targets(per_leg=0)), MatrixDeformation(K), seed
        )
        shifts = run_line(folder, *LINE)[0]["deformation"].to_pandas()
        kept = shifts[~shifts["rejected"]]
        expected = np.concatenate([_expected(pose) for _, pose in kept.groupby("pose", sort=False)])
        squares.append(np.mean(((kept["delta_bz_um"] - expected) / kept["sigma_um"]) ** 2))
        across += [np.mean((kept[f"delta_b{axis}_um"] / kept[f"sigma_b{axis}_um"]) ** 2) for axis in "xy"]
    # About half the variance is the survey's, drawn once per leg and campaign: 36 draws, so the mean scatters by 0.12.
    assert abs(np.mean(squares) - 1.0) < 4 * 0.12
    assert abs(np.mean(across) - 1.0) < 4 * 0.12 / np.sqrt(2)  # along x and y: nothing moves there


def _expected(pose):
    leg = pose["leg"].to_numpy() - 1
    drive = np.zeros(6)
    drive[leg] = pose["delta_rho_mm"].to_numpy()
    return 1e3 * (K @ drive)[leg]


def _campaign(tmp_path, layout, effect, seed=3):
    rng = np.random.default_rng(seed)
    campaign = draw_campaign(layout, published_moves(), [effect] if effect else [], rng)
    return write_campaign(campaign, tmp_path / "campaign", seed)


def test_a_still_platform_shows_nothing(tmp_path):
    tables, _ = run_line(_campaign(tmp_path, Layout(name="still"), None), *LINE)
    tables = {name: table.to_pandas() for name, table in tables.items()}
    assert not _coefficients(tables, "matrix")["significant"].any()
    assert _figures(tables, "matrix")["rank"] == 0


def test_a_linear_deformation_does_not_call_for_a_matrix(tmp_path):
    kappa = np.array([0.02, -0.015, 0.01, 0.02, 0.03, -0.02])
    tables, _ = run_line(_campaign(tmp_path, Layout(name="linear"), LinearDeformation(kappa)), *LINE)
    tables = {name: table.to_pandas() for name, table in tables.items()}
    linear = _coefficients(tables, "linear")
    z = (linear["coefficient"].to_numpy() - kappa) / linear["sigma"].to_numpy()
    assert (z**2).sum() < _band(6)[1]
    assert _figures(tables, "matrix")["p_value_over_linear"] > 1e-3


def test_gross_errors_at_attachments_stay_in_the_table_with_their_reason(tmp_path):
    layout = replace(Layout(name="gross"), faults=DataFaults(missing_share=0.05, gross_share=0.03))
    tables, said = run_line(_campaign(tmp_path, layout, MatrixDeformation(K)), *LINE)
    tables = {name: table.to_pandas() for name, table in tables.items()}
    rejected = tables["deformation"][tables["deformation"]["rejected"]]
    assert len(rejected) > 0
    assert rejected["reason"].notna().all()
    assert str(len(rejected)) in said["deformation"].left_out
    matrix = _coefficients(tables, "matrix")
    z = (matrix["coefficient"].to_numpy() - K.ravel()) / matrix["sigma"].to_numpy()
    assert (z**2).sum() < _band(36)[1]


def test_without_targets_off_the_attachments_the_shape_is_known_modulo_a_plane(tmp_path):
    layout = Layout(name="bare", targets=Targets(base=12, platform=2, per_leg=0))
    tables, said = run_line(_campaign(tmp_path, layout, MatrixDeformation(K)), *LINE)
    tables = {name: table.to_pandas() for name, table in tables.items()}
    assert _figures(tables, "matrix")["modulo_plane"] == 1.0
    assert "modulo a plane" in said["deformation"].figure


def test_without_attachments_nothing_is_evaluated(tmp_path):
    layout = Layout(name="none", targets=Targets(on_attachments=(), per_leg=0))
    tables, said = run_line(_campaign(tmp_path, layout, None), *LINE)
    assert "not evaluated" in said["deformation"].figure
    assert tables["deformation"].num_rows == 0


def _few_poses(folder: Path, count: int, role: str | None = None) -> dict[str, Any]:
    """The deformation tables of a campaign of which ``count`` poses were kept, all with one role if it is given."""
    layout = Layout(name="few", targets=Targets(base=6, platform=6, per_leg=0), faults=DataFaults(0.0, 0.0))
    campaign = draw_campaign(layout, published_moves()[:count], [], np.random.default_rng(5))
    write_campaign(campaign, folder, seed=5)
    if role is not None:
        table = pd.read_csv(folder / "configurations.csv").assign(role=role)
        table.to_csv(folder / "configurations.csv", index=False)
    tables, said = run_line(folder, *LINE)
    return {name: table.to_pandas() for name, table in tables.items()} | {"why_not": said["deformation"].why_not}


@pytest.mark.parametrize(
    ("count", "models"), [(1, set()), (2, {"linear"}), (5, {"linear"}), (12, {"linear", "matrix", "in-plane"})]
)
def test_coefficients_that_so_few_poses_leave_open_are_not_reported(tmp_path, count, models):
    tables = _few_poses(tmp_path / "few", count)
    assert set(tables["deformation_models"]["model"]) == models
    assert (tables["deformation_models"]["sigma"] > 0.0).all()
    assert set(tables["deformation_errors"]["model"]) == models | {"none"}
    assert len(tables["deformation"]) == 6 * count


def test_a_campaign_of_verification_alone_is_not_evaluated(tmp_path):
    tables = _few_poses(tmp_path / "few", 4, "verification")
    assert_says(tables["why_not"], "every pose", "verification")


def test_a_platform_loaded_along_one_axis_gives_the_compliance_of_that_axis_alone(tmp_path):
    rng, steps = np.random.default_rng(1), 40
    table = pd.DataFrame({"run": 1, "step": range(1, steps + 1), "time_s": 10.0 * np.arange(steps)})
    table[["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]] = 0.0
    table["fz_n"] = 1000.0 * np.abs(np.linspace(-1.0, 1.0, steps))
    table[["dx_mm", "dy_mm", "dz_mm"]] = rng.normal(0.0, 1e-3, (steps, 3))
    table[["rx_rad", "ry_rad", "rz_rad"]] = rng.normal(0.0, 1e-6, (steps, 3))
    table["dz_mm"] += 1e-5 * table["fz_n"]
    table.to_csv(tmp_path / "displacement.csv", index=False)
    head = '[campaign]\nname = "one"\nkind = "interferometer"\n[noise]\ndisplacement_mm = 0.001\nrotation_rad = 1e-6\n'
    (tmp_path / "campaign.toml").write_text(head, encoding="utf-8")
    tables, _ = run_line(tmp_path, "ingest", "pose", "deformation")
    rows = tables["compliance"].to_pandas().query("model == 'matrix'").set_index("response")
    assert set(rows["load"]) == {"fz"}
    assert abs(rows.loc["dz", "coefficient"] - 1e-8) < 4.0 * rows.loc["dz", "sigma"]
    assert list(rows.index[rows["significant"]]) == ["dz"]


def _in_plane(tables) -> pd.DataFrame:
    return _coefficients(tables, "in-plane")


def test_shifts_in_the_plane_are_tested_and_not_assumed_away(sample, tmp_path):
    """The sample's platform bends along z alone; another one also shifts in its plane, by the stated amounts."""
    tables, _ = sample
    assert _figures(tables, "in-plane")["p_value_over_none"] > 1e-3
    low, high = _band(72)
    none = _in_plane(tables)
    assert low < ((none["coefficient"] / none["sigma"]) ** 2).sum() < high

    along = {"x": np.array([0.01, 0.0, 0.0, -0.02, 0.0, 0.0]), "y": np.array([0.0, 0.015, 0.0, 0.0, 0.0, 0.0])}
    found, _ = run_line(_campaign(tmp_path, Layout(name="plane"), InPlaneDeformation(along["x"], along["y"])), *LINE)
    found = {name: table.to_pandas() for name, table in found.items()}
    figures = _figures(found, "in-plane")
    assert figures["p_value_over_none"] < 1e-20
    assert figures["rms_left"] < 0.7 * figures["rms_shift"]
    rows = _in_plane(found)
    own = rows["leg"] == rows["column"]
    truth = np.array([along[axis][leg - 1] for axis, leg in zip(rows["axis"], rows["leg"], strict=True)]) * own
    assert low < (((rows["coefficient"] - truth) / rows["sigma"]) ** 2).sum() < high
    assert _figures(found, "linear")["p_value_over_none"] > 1e-3  # along z nothing moves
