"""Diagnosis of a force sensor without an interferometer, from signals and loads alone."""

from __future__ import annotations

import tomllib

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.sensor_campaign import GAIN, HEIGHT_MM, LARGEST, LOWER_MM, SIGNAL_MV, UPPER_MM, campaign_toml
from tests.tolerance import assert_between, assert_close
from truing.schemas.campaign import read_campaign
from truing.simulation.bench.causes.rows_exchanged import exchanged_rows, with_corrected_loads
from truing.simulation.bench.six_upur.geometry import joint_centres
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps
from truing.stages.diagnosis.search import assembled_data


@pytest.fixture
def rng():
    return np.random.default_rng(5)


WITHOUT = {"campaign": {"name": "c", "kind": "interferometer"}, "noise": {"signal_mv": SIGNAL_MV}}


def signals(rng):
    """Signals of legs that carry what the geometry says, one run of seven steps per axis, up and down."""
    share = np.array([0.0, 0.5, 1.0, 0.25, -0.5, -1.0, -0.25])
    loads = np.concatenate([np.outer(share, largest * axis) for largest, axis in zip(LARGEST, np.eye(6), strict=True)])
    joints = joint_centres(LOWER_MM * 1e-3, UPPER_MM * 1e-3, HEIGHT_MM * 1e-3)
    reported = GAIN * np.linalg.solve(influence_matrix(joints), loads.T).T
    reported += SIGNAL_MV * rng.normal(size=reported.shape)
    steps = {"run": np.repeat(np.arange(6) + 1, 7), "step": np.tile(np.arange(7), 6), "time_s": 60.0 * np.arange(42)}
    columns = steps | dict(zip(LOAD_COLUMNS, loads.T, strict=True))
    return pd.DataFrame(columns | {f"v{leg + 1}_mv": reported[:, leg] for leg in range(6)})


def exchange(table, first, second, column):
    at = table.index[(table["run"] == first[0]) & (table["step"] == first[1])].tolist()
    at += table.index[(table["run"] == second[0]) & (table["step"] == second[1])].tolist()
    table.loc[at, column] = table.loc[at[::-1], column].to_numpy()
    return table


def gathered(table: pd.DataFrame, document):
    return assembled_data({"signals": pa.Table.from_pandas(table)}, read_campaign(document))


def predicted(found, effects=()):
    """Signals (B, 6), mV, of the simulation with what is certain in it."""
    model = found.model.with_causes(found.given if effects is None else effects)
    return 1e3 * model.points(np.zeros(model.shared_size), np.zeros((len(model.conditions.load), 0)))[:, 6:, 0]


def test_rows_that_were_exchanged_are_certain_without_geometry_or_declared_noise(rng):
    found = gathered(exchange(signals(rng), (3, 1), (3, 3), "fz_n"), {"campaign": WITHOUT["campaign"]})
    assert [cause.subject for cause in found.given] == ["run 3"]
    reported = {one.name: one.value for one in found.given[0].reported(np.zeros(0), np.zeros((0, 0)), 6)}
    assert reported == {"rows": "3/1 3/3", "components": "fz"}
    noise = 1e3 * np.sqrt(found.calibration.measured.covariance[0, 6:, 0, 0])
    assert_between(noise.min(), 0.5 * SIGNAL_MV, SIGNAL_MV)
    assert_between(noise.max(), SIGNAL_MV, 1.6 * SIGNAL_MV)


def test_a_cause_of_exchanged_rows_puts_the_loads_right(rng):
    document = drawn(sensitivity_mv_per_n=GAIN, sensitivity_tolerance=0.0)
    good, table = signals(rng), exchange(signals(rng), (3, 1), (5, 3), ["fz_n", "my_nm"])
    right, found = gathered(good, document), gathered(table, document)
    assert_close(predicted(found, None), predicted(right), atol=1e-9)
    assert np.abs(predicted(found) - predicted(right)).max() > 1.0


def test_loads_are_put_back_in_their_row(rng):
    tables = [signals(rng), None]
    tables[1] = exchange(tables[0].copy(), (3, 1), (5, 3), ["fz_n", "my_nm"])
    right, wrong = (load_steps({"signals": pa.Table.from_pandas(table)}) for table in tables)
    found = exchanged_rows(wrong, np.ones(len(wrong.run), bool))
    assert_close(with_corrected_loads(wrong, found).load, right.load, atol=0.0)
    assert np.abs(wrong.load - right.load).max() > 0.0


def test_a_good_table_has_no_exchanged_rows(rng):
    steps = load_steps({"signals": pa.Table.from_pandas(signals(rng))})
    assert exchanged_rows(steps, np.ones(len(steps.run), bool)) == ()


def test_zeros_of_tared_signals_are_no_matter_of_choice(rng):
    tared, free = (gathered(signals(rng), drawn(**more)).model for more in ({"zero_mv": 0.05}, {}))
    assert (tared.zero_groups[:, 6:] == -1).all()
    assert (free.zero_groups[:, 6:] >= 0).all()
    zeros = tared.known.zeros
    assert_close(zeros.sigma[zeros.channel >= 6], np.full(36, 5e-5), atol=1e-12)
    assert zeros.known.all()


def test_constant_loads_say_nothing_where_each_run_has_a_zero_of_its_own(rng):
    table = signals(rng)
    table = table[table["step"].isin([1])]
    with pytest.raises(ValueError, match="needs loads that change within a run"):
        gathered(table, WITHOUT)
    assert gathered(table, {**WITHOUT, "signals": {"zero_mv": 0.05}}).calibration.measured.is_observed.any()


def drawn(**known):
    """The sensor by its drawing, without elements."""
    document = tomllib.loads(campaign_toml())
    del document["mechanism"]["elements"]
    return {**document, "signals": known}
