"""A length that contradicts the others gives one message on the scale, and fails no other check."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pytest

from tests.photographs.machine import photograph
from tests.sentences import assert_says
from tests.stages.line import run_line
from truing.schemas.photograph_artifacts import LENGTH, LENGTH_SIGMA
from truing.stages.quality.scale_checks import Contradiction, figures_of, scale_contradiction

TOO_LONG = 2e-3


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plain") / "rays"
    photograph(folder, poses=2)
    return folder


def _tables(plain: Path, folder: Path, wrong: str, left_out: str = "") -> dict[str, Any]:
    shutil.copytree(plain, folder)
    bars = pd.read_csv(folder / "scale_bars.csv")
    bars.loc[bars["bar"] == wrong, "length_mm"] *= 1.0 + TOO_LONG
    bars[bars["bar"] != left_out].to_csv(folder / "scale_bars.csv", index=False)
    return run_line(folder, "images", "bundle", "ingest", "qa")[0]


def _failed(tables: dict[str, Any]) -> pd.DataFrame:
    qa = tables["qa"].to_pandas()
    return qa[qa["verdict"].isin(["fail", "warn"])]


def test_the_survey_decides_which_of_two_bars_is_wrong(plain: Path, tmp_path: Path) -> None:
    (row,) = _failed(_tables(plain, tmp_path / "two", "S")).itertuples()
    assert (row.check, row.verdict, row.unit) == ("scale", "fail", "mm/m")
    assert row.value == pytest.approx(1e3 * TOO_LONG, rel=0.05)
    assert_says(row.message, "bar S", "contradicts", "bar T", "survey", "scale")


def test_one_bar_against_the_survey_fails_without_a_name(plain: Path, tmp_path: Path) -> None:
    (row,) = _failed(_tables(plain, tmp_path / "one", "S", left_out="T")).itertuples()
    assert (row.check, row.verdict) == ("scale", "fail")
    assert_says(row.message, "One", "wrong")


def _contradiction(**ratios: float) -> Contradiction | None:
    rows = [
        {"figure": figure, "subject": name.replace("_", " "), "value": value if figure == LENGTH else 1e-5}
        for name, value in ratios.items()
        for figure in (LENGTH, LENGTH_SIGMA)
    ]
    return scale_contradiction(figures_of(pa.Table.from_pylist(rows)))


def test_lengths_that_agree_contradict_nothing() -> None:
    assert _contradiction(bar_S=1.0, bar_T=1.0003, survey_of_base=0.9998, survey_of_platform=1.0001) is None
    assert _contradiction(bar_S=1.0) is None


def test_bodies_of_a_survey_are_one_statement() -> None:
    found = _contradiction(bar_S=1.002, bar_T=1.002, survey_of_base=1.0, survey_of_platform=1.0, survey_of_leg1=1.0)
    assert found is not None
    assert found.odd == ("the survey",)
    assert found.by == pytest.approx(-TOO_LONG, rel=0.01)
