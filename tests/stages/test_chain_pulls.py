"""All numbers of a chain against its tolerances: their sum has its distribution, and a wrong length shows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import chi2

from tests.blind.generator.arms import draw, write
from truing.inference.fitter import Fitter
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import chain_tables
from truing.stages.diagnosis.chain_parameters import parameters_table, pull_sums_table
from truing.stages.diagnosis.search import assembled_data


def _fitted(folder: Path) -> Any:
    campaign = open_campaign(folder)
    settings = campaign.validated()
    data = assembled_data(chain_tables(campaign, settings), settings)
    return Fitter(data.model, data.calibration, data.held_out, 0).prepared()


def _written(seed: int, folder: Path) -> Path:
    made = draw(seed, layout="industrial-6r", instrument="points", notation="standard", causes=(), poses=40)
    return write(made, folder / f"arm{seed}")


def test_geometry_drawn_from_its_tolerances_has_the_sum_that_chance_allows(tmp_path: Path) -> None:
    sums = [pull_sums_table(fitted, fitted) for fitted in (_fitted(_written(seed, tmp_path)) for seed in range(8))]
    last = [table.to_pylist()[1] for table in sums if table is not None]
    assert len(last) == 8
    total, freedom = (sum(row[name] for row in last) for name in ("chi_square", "freedom"))
    assert 0.0005 < chi2.sf(total, freedom) < 0.9995
    assert all(row["p_value"] > 1e-4 for row in last)


def test_a_length_of_another_variant_is_beyond_its_tolerance(tmp_path: Path) -> None:
    folder = _written(3, tmp_path)
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    longest = max(re.findall(r"a_mm = ([-0-9.]+)", text), key=lambda found: abs(float(found)))
    tolerance = re.search(r"length_mm = ([-0-9.]+)", text)
    assert tolerance is not None
    wrong = 20.0 * float(tolerance[1])
    changed = text.replace(f"a_mm = {longest}", f"a_mm = {float(longest) + wrong}", 1)
    assert changed != text
    (folder / "campaign.toml").write_text(changed, encoding="utf-8")
    fitted = _fitted(folder)
    table = pull_sums_table(fitted, fitted)
    assert table is not None
    assert table.to_pylist()[1]["p_value"] < 1e-9
    rows = [row for row in parameters_table(fitted).to_pylist() if row["pull"] is not None and row["identifiable"]]
    far = max(rows, key=lambda row: abs(row["pull"]))
    assert far["unit"] == "mm"
    assert abs(far["identified"]) == pytest.approx(wrong, rel=0.15)


def test_without_tolerances_of_links_only_toleranced_zeros_count(tmp_path: Path) -> None:
    folder = _written(4, tmp_path)
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    without = re.sub(r"(?m)^(length_mm|angle_deg) = .*\n", "", text)
    (folder / "campaign.toml").write_text(without, encoding="utf-8")
    fitted, whole = _fitted(folder), _fitted(_written(5, tmp_path))
    free, table = pull_sums_table(fitted, fitted), pull_sums_table(whole, whole)
    assert table is not None
    assert free is None or free.to_pylist()[1]["freedom"] < table.to_pylist()[1]["freedom"]
