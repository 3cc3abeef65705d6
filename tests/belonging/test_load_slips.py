"""Recording mistakes in loading campaigns are named, physical effects are not, and inconsistent data are not used."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from tests.belonging.load_slips import SLIPS, Tables
from tests.belonging.load_slips_reported import RIGHT, judge
from tests.conftest import PROJECT
from tests.sensor_campaign import LARGEST, UP_AND_DOWN, campaign_toml, measured, sensor, write_campaign
from tests.stages.line import run_line
from truing.belonging.chance_equality import noise_of_neighbours, resolution
from truing.belonging.copied_rows import Values, copied_runs
from truing.belonging.frozen_values import constant_columns, frozen
from truing.belonging.load_tests import against_range, against_simulation
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import DISPLACEMENT_UNITS, ROTATION_UNITS, SIGNAL_FACTORS, RelationState, SlipKind
from truing.belonging.row_order import row_slips
from truing.belonging.signal_tests import SignalSteps, against_geometry
from truing.pipeline.command_line import app
from truing.stages.common.belonging import reason_withheld

SAMPLE = PROJECT / "sample_data" / "force-sensor"
RELATIONS = ("loads-against-readings", "signals-against-loads", "copied-runs")
ARCSEC = np.pi / 180.0 / 3600.0
CHANNELS = [
    *(RecordedColumn(name, "displacement", DISPLACEMENT_UNITS, (0.3165,), 1e-6) for name in ("dx", "dy", "dz")),
    *(RecordedColumn(name, "rotation", ROTATION_UNITS, (), ARCSEC) for name in ("rx", "ry", "rz")),
]
# At least one of each room of the search: loads, readings, signals, rows, copies.
MADE = (
    "all loads in kN",
    "torques in N mm",
    "one run in lbf",
    "fringes of half a wavelength",
    "two channels exchanged",
    "a cell wired backwards",
    "two signals exchanged",
    "a run's signals in V",
    "a signal frozen",
    "signals a step off",
    "a run of signals copied",
)


def _gain_of_the_bench(toml: str) -> str:
    return toml + "\n[signals]\nsensitivity_mv_per_n = 0.02\nsensitivity_tolerance = 0.1\n"


@pytest.mark.parametrize("name", MADE)
def test_a_slip_in_the_files_is_named_with_its_size_and_place(tmp_path: Path, name: str) -> None:
    readings, signals = measured(np.random.default_rng(11), repeats=3)
    write_campaign(tmp_path / "c", readings, signals, _gain_of_the_bench(campaign_toml()))
    tables = Tables(tmp_path / "c")
    made = SLIPS[name](tables, np.random.default_rng([5, MADE.index(name)]))
    assert made is not None
    tables.write()
    reported = judge(tmp_path / "c", made)
    assert reported.how == RIGHT, [(row["state"], row["slips"]) for row in reported.rows]


def test_the_sample_belongs_together_and_says_what_it_could_not_show() -> None:
    rows = {row["relation"]: row for row in run_line(SAMPLE, "ingest", "qa")[0]["belonging"].to_pylist()}
    assert {name: rows[name]["state"] for name in RELATIONS} == dict.fromkeys(RELATIONS, "ok")
    unseen = json.loads(rows["signals-against-loads"]["hidden_slips"])
    assert any(slip["kind"] == "unit" and slip["quantity"] == "signal" for slip in unseen)  # no sensitivity is declared


def test_stages_after_a_failed_relation_wait_for_acceptance_by_the_user(tmp_path: Path) -> None:
    readings, signals = measured(np.random.default_rng(3))
    for table in (readings, signals):
        table["load"] *= 1e-3
    write_campaign(tmp_path / "c", readings, signals, campaign_toml())
    words = ["run", str(tmp_path / "c"), "--out", str(tmp_path / "run"), "--only", "diagnose", "--quiet"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3, done.output
    belonging, found = (pd.read_parquet(tmp_path / "run" / f"{name}.parquet") for name in ("belonging", "diagnosis"))
    apart = belonging[belonging["state"] == "fails"]
    assert apart["relation"].tolist() == ["loads-against-readings"]
    slip = json.loads(apart["slips"].iloc[0])[0]
    assert (slip["kind"], slip["quantity"], slip["factor"]) == ("unit", "load", 1000.0)
    stiffness = [one for one in json.loads(apart["rivals"].iloc[0]) if "stiffness" in one["quantity"]]
    assert [one["factor"] for one in stiffness] == [pytest.approx(0.001)]  # readings alone cannot tell the two apart
    assert found.empty
    accept = '[[accept]]\ncheck = "loads-against-readings"\nby = "M. Keller"\nreason = "a scaled model"\n'
    (tmp_path / "c" / "campaign.toml").write_text(campaign_toml(more=accept))
    tables = run_line(tmp_path / "c", "ingest", "qa")[0]
    assert not reason_withheld(tables)


def _loaded(change, *, repeats: int = 3) -> SignalSteps:
    """Loads and readings of the bench whose displacements (N, 6) are changed, by loads (N, 6)."""
    steps = len(UP_AND_DOWN)
    run = np.repeat(np.arange(6 * repeats), steps)
    axis = run // repeats
    load = np.zeros((len(run), 6))
    load[np.arange(len(run)), axis] = np.tile(UP_AND_DOWN, 6 * repeats) * LARGEST[axis]
    rng = np.random.default_rng(1)
    moved = change(sensor().displacement(load), load)
    noise = 1e-3 * np.abs(moved).max(axis=0) * rng.standard_normal(moved.shape)
    return SignalSteps(load, run, moved + noise, [f"run {number + 1}" for number in range(6 * repeats)])


def _asymmetric(moved: np.ndarray, load: np.ndarray) -> np.ndarray:
    return moved * np.where(load.sum(axis=1) > 0.0, 1.25, 0.8)[:, None]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda moved, load: 0.7 * moved, id="stiffer by 43 %"),
        pytest.param(lambda moved, load: 1.3 * moved, id="softer by 30 %"),
        pytest.param(lambda moved, load: moved * [1.3, 1.0, 0.75, 1.0, 1.36, 1.0], id="each axis by another part"),
        pytest.param(lambda moved, load: sensor().displacement(_eccentric(load)), id="loads 10 mm off the origin"),
        pytest.param(_asymmetric, id="stiffness of push and pull differ by half"),
    ],
)
def test_a_physical_cause_is_no_slip(change) -> None:
    tested = against_simulation(_loaded(change), CHANNELS, sensor().compliance)
    assert tested.state in (RelationState.OK, RelationState.ATTENTION)
    assert not tested.slips


def test_a_channel_that_shows_no_response_to_its_load_is_named_with_its_runs() -> None:
    """In both runs of an axis, so that no other shows its response; and with noise, so that it is not frozen."""

    def silent(moved: np.ndarray, load: np.ndarray) -> np.ndarray:
        return np.where((load[:, 5] != 0.0)[:, None] & (np.arange(6) == 5), 0.0, moved)

    tested = against_simulation(_loaded(silent, repeats=2), CHANNELS, sensor().compliance)
    assert (tested.state, tested.reason) == (RelationState.FAILS, "slip")
    assert [(slip.kind, slip.subjects) for slip in tested.slips] == [(SlipKind.SILENT, ("rz", "run 11", "run 12"))]


def test_a_signal_that_shows_no_response_to_its_loads_is_named_with_its_runs() -> None:
    rng = np.random.default_rng(2)
    lower_angle, upper_angle = np.deg2rad([15, 105, 135, 225, 255, 345]), np.deg2rad([45, 75, 165, 195, 285, 315])
    lower = 0.26 * np.column_stack([np.cos(lower_angle), np.sin(lower_angle), np.zeros(6)])
    upper = np.column_stack([0.19 * np.cos(upper_angle), 0.19 * np.sin(upper_angle), np.full(6, 0.18)])
    along = (upper - lower) / np.linalg.norm(upper - lower, axis=1)[:, None]
    legs = np.linalg.inv(np.vstack([along.T, np.cross(upper - [0.0, 0.0, 0.18], along).T]))
    steps = _loaded(lambda moved, load: moved, repeats=2)
    signal = 8e-7 * steps.load @ legs.T
    signal[np.ix_(steps.run >= 8, [5])] = 0.0
    signal += 1e-3 * np.abs(signal).max() * rng.standard_normal(signal.shape)
    columns = [RecordedColumn(f"v{number}", "signal", SIGNAL_FACTORS) for number in range(1, 7)]
    tested = against_geometry(replace(steps, value=signal), columns, legs, None)
    assert tested is not None
    assert (tested.state, tested.reason) == (RelationState.FAILS, "slip")
    assert [slip.kind for slip in tested.slips] == [SlipKind.SILENT]
    assert set(tested.slips[0].subjects) <= {"v6", "run 9", "run 10", "run 11", "run 12"}
    assert tested.slips[0].subjects[0] == "v6"


def _eccentric(load: np.ndarray) -> np.ndarray:
    return np.column_stack([load[:, :3], load[:, 3:] + np.cross([0.01, -0.005, 0.0], load[:, :3])])


def test_a_simulation_of_another_machine_has_no_slip_and_fails() -> None:
    odd = [7.0, 1.0 / 7.0, 6.0, 1.0 / 6.0, 7.5, 1.0 / 7.5]
    tested = against_simulation(_loaded(lambda moved, load: moved * odd), CHANNELS, sensor().compliance)
    assert (tested.state, tested.slips) == (RelationState.FAILS, ()) or len(tested.slips) <= 2


def test_loads_far_below_the_declared_range_are_asked_about() -> None:
    load = np.zeros((5, 6))
    load[:, 2] = [0.0, 4.0, 9.0, 4.0, 0.0]
    largest = np.array([np.nan, np.nan, 1e4, np.nan, np.nan, np.nan])
    tested = against_range(load, largest)
    assert tested is not None
    assert tested.state == RelationState.ATTENTION
    assert [slip.factor for slip in tested.slips] == [1000.0]
    assert against_range(100.0 * load, largest) is None


def test_two_exchanged_rows_and_creep_are_no_other_order_of_rows() -> None:
    steps = _loaded(lambda moved, load: moved, repeats=1)
    time = 60.0 * np.arange(len(steps.run))
    swapped = steps.value.copy()
    swapped[[4, 12]] = swapped[[12, 4]]
    crept = steps.value.copy()
    for n in range(1, len(crept)):
        if steps.run[n] == steps.run[n - 1]:
            crept[n] = 0.9 * steps.value[n] + 0.1 * crept[n - 1]
    for value in (steps.value, swapped, crept):
        assert not row_slips(steps.load, steps.run, time, value, steps.runs, "readings")[0]


def test_a_cut_signal_is_not_frozen_and_a_still_one_is() -> None:
    load = np.zeros((len(UP_AND_DOWN), 6))
    load[:, 0] = UP_AND_DOWN
    run, matrix = np.zeros(len(load), int), np.array([[1.0, 0, 0, 0, 0, 0]])
    cut, still = np.minimum(load[:, :1], 0.3), load[:, :1].copy()
    still[5:] = still[5]
    assert not list(frozen(load, run, cut, matrix, np.array([np.nan])))
    assert [one.run for one in frozen(load, run, still, matrix, np.array([np.nan]))] == [0]


def test_equal_numbers_show_a_copy_only_where_noise_would_have_shown() -> None:
    rng = np.random.default_rng(2)
    load = np.zeros((40, 6))
    load[:, 0] = np.tile(np.linspace(-1.0, 1.0, 20), 2)
    run = np.repeat([0, 1], 20)
    fine = (load[:, :1] + 0.01 * rng.standard_normal((40, 1))).round(5)
    fine[20:] = fine[:20]
    reported = copied_runs(run, ["run 1", "run 2"], load, [Values("signals", fine, np.array([0.01]))])
    assert [slip.kind for one in reported for slip in one.slips] == [SlipKind.COPIED]
    coarse = load[:, :1].round(1)
    reported = copied_runs(run, ["run 1", "run 2"], load, [Values("signals", coarse, np.array([0.01]))])
    assert not any(one.slips for one in reported)


@pytest.mark.parametrize("columns", [1, 6])
def test_a_copied_part_is_reported_with_its_rows_anywhere_and_coarse_numbers_are_no_copy(
    columns: int,
) -> None:
    rng = np.random.default_rng(5)
    load, run, names = np.zeros((144, 6)), np.repeat([0, 1, 2], 48), ["run 1", "run 2", "run 3"]
    load[:, 0] = np.tile(np.sin(np.linspace(0.0, 2.0 * np.pi, 48)), 3)
    value = (load[:, :1] * np.arange(1.0, columns + 1.0) + 0.01 * rng.standard_normal((144, columns))).round(4)
    noise = np.full(columns, 0.01)

    def reported_slips(signals: np.ndarray) -> list[tuple[RelationState, str, float | None, tuple[int, ...]]]:
        tested = copied_runs(run, names, load, [Values("signals", signals, noise)])
        return [(one.state, one.subject, one.misfit, one.slips[0].rows if one.slips else ()) for one in tested]

    assert reported_slips(value) == [(RelationState.OK, "", None, ())]
    tail, moved = value.copy(), value.copy()
    tail[58:96] = value[10:48]
    moved[65:85] = value[3:23]
    for written, rows in ((tail, range(11, 49)), (moved, range(4, 24))):
        assert reported_slips(written) == [
            (RelationState.FAILS, "run 1, run 2", pytest.approx(100.0 * len(rows) / 48), tuple(rows))
        ]
    assert reported_slips(value.round(1)) in (
        [(RelationState.OK, "", None, ())],
        [(RelationState.NOT_TESTED, "", None, ())],
    )


@pytest.mark.parametrize(
    ("micrometre", "arcsecond", "millivolt", "declared"),
    [(10.0, 3.0, 0.01, 0.5), (20.0, 1.0, 0.05, 10.0), (50.0, 10.0, 0.5, 1.0), (5.0, 3.0, 0.1, 3.0)],
)
def test_a_good_bench_of_coarse_instruments_holds_no_copies(
    tmp_path: Path, micrometre: float, arcsecond: float, millivolt: float, declared: float
) -> None:
    shutil.copytree(SAMPLE, tmp_path / "c")
    tables = Tables(tmp_path / "c")
    step = np.where(tables.readings["channel"].str.startswith("d"), micrometre, arcsecond)
    tables.readings["reading"] = np.round(tables.readings["reading"] / step) * step
    assert tables.signals is not None
    tables.signals[tables.voltages] = np.round(tables.signals[tables.voltages] / millivolt) * millivolt
    for key, size in (("linear_um", micrometre), ("angular_arcsec", arcsecond), ("signal_mv", millivolt)):
        tables.toml = re.sub(rf"{key} = .*", f"{key} = {declared * size}", tables.toml)
    tables.write()
    rows = run_line(tmp_path / "c", "ingest", "qa")[0]["belonging"].to_pylist()
    assert {row["state"] for row in rows} <= {"ok", "not tested"}


def test_equal_numbers_are_no_copy_where_a_symmetric_machine_answers_two_axes_alike() -> None:
    rng = np.random.default_rng(4)
    load = np.zeros((42, 6))
    load[:21, 0] = load[21:, 1] = np.concatenate([np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)])
    value = (1000.0 * load.sum(axis=1)[:, None] + 0.5 * rng.standard_normal((42, 1))).round(-1)
    reported = copied_runs(
        np.repeat([0, 1], 21), ["run 1", "run 2"], load, [Values("readings", value, np.array([5.0]))]
    )
    assert not any(one.slips for one in reported)


@given(st.integers(0, 2**31), st.sampled_from([1e-4, 0.02, 0.5, 20.0, 3.0518e-4]))
def test_the_resolution_of_numbers_on_a_grid_is_its_step(seed: int, step: float) -> None:
    whole = np.random.default_rng(seed).integers(-500, 500, 40)
    assert resolution(step * whole) in (pytest.approx(step), pytest.approx(step * np.gcd.reduce(np.diff(whole))))


def test_the_noise_of_neighbours_is_that_of_the_readings_whatever_curve_they_follow() -> None:
    rng = np.random.default_rng(8)
    load = np.zeros((400, 6))
    load[:, 2] = np.tile(np.r_[np.linspace(-1.0, 1.0, 20), np.linspace(0.9, -0.9, 20)], 10)
    branch = 0.3 * np.sign(np.gradient(load[:, 2])) * (1.0 - load[:, 2] ** 2)
    value = (5.0 * load[:, 2] + load[:, 2] ** 2 + branch)[:, None] + [0.002, 0.01] * rng.standard_normal((400, 2))
    assert noise_of_neighbours(load, value) == pytest.approx([0.002, 0.01], rel=0.15)


def test_a_coarse_column_that_stands_still_under_another_load_is_not_frozen() -> None:
    rng = np.random.default_rng(6)
    load, run = np.zeros((63, 6)), np.repeat([0, 1, 2], 21)
    way = np.concatenate([np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)])
    load[:21, 0] = load[21:42, 1] = load[42:, 2] = way
    value = np.concatenate([400.0 * way, 60.0 * way, 0.0 * way])[:, None]
    noise = rng.standard_normal((63, 1))
    coarse = 3.0 * np.round((value + 0.3 * noise) / 3.0) * (1.0 + 1e-6 * noise)  # a correction for air
    assert not list(constant_columns(load, run, coarse))
    still = (value + 0.3 * noise).round(2)
    still[42:] = 0.05
    assert [one.run for one in constant_columns(load, run, still)] == [2]
