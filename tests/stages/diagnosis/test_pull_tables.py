"""Geometry biased by an omitted effect returns to its true values once the effect is modelled."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.generator.effects import ActuatorGain as Hidden
from tests.stages.two_campaigns import fitted, gathered, measured
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.stages.diagnosis.residual_tables import pull_tables

LEG, UNLUCKY = 3, 1e-3


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory):
    found = gathered(measured(tmp_path_factory.mktemp("pulls"), 31, [Hidden(0.06 * (np.arange(6) == LEG - 1))]))
    stands = [fitted(found, *causes) for causes in ((), (ActuatorGain((LEG,)),))]
    return pull_tables(*stands)


def test_both_tables_are_as_the_schema_says(tables) -> None:
    assert not [fault for name, table in tables.items() for fault in ARTIFACTS[name].faults(table)]
    assert tables["pulls"].num_rows == 6 * 9
    assert tables["pull_sums"]["model"].to_pylist() == ["plain", "extended"]


def test_the_sum_of_pulls_returns_into_its_band(tables) -> None:
    plain, extended = tables["pull_sums"].to_pylist()
    assert plain["p_value"] < UNLUCKY
    assert plain["chi_square"] > plain["upper"]
    assert extended["p_value"] > UNLUCKY
    assert 0 < extended["freedom"] <= sum(tables["pulls"]["identifiable"].to_pylist())
    assert extended["lower"] < extended["freedom"] < extended["upper"]


def test_only_what_the_data_show_has_a_pull(tables) -> None:
    rows = tables["pulls"].to_pandas()
    assert (rows["pull_after"].notna() == rows["identifiable"]).all()
    assert rows["pull_after"].abs().max() < 4.5
    assert rows["pull_before"].abs().max() > rows["pull_after"].abs().max()
    assert rows["offset_after"][rows["identifiable"]].notna().all()
    assert (np.sign(rows["offset_after"]) == np.sign(rows["pull_after"]))[rows["identifiable"]].all()
    assert set(rows["unit"][rows["parameter"] == "l"]) == {"mm"}
