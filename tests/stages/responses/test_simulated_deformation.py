"""The measured K against a simulated one: exactly the wrong entry of the simulation differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Targets
from tests.blind.generator.schedule import published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.sentences import assert_says
from tests.stages.line import run_line
from truing.report.deformation_section import deformation, deformation_verdict
from truing.schemas.verdict import ReasonCode

_K = np.asarray(PUBLISHED_K)


def _campaign(folder: Path, simulated: np.ndarray, platform: int = 8) -> Path:
    targets = Targets(base=8, platform=platform, per_leg=0)
    layout = Layout(name="bent", targets=targets, faults=DataFaults(0.0, 0.0))
    campaign = draw_campaign(layout, published_moves(), [MatrixDeformation(_K)], np.random.default_rng(11))
    made = write_campaign(campaign, folder, 11)
    np.savetxt(made / "k.csv", simulated)
    text = (made / "campaign.toml").read_text(encoding="utf-8")
    text = text.replace("[mechanism]", '[mechanism]\ndeformation_file = "k.csv"', 1)
    (made / "campaign.toml").write_text(text, encoding="utf-8")
    return made


def _deformation_of(folder: Path, simulated: np.ndarray, platform: int = 8) -> tuple[dict[str, pd.DataFrame], str]:
    tables, outcomes = run_line(_campaign(folder / "c", simulated, platform), "ingest", "pose", "deformation")
    frames = {name: table.to_pandas() for name, table in tables.items() if hasattr(table, "to_pandas")}
    return frames, outcomes["deformation"].figure


def _figures(tables: dict[str, pd.DataFrame], model: str = "matrix") -> dict[str, float]:
    rows = tables["deformation_errors"]
    rows = rows[(rows["model"] == model) & rows["leg"].isna()]
    return dict(zip(rows["figure"], rows["value"], strict=True))


def test_the_true_matrix_agrees(tmp_path: Path) -> None:
    tables, words = _deformation_of(tmp_path, _K)
    entries = tables["simulated_deformation"]
    low, high = (float(chi2.ppf(q, 36)) for q in (1e-3, 1 - 1e-3))
    assert low < _figures(tables)["agreement_chi_square"] < high
    assert set(entries["verdict"]) == {"agrees"}
    within = int((entries["pull"].abs() < 2.0).sum())
    assert within >= 30
    assert f"{within} of 36" in words
    assert _figures(tables, "simulated")["rms_error"] == pytest.approx(_figures(tables)["rms_error"], rel=0.15)


def test_a_wrong_entry_differs_and_no_other(tmp_path: Path) -> None:
    wrong = _K.copy()
    wrong[3, 2] += 0.012
    tables, _ = _deformation_of(tmp_path, wrong)
    entries = tables["simulated_deformation"].set_index(["leg", "column"])
    assert list(entries.index[entries["verdict"] == "differs"]) == [(4, 3)]
    row = entries.loc[4, 3]
    assert abs(row["difference"] + 0.012) < 4.0 * row["sigma"]
    page = deformation(tables)
    assert page is not None
    assert "K43 by -" in page.lead
    assert "does not explain" in page.lead
    assert _figures(tables)["agreement_without_plane_p_value"] < 1e-6  # a bend, and no other frame


def test_a_platform_softer_than_simulated_is_reported_by_its_factor(tmp_path: Path) -> None:
    tables, _ = _deformation_of(tmp_path, _K / 12.0)
    figures = _figures(tables)
    assert abs(figures["measured_over_simulated"] - 12.0) < 4.0 * figures["measured_over_simulated_sigma"]
    assert figures["agreement_p_value"] < 1e-20
    assert figures["scaled_p_value"] > 1e-3
    page = deformation(tables)
    assert page is not None
    assert_says(page.lead, "factor", "explains")


def test_a_matrix_known_modulo_a_plane_is_not_compared(tmp_path: Path) -> None:
    tables, words = _deformation_of(tmp_path, _K, platform=0)
    assert _figures(tables)["modulo_plane"] == 1.0
    assert "agreement_p_value" not in _figures(tables)
    assert len(tables["simulated_deformation"]) == 0
    assert "not compared" in words
    page = deformation(tables)
    assert page is not None
    assert_says(page.lead, "simulated K", "not compared")


def test_a_rigid_platform_that_was_simulated_to_bend_asks_for_attention(tmp_path: Path) -> None:
    tables, _ = _deformation_of(tmp_path, _K)
    errors = tables["deformation_errors"]
    rigid = errors["figure"].isin(["p_value_over_none", "p_value_over_linear"])
    tables["deformation_errors"] = errors.assign(value=errors["value"].where(~rigid, 0.5))
    assert deformation_verdict(tables, {}).reason_code is ReasonCode.RIGID
    agrees = tables["deformation_errors"]["figure"] == "agreement_p_value"
    tables["deformation_errors"].loc[agrees, "value"] = 1e-9
    assert deformation_verdict(tables, {}).reason_code is ReasonCode.DEFORMS
