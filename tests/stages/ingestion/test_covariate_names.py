"""A covariate may have any name except a column of its table, and is reported under it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pytest

from tests.blind.generator.draw import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Surroundings, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.blind.generator.strange import ReadingsFollow
from tests.cut_telescope import cut_telescope
from tests.stages.line import run_line
from truing.formats.raw_tables import CONFIGURATIONS, INTERFEROMETER, RawTable
from truing.schemas.columns import COLUMNS
from truing.schemas.covariates import column_alias, listed, names_in, own_name
from truing.simulation import inputs
from truing.simulation.bench import load_steps as steps_of_loads
from truing.simulation.bodies.causes.terms import CAME_FROM, place_columns
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.common.reading_arrays import load_steps
from truing.stages.predict import predict

BENCH = Path(__file__).resolve().parents[3] / "sample_data" / "force-sensor"
OF_LABORATORIES = [
    name
    for line in (
        "air_temperature_c air_pressure_hpa relative_humidity_pct humidity temp°C Öltemperatur Prüfkraft Zeit? T1",
        "T2 μm Temp. %rF p(hPa) wind_speed_m_s payload_kg operator shift day name id index count size level gain",
        "force load load_axis reading unit channel phase radius signal_x body target leg model sigma kappa value",
        "cause rank verdict time order approach memory time_in_run_s held_out x_mm px_mm cov_0_0 dx_mm rx_rad",
        "shown_fx_n v1_mv v_supply_mv rho_air rho0_mm a*b covariate:order purpose expected times conditions",
    )
    for name in line.split()
]
WITH_BLANKS = ["temp [C]", "last step", "own drive", "approach rho1_mm", "platform x", "direction of fx_n", 'say "hi"']


def _names(shape: RawTable) -> list[str]:
    """Names of all columns of all other tables, and of laboratories."""
    own = {*shape.required, *shape.optional}
    known = [name for name, column in COLUMNS.items() if not column.family]
    return [name for name in dict.fromkeys([*OF_LABORATORIES, *WITH_BLANKS, *known]) if name not in own]


def _with_covariates(path: Path, names: list[str], key: list[str]) -> dict[str, np.ndarray]:
    """Give every name a number of its own in each group of rows; return the numbers, ascending."""
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    group = table.groupby(key, sort=False).ngroup().to_numpy()
    values = {name: 1000.0 * place + 0.5 * np.arange(group.max() + 1) for place, name in enumerate(names)}
    pd.concat([table, pd.DataFrame({name: own[group] for name, own in values.items()})], axis=1).to_csv(
        path, index=False
    )
    return values


def _assert_all_there(found: dict[str, np.ndarray], given: dict[str, np.ndarray]) -> None:
    assert [name for name in given if name not in found] == []
    assert [name for name, values in given.items() if not np.array_equal(np.sort(found[name]), values)] == []


def test_configurations_carry_covariates_of_any_name(tmp_path: Path) -> None:
    folder = cut_telescope(tmp_path / "telescope")
    given = _with_covariates(folder / "configurations.csv", _names(CONFIGURATIONS), ["pose"])
    table = run_line(folder, "ingest")[0]["configurations"]
    _assert_all_there({own_name(name): table.column(name).to_numpy() for name in table.column_names}, given)
    poses = tuple(table.column("pose").to_pylist())
    known = pose_conditions(table, poses, 6, 1e-6).covariates
    program = (inputs.ORDER, *inputs.LOOKING_BACK)
    _assert_all_there({own_name(name): value for name, value in known.items() if name not in program}, given)
    assert np.array_equal(np.sort(known[inputs.ORDER]), np.arange(len(poses)))
    assert known[inputs.APPROACH].shape == (len(poses), 6)


def test_an_interferometer_carries_covariates_of_any_name(tmp_path: Path) -> None:
    shutil.copytree(BENCH, tmp_path / "bench")
    given = _with_covariates(tmp_path / "bench" / "interferometer.csv", _names(INTERFEROMETER), ["run", "step"])
    tables = run_line(tmp_path / "bench", "ingest")[0]
    plain = run_line(BENCH, "ingest")[0]
    steps, without = load_steps(tables), load_steps(plain)
    _assert_all_there({own_name(name): np.asarray(value) for name, value in steps.covariates.items()}, given)
    for name in ("load", "reading", "sigma", "signal", "held_out", "time_s"):
        assert np.array_equal(getattr(steps, name), getattr(without, name), equal_nan=True), name


def test_a_covariate_of_readings_and_one_of_signals_are_two_where_they_differ() -> None:
    def steps(table: str, values: list[float]) -> pa.Table:
        common = {"run": [1, 1], "step": [0, 1], "time_s": [0.0, 1.0], "t_c": values, "same": [5.0, 6.0]}
        loads = {name: [0.0, 1.0] for name in steps_of_loads.LOADS}
        own = {"channel": ["dx"] * 2, "reading": [0.0, 1.0], "unit": ["um"] * 2, "sigma": [0.1] * 2}
        return pa.table({**common, **loads, **(own if table == "readings" else {"v1_mv": [0.0, 1.0]})})

    found = load_steps({"readings": steps("readings", [20.0, 21.0]), "signals": steps("signals", [30.0, 31.0])})
    assert {name: list(values) for name, values in found.covariates.items()} == {
        "t_c": [20.0, 21.0],
        "same": [5.0, 6.0],
        "signals.t_c": [30.0, 31.0],
    }


@pytest.mark.parametrize("name", ["order", "temp [C]"])
def test_an_effect_of_a_covariate_is_reported_and_predicted_by_the_name_of_its_column(
    tmp_path: Path, name: str
) -> None:
    rng = np.random.default_rng(5)
    layout = Layout(
        name="small",
        targets=Targets(base=8, platform=7, per_leg=3),
        surroundings=Surroundings(columns=("humidity_pct",)),
    )
    effect = ReadingsFollow(np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0]), "humidity_pct")
    folder = write_campaign(
        draw_campaign(layout, [at_rest(), *random_moves(22, 0, rng)], [effect], rng), tmp_path / "small", 5
    )
    table = folder / "configurations.csv"
    table.write_text(table.read_text().replace("humidity_pct", name, 1))
    tables, _ = run_line(folder, "ingest", "pose", "diagnose")
    found = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]
    assert [(row["cause"], row["subject"]) for row in found] == [("unexplained", "leg3")]
    assert names_in(found[0]["follows"]) == (name,)
    assert name in found[0]["clause"]
    given = pyarrow.csv.read_csv(table)
    predicted = predict(tables["model"], given)
    shifted = given.set_column(given.column_names.index(name), name, pa.array(given.column(name).to_numpy() + 9.0))
    assert predicted.column("rx_rad").to_pylist() != predict(tables["model"], shifted).column("rx_rad").to_pylist()


def test_the_program_s_own_names_are_kept_apart() -> None:
    """Every name that a cause may follow without its being a column of the campaign."""
    of_steps = (inputs.ORDER, steps_of_loads.IN_RUN)
    of_drives = (CAME_FROM + "elevation_deg", *place_columns("platform"))
    for name in (*inputs.PER_ACTUATOR, inputs.ORDER, *of_steps, *of_drives):
        assert column_alias(name) != name
        assert own_name(column_alias(name)) == name
        assert column_alias(column_alias(name)) == column_alias(name)


def test_names_with_blanks_and_quotes_come_back_as_they_were_written() -> None:
    names = ("temp [C]", 'say "hi"', "plain", '"', "two  blanks", "rho1_mm")
    assert names_in(listed(names)) == names
    assert listed(["rho1_mm", "temperature_c"]) == "rho1_mm temperature_c"
    assert names_in("rho1_mm temperature_c") == ("rho1_mm", "temperature_c")
