"""Predictions with found causes require exactly the columns on which the causes depend."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from tests.faults import assert_fault, faults_of
from tests.simulation.mechanisms.made_models import OFFERED, made_model
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.extended_model import acts_on_poses, write_model
from truing.stages.predict import predict

RHO = [f"rho{leg}_mm" for leg in range(1, 7)]


def _configurations(*columns: str) -> pa.Table:
    rng = np.random.default_rng(3)
    readings = {name: 10.0 + rng.uniform(-1.0, 1.0, 4) for name in RHO}
    more = {"time_s": [0.0, 60.0, 120.0, 180.0], "temperature_c": [19.0, 20.0, 21.0, 22.0]}
    more["humidity"] = [40.0, 41.0, 42.0, 43.0]
    return pa.table({"pose": [1, 2, 3, 4], **readings, **{name: more[name] for name in columns}})


def _text(cause: Cause) -> str:
    return write_model(made_model(np.random.default_rng(1), (cause,)))


@pytest.mark.parametrize("cause", OFFERED, ids=lambda cause: cause.key)
def test_with_the_columns_that_it_needs_every_cause_predicts(cause: Cause) -> None:
    needed = [name for name in cause.needs(6) if name not in RHO] if acts_on_poses(cause) else []
    found = predict(_text(cause), _configurations(*needed)).to_pydict()
    assert found["status"] == ["ok"] * 4
    assert np.isfinite([found[name] for name in ("px_mm", "rz_rad", "cov_0_0", "cov_5_5")]).all()
    for name in needed:
        fewer = _configurations(*(n for n in needed if n != name))
        fault = assert_fault(faults_of(lambda table=fewer: predict(_text(cause), table, "there.csv")), column=name)
        assert cause.id in fault.expected


def test_a_value_that_is_no_number_is_named_where_an_editor_finds_it() -> None:
    cause = next(one for one in OFFERED if one.id == "leg-drift")
    table = _configurations("time_s")
    broken = table.set_column(table.schema.get_field_index("time_s"), "time_s", pa.array([0.0, None, 1.0, 2.0]))
    for file, row in (("there.csv", 3), ("there.parquet", 2)):
        faults = faults_of(lambda file=file: predict(_text(cause), broken, file))
        assert_fault(faults, file=file, row=row, column="time_s", value="nan")
