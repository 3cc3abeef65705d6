"""Runs of one robot without tolerances, whole way: a zero that slipped and a joint that softened are named alone."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms.robot import COMPLIANCE
from tests.report.explained import unexplained
from tests.runs.two_arms import measured, offset
from truing.pipeline.command_line import app

pytestmark = pytest.mark.slow

SLIP, SOFTER = 3e-4, 1.3  # rad, of the elbow; compliance of the shoulder after, relative to before


def _truing(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.output
    return " ".join(done.output.split())


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, str, str]:
    """Rows of compared.parquet, what the command said, and its page."""
    home = tmp_path_factory.mktemp("arms")
    campaigns = [measured(home / name, seed, tolerance=False) for name, seed in (("spring", 1), ("summer", 2))]
    campaigns.append(measured(home / "autumn", 3, [offset(2, SLIP)], tolerance=False, soft=SOFTER))
    for folder in campaigns:
        _truing("run", str(folder), "--only", "uncertainty", "--out", str(home / "runs" / folder.name))
    runs = [str(home / "runs" / folder.name) for folder in campaigns]
    said = _truing("compare", *runs, "--out", str(home / "found"))
    page = (home / "found" / "comparison.html").read_text(encoding="utf-8")
    return pq.read_table(home / "found" / "compared.parquet").to_pandas(), said, page


def test_nothing_changes_between_two_campaigns_of_one_state(compared: tuple[pd.DataFrame, str, str]) -> None:
    of_second = compared[0].query("place == 2")
    assert not of_second["changed"].any()
    assert of_second["z"].notna().sum() > 20


def test_the_slipped_zero_and_the_softer_joint_are_named_alone_with_their_sizes(
    compared: tuple[pd.DataFrame, str, str],
) -> None:
    changed = compared[0].query("place == 3 and changed").set_index("effect_of")
    assert set(changed.index) == {"joint-offset joint elbow", "joint-compliance joint shoulder"}
    for name, true in (
        ("joint-offset joint elbow", SLIP),
        ("joint-compliance joint shoulder", (SOFTER - 1.0) * COMPLIANCE),
    ):
        row = changed.loc[name]
        assert abs(row["change"] - true) < 4.0 * row["sigma_change"] < 0.3 * true


def test_a_number_without_a_test_has_a_reason(compared: tuple[pd.DataFrame, str, str]) -> None:
    later = compared[0].query("place > 1")
    untested = later["z"].isna()
    assert (later["reason"].notna() == untested).all()
    assert np.isfinite(later.loc[~untested, "sigma_difference"]).all()


def test_the_page_names_no_effect_as_new_that_the_run_before_suspected(
    compared: tuple[pd.DataFrame, str, str],
) -> None:
    _, said, page = compared
    assert "2 of " in said
    assert "found for the first time" not in said
    assert "no longer found" not in said
    assert not unexplained(page)
