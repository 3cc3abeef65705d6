"""Attachments that shift in the platform's plane: a calibration with these shifts predicts better than one without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import InPlaneDeformation, MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Targets
from tests.blind.generator.schedule import published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.stages.line import run_line
from truing.report.deformation_section import deformation

_ALONG = {
    "x": np.array([0.06, 0.05, -0.03, -0.04, 0.03, 0.06]),
    "y": np.array([-0.05, 0.04, 0.06, 0.05, -0.03, 0.04]),
}


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    layout = Layout(name="plane", targets=Targets(base=8, platform=8, per_leg=0), faults=DataFaults(0.0, 0.0))
    effects = [MatrixDeformation(np.asarray(PUBLISHED_K)), InPlaneDeformation(_ALONG["x"], _ALONG["y"])]
    campaign = draw_campaign(layout, published_moves(), effects, np.random.default_rng(5))
    folder = write_campaign(campaign, tmp_path_factory.mktemp("plane") / "c", 5)
    _set(folder, '\n[calibration]\ndeformation = "in-plane"\n')
    tables, _ = run_line(folder, "ingest", "pose", "deformation", "calibrate")
    return {name: table.to_pandas() for name, table in tables.items() if hasattr(table, "to_pandas")}


def _set(folder: Path, text: str) -> None:
    settings = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(settings + text, encoding="utf-8")


def _figure(tables: dict[str, pd.DataFrame], deformation: str, figure: str) -> float:
    rows = tables["model_choice"].query("estimator == 'errors-in-variables' and model == '6-pus'")
    rows = rows[(rows["deformation"] == deformation) & (rows["figure"] == figure)]
    return float(rows["value"].iloc[0])


def test_the_in_plane_model_is_chosen_and_predicts_held_out_poses_better(bent: dict[str, pd.DataFrame]) -> None:
    assert _figure(bent, "in-plane", "chosen") == 1.0
    assert _figure(bent, "in-plane", "heldout_ratio") < _figure(bent, "matrix", "heldout_ratio")
    rows = bent["accuracy"].query("role == 'verification' and model == '6-pus'").groupby("deformation")
    rms = rows["position_error_um"].apply(lambda errors: float(np.sqrt((errors**2).mean())))
    assert rms["in-plane"] < 0.8 * rms["matrix"]
    assert set(bent["accuracy"].query("deformation == 'in-plane'")["model"]) == {"6-pus"}


def test_fitted_coefficients_are_the_true_ones(bent: dict[str, pd.DataFrame]) -> None:
    rows = bent["calibration"].query("deformation == 'in-plane' and model == '6-pus'")
    own = rows[rows["parameter"].str.match(r"K[xy]\d\d")]
    truth = [_ALONG[name[1]][int(name[2]) - 1] * (name[2] == name[3]) for name in own["parameter"]]
    squares = ((own["identified"] - truth) / own["sigma"]) ** 2
    low, high = (float(chi2.ppf(q, 72)) for q in (1e-3, 1 - 1e-3))
    assert len(own) == 72
    assert low < squares.sum() < high


def test_a_deformation_determined_by_its_stage_is_not_called_unidentifiable(bent: dict[str, pd.DataFrame]) -> None:
    rows = bent["observability"].query("deformation == 'in-plane'")
    sigma = rows[(rows["figure"] == "sigma") & rows["combination"].str.startswith("Kx", na=False)]
    assert len(sigma) == 36
    assert sigma["value"].max() < 1.0  # better than the plausible size


def test_the_page_says_how_far_attachments_move_in_the_plane(bent: dict[str, pd.DataFrame]) -> None:
    page = deformation(bent)
    assert page is not None
    assert "Attachments also shift in the platform's plane" in page.lead
    found = bent["deformation_errors"].query("model == 'in-plane' and figure == 'rms_following'")["value"].iloc[0]
    fitted = bent["configurations"].query("role != 'verification'")["pose"]
    moved = bent["deformation"].pivot(index="pose", columns="leg", values="delta_rho_mm").loc[fitted].to_numpy()
    expected = 1e3 * np.sqrt(np.mean([(moved * along) ** 2 for along in _ALONG.values()]))
    assert found == pytest.approx(expected, rel=0.1)
    table = next(listing for listing in page.listings if listing.caption.startswith("Shifts of the attachments along"))
    assert len(table.rows) == 7
