"""A long campaign of a chain: causes are searched in some of its poses, and the model is fitted to all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.arms import draw, write
from truing.pipeline.in_memory import stage_line
from truing.stages.diagnosis import chain_points

Diagnosed = Callable[[int], Any]
FEW = 30


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Diagnosed]:
    """Diagnosis of a robot with a gain by at most the given numbers of calibration and held-out poses."""
    folder = tmp_path_factory.mktemp("long") / "arm"
    write(draw(13, layout="scara", instrument="points-series", causes=("joint-gain",), poses=90, strength=30.0), folder)
    known: dict[int, Any] = {}
    with pytest.MonkeyPatch.context() as patch:

        def run(most: int) -> Any:
            if most not in known:
                patch.setattr(chain_points, "_MOST_NUMBERS", 0)
                patch.setattr(chain_points, "_ALWAYS", most)
                known[most] = stage_line(folder).call("ingest", "pose", "diagnose")
            return known[most]

        yield run


def test_the_errors_of_every_pose_are_reported_though_few_were_searched(diagnosed: Diagnosed) -> None:
    few, every = diagnosed(FEW), diagnosed(1000)
    assert "in the search for causes" in few.outcomes["diagnose"].left_out
    assert "in the search for causes" not in every.outcomes["diagnose"].left_out
    tables = [line.tables["prediction"].to_pandas().set_index("pose") for line in (few, every)]
    assert set(tables[0].index) == set(tables[1].index)
    assert (tables[0]["role"] == tables[1].loc[tables[0].index, "role"]).all()


def test_numbers_of_the_chain_are_those_of_a_fit_to_all_poses(diagnosed: Diagnosed) -> None:
    few, every = diagnosed(FEW), diagnosed(1000)
    named = [
        {row["cause"] for row in line.tables["diagnosis"].to_pylist() if row["verdict"] == "found"}
        for line in (few, every)
    ]
    assert named[0] == named[1] == {"joint-gain"}
    keys = ["joint", "parameter"]
    own, other = (line.tables["chain_parameters"].to_pandas().set_index(keys) for line in (few, every))
    np.testing.assert_allclose(own["sigma"], other.loc[own.index, "sigma"], rtol=0.05)
    moved = (own["identified"] - other.loc[own.index, "identified"]) / other.loc[own.index, "sigma"]
    assert np.abs(moved).max() < 0.2


def test_a_gross_error_in_a_pose_that_was_not_searched_is_listed(tmp_path: Path) -> None:
    folder = tmp_path / "arm"
    write(draw(13, layout="scara", instrument="points-series", poses=90, causes=()), folder)
    poses = pd.read_csv(folder / "configurations.csv")
    fitted = poses.loc[poses["role"] == "calibration", "pose"].to_numpy()
    searched = np.linspace(0, len(fitted) - 1, FEW).round().astype(int)
    wrong = np.delete(fitted, searched)[3]
    points = pd.read_csv(folder / "points.csv", dtype={"pose": type(wrong.item())})
    row = points.index[points["pose"] == wrong][0]
    points.loc[row, "x_mm"] += 5.0
    points.to_csv(folder / "points.csv", index=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chain_points, "_MOST_NUMBERS", 0)
        patch.setattr(chain_points, "_ALWAYS", FEW)
        line = stage_line(folder).call("ingest", "pose", "diagnose")
    rows = line.tables["diagnosis_left_out"].to_pylist()
    assert [row["pose"] for row in rows] == [wrong]
    assert "1 point as" in line.outcomes["diagnose"].left_out
