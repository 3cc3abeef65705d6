"""A sensor with eight cells by command line: sensitivities of J_B', the chain of its cells, new wrenches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

import truing
from tests.ignored_causes import search_only
from tests.report.explained import unexplained
from tests.second_hand import eight_cells
from tests.second_hand.command import call, run
from tests.second_hand.eight_cells import MV_PER_N, OUTPUT, OUTPUT_SIGMA, Cells
from tests.tolerance import assert_between

LOADS = ["fx", "fy", "fz", "mx", "my", "mz"]
COLUMNS = ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]
ROWS = 400
Made = tuple[Path, dict[str, pd.DataFrame], Cells]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    place = tmp_path_factory.mktemp("cells")
    drawn, cells = eight_cells.campaign(5, [])
    folder = eight_cells.folder(place / "c", drawn, eight_cells.CHAIN)
    return place / "run", run(search_only(folder), "calibrate", place / "run"), cells


def _matrix(tables: dict[str, pd.DataFrame], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Values and sigmas (6, 8) of one matrix of the chosen calibration."""
    rows = tables["sensor_matrix"].query("matrix == @name and row in @LOADS")
    rows = rows[rows["column_name"].str.startswith("v") & rows["chosen"]]
    return tuple(
        rows.pivot(index="row", columns="column_name", values=part).loc[LOADS].to_numpy() for part in ("value", "sigma")
    )


def test_sensitivities_of_eight_cells_are_the_norms_of_their_forces(made: Made) -> None:
    _, tables, cells = made
    rows = tables["sensor_merit"].query("matrix == \"G_B'\" and figure == 'sensitivity' and length_m == 1.0")
    rows = rows.set_index("subject").loc[LOADS]
    off = (rows["value"].to_numpy() - np.linalg.norm(cells.forces, axis=0)) / rows["sigma"].to_numpy()
    # six figures of eight cells, whose tolerance is nearly all of their uncertainty
    assert_between(float(np.sum(off**2)), chi2.ppf(1e-3, 6), chi2.ppf(1 - 1e-3, 6), what="squares")


def test_cells_without_legs_of_their_own_have_no_type_1_and_2_errors(made: Made) -> None:
    rows = made[1]["sensor_merit"]
    assert not rows["figure"].str.startswith("type_").any()
    call("run", made[0].parent / "c", "--only", "report", "--out", made[0], "--quiet")
    page = (made[0] / "report.html").read_text(encoding="utf-8")
    assert "no channel has a leg to be compared with" in page
    assert not unexplained(page)


def test_the_chain_of_the_cells_gives_leg_forces_their_uncertainty(made: Made) -> None:
    """Eq. 33 and 34: G_B' = k / c G_B, its cells drawn within their tolerance."""
    (value, sigma), (reported, stated_sigma) = _matrix(made[1], "G_B"), _matrix(made[1], "G_B'")
    np.testing.assert_allclose(reported, value * MV_PER_N, rtol=1e-9)
    rng, draws = np.random.default_rng(2), 20_000
    cells = MV_PER_N * (1 + OUTPUT_SIGMA / OUTPUT * rng.normal(size=(draws, 1, 8)))
    drawn = (value + sigma * rng.normal(size=(draws, 6, 8))) * cells
    np.testing.assert_allclose(stated_sigma, drawn.std(0), rtol=4.5 / np.sqrt(2 * draws))


def test_wrenches_of_new_signals_cover_the_truth(made: Made, tmp_path: Path) -> None:
    folder, _, cells = made
    rng = np.random.default_rng(3)
    true = rng.uniform(-0.8, 0.8, (ROWS, 6)) * [9e3, 9e3, 9e3, 4.5e3, 4.5e3, 4.5e3]
    signals = cells.signals(true, rng)
    pd.DataFrame(signals, columns=[f"v{c + 1}_mv" for c in range(8)]).to_csv(tmp_path / "s.csv", index=False)
    call("predict", folder, tmp_path / "s.csv", "--out", tmp_path / "w.csv")
    found = pd.read_csv(tmp_path / "w.csv")
    wrench = truing.load(folder).sensor.wrench(signals)
    np.testing.assert_allclose(found[COLUMNS].to_numpy(), wrench.value, rtol=1e-6, atol=1e-6)
    off = found[COLUMNS].to_numpy() - true
    squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(wrench.covariance), off)
    # The error of the calibration, about a tenth of the variance, is common to all rows.
    assert_between(float(squares.mean() / 6), 0.85, 1.2, what="squares over freedom")
    inside = np.mean(squares < chi2.ppf(0.95, 6))
    assert_between(float(inside), 0.95 - 0.05, 0.95 + 0.04, what="share within 95 %")
