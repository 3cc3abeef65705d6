"""Readings, displacements and signals of a loaded platform: resulting tables, and faults of bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.faults import assert_fault, faults_of
from tests.sentences import assert_says
from tests.tolerance import assert_between, assert_close
from truing.formats.source import CampaignFiles, raw_files
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import Fault
from truing.schemas.interferometer import Interferometer
from truing.stages import ingest
from truing.stages.declaration import Outcome
from truing.stages.quality.check import CampaignLimits
from truing.stages.quality.loading_checks import quadrature_checks
from truing.stages.responses.loads import positioning_rows

HEAD = "run,step,time_s,load_axis,load,channel,reading"
AXES = "dx_mm,dy_mm,dz_mm,rx_rad,ry_rad,rz_rad"
SIX = "fx_n,fy_n,fz_n,mx_nm,my_nm,mz_nm"
SIGNALS_EXPECTED = "signals in columns v1_mv, v2_mv, .."
LATER = "a time after that of the step before"
EMPTY = "a load in every row; an empty cell has to be declared by missing"
ARCSEC = np.pi / 180.0 / 3600.0


def outcome(folder: Path, files: dict[str, list[str]], sections: dict[str, Any] | None = None) -> Outcome:
    for name, lines in files.items():
        (folder / name).write_text("\n".join(lines) + "\n")
    campaign = read_campaign({"campaign": {"name": "c", "kind": "interferometer"}, **(sections or {})})
    settings = SettingsView(campaign, ingest.DECLARATION.settings)
    return ingest.run({}, settings, lambda *_: None, CampaignFiles(folder, campaign))


def artifacts(folder: Path, files: dict[str, list[str]], sections: dict[str, Any] | None = None) -> dict[str, pa.Table]:
    found = dict(outcome(folder, files, sections).artifacts)
    for name, table in found.items():
        assert ARTIFACTS[name].faults(table) == []
    return found


def faults(folder: Path, files: dict[str, list[str]], sections: dict[str, Any] | None = None) -> tuple[Fault, ...]:
    return faults_of(lambda: outcome(folder, files, sections))


def column(table: pa.Table, name: str) -> list[Any]:
    return table.column(name).to_pylist()


def test_readings_are_ordered_and_carry_loads_noise_and_surroundings(tmp_path):
    rows = [
        f"{HEAD},role,air_temperature_c,humid",
        "b,1,60,mx,-3,rx,4.5,calibration,20.1,7",
        "b,0,0,mx,0,rx,0.5,calibration,20,7",
        "b,0,0,mx,0,dz,0.25,calibration,20,7",
        "a,0,0,fz,9,dz,1,verification,21,",
    ]
    table = artifacts(tmp_path, {"interferometer.csv": rows}, {"noise": {"linear_um": 0.5}})["readings"]
    assert column(table, "run") == ["b", "b", "b", "a"]
    assert column(table, "step") == [0, 0, 1, 0]
    assert column(table, "channel") == ["dz", "rx", "rx", "dz"]
    assert column(table, "reading") == [0.25, 0.5, 4.5, 1.0]
    assert column(table, "unit") == ["um", "arcsec", "arcsec", "um"]
    assert column(table, "sigma") == [0.5, None, None, 0.5]
    assert column(table, "mx_nm") == [0.0, 0.0, -3.0, 0.0]
    assert column(table, "fz_n") == [0.0, 0.0, 0.0, 9.0]
    assert column(table, "humid") == [7.0, 7.0, 7.0, None]
    assert column(table, "role")[-1] == "verification"


def test_a_displacement_is_six_readings_and_an_empty_cell_is_none(tmp_path):
    rows = [f"run,step,time_s,{SIX},{AXES}", "1,0,0,0,0,0,0,0,0,0,0,0,0,0,0", "1,1,9,1,2,,4,5,6,.1,,.3,1e-5,2e-5,3e-5"]
    noise = {"displacement_mm": 0.002, "rotation_rad": 1e-6}
    table = artifacts(tmp_path, {"displacement.csv": rows}, {"noise": noise})["readings"]
    assert column(table, "channel") == ["dx", "dy", "dz", "rx", "ry", "rz", "dx", "dz", "rx", "ry", "rz"]
    assert_close(column(table, "reading")[6:], [100.0, 300.0, *(1e-5 * k / ARCSEC for k in (1, 2, 3))], atol=1e-9)
    assert_close(column(table, "sigma")[6:9], [2.0, 2.0, 1e-6 / ARCSEC], atol=1e-12)
    assert column(table, "fz_n")[-1] == 0.0


def test_noise_of_the_channels_holds_for_displacements_that_have_none_of_their_own(tmp_path):
    rows = [f"run,step,time_s,load_axis,load,{AXES}", "1,0,0,fx,0,0.001,0,0,1e-6,0,0"]
    table = artifacts(tmp_path, {"displacement.csv": rows}, {"noise": {"linear_um": 0.5, "angular_arcsec": 0.2}})
    assert column(table["readings"], "sigma") == pytest.approx([0.5] * 3 + [0.2] * 3)


def test_signals_take_their_time_from_the_readings_of_their_step(tmp_path):
    files = {
        "interferometer.csv": [HEAD, "1,0,10,fz,0,dz,0", "1,1,70,fz,5,dz,3"],
        "signals.csv": ["run,step,fz_n,v1_mv,v2_mv", "1,1,5,.5,", "1,0,0,.1,.2", "1,3,5,1,1"],
    }
    table = artifacts(tmp_path, files)["signals"]
    assert column(table, "time_s") == [10.0, 70.0, 190.0]
    assert column(table, "v2_mv") == [0.2, None, 1.0]
    alone = {"signals.csv": ["run,step,load_axis,load,v1_mv", "1,4,fz,1,2", "1,7,fz,2,3"]}
    found = outcome(_new(tmp_path), alone)
    assert column(found.artifacts["signals"], "time_s") == [0.0, 1.0]
    assert "readings" not in found.artifacts
    assert "no readings: " in found.figure


def _new(folder: Path, name: str = "other") -> Path:
    (folder / name).mkdir()
    return folder / name


def test_units_hang_on_the_channel_and_the_axis(tmp_path):
    entry = {"path": "raw.csv", "units": {"reading": "nm", "load": "kN"}, "missing": ["-"]}
    rows = [HEAD, "1,0,0,fz,2,dz,1500", "1,1,1,mx,2,rx,7", "1,2,2,fz,3,dz,-"]
    found = artifacts(tmp_path, {"raw.csv": rows}, {"files": {"interferometer": entry}})
    assert column(found["readings"], "reading") == [1.5, 7.0]
    assert column(found["readings"], "fz_n") == [2000.0, 0.0]
    assert column(found["readings"], "mx_nm") == [0.0, 2.0]
    assert column(found["exclusions"], "rows") == [1]


def test_a_load_that_was_not_recorded_does_not_count_as_zero(tmp_path):
    rows = ["run,step,fx_n,fy_n,v1_mv", "1,0,0,1,0.1", "1,1,,,0.2", "1,2,3,,0.3"]
    found = faults(tmp_path, {"signals.csv": rows[:3]})
    assert found == (Fault("signals.csv", EMPTY, row=3, column="fx_n", value=""),)
    alone = ["run,step,load_axis,load,v1_mv", "1,0,fz,1,0.1", "1,1,fz,,0.2"]
    found = faults(_new(tmp_path, "alone"), {"signals.csv": alone})
    assert found == (Fault("signals.csv", EMPTY, row=3, column="load", value=""),)
    mapped = {"files": {"signals": {"path": "raw.csv", "missing": [""]}}}
    found = artifacts(_new(tmp_path), {"raw.csv": rows}, mapped)
    assert column(found["signals"], "step") == [0]
    assert column(found["exclusions"], "rows") == [2]
    assert column(found["exclusions"], "reason") == ["a load that was not written down"]


def test_a_wrench_shown_by_the_sensor_is_attributed_to_its_legs(tmp_path):
    """The forces of its legs add up to it, each with its lever."""
    joints = [(100, 0), (30, 100), (-80, 60), (-100, -50), (0, -90), (70, -60)]
    tilt = [(-20, 80), (-80, 10), (30, -90), (80, 0), (-50, 0), (0, 60)]
    legs = [{"B_mm": [x, y, 0], "b_mm": [x + dx, y + dy, 0]} for (x, y), (dx, dy) in zip(joints, tilt, strict=True)]
    mechanism = {"type": "6-upur", "height_mm": 200.0, "legs": legs}
    arm = np.array([leg["b_mm"] for leg in legs]) * 1e-3
    along = np.array([[dx, dy, 200.0] for dx, dy in tilt])
    along /= np.linalg.norm(along, axis=1)[:, None]
    force = np.array([3.0, -1.0, 2.0, 0.5, 0.0, 7.0])
    shown = np.concatenate([force @ along, 1e3 * np.cross(arm, along * force[:, None]).sum(0)])
    names = [f"shown_{name}" for name in SIX.split(",")]
    rows = [f"run,step,fz_n,{','.join(names)},filtered", f"1,0,5,{','.join(map(repr, shown.tolist()))},9"]
    entry = {"path": "raw.csv", "units": dict.fromkeys(names[3:], "N mm"), "ignore": "filt.*"}
    sections = {"files": {"signals": entry}, "mechanism": mechanism, "signals": {"sensitivity_mv_per_n": 0.5}}
    table = artifacts(tmp_path, {"raw.csv": rows}, sections)["signals"]
    assert_close([column(table, f"v{leg}_mv")[0] for leg in range(1, 7)], 0.5 * force, atol=1e-9)
    assert "filtered" not in table.column_names
    parallel = [{"B_mm": leg["B_mm"], "b_mm": leg["B_mm"]} for leg in legs]
    found = faults(tmp_path, {}, {**sections, "mechanism": {**mechanism, "legs": parallel}})
    assert found[0].column == "mechanism.legs"
    found = faults(tmp_path, {}, {**sections, "mechanism": {"type": "none"}})
    assert (found[0].file, found[0].column, found[0].value) == ("campaign.toml", "mechanism.type", "none")
    assert found[0].expected.startswith("[mechanism] type")


def quadrature_rows(length_um, run=1, noise=0.0, seed=0):
    """Raw signals of dx, four samples a step, of an interferometer with uneven gains, offsets and a lag; steps count up
    with the length (N,)."""
    rng = np.random.default_rng(seed)
    p = 2.0 * np.pi * length_um / (0.63299 / 2.0) + 0.7
    x = 30.0 + 500.0 * np.cos(p) + noise * rng.standard_normal(len(p))
    y = -12.0 + 430.0 * np.sin(p + 0.12) + noise * rng.standard_normal(len(p))
    return [f"{run},{n // 4},{n},fz,{n // 4},dx,{x[n]:.12g},{y[n]:.12g}" for n in range(len(p))]


def test_raw_signals_become_lengths_counted_through_fringes(tmp_path):
    """Two runs of forty steps, some 13 fringes each; the first goes up, the second back."""
    length = 4.0 * np.sin(np.linspace(0.0, 0.5 * np.pi, 160))
    rows = [HEAD.replace("reading", "signal_x,signal_y"), *quadrature_rows(length, 1), *quadrature_rows(-length, 2)]
    sections = {"interferometer": {"wavelength_nm": 632.99}}
    found = artifacts(tmp_path, {"quadrature.csv": rows}, sections)
    readings = found["readings"]
    means = length.reshape(-1, 4).mean(1)
    assert_close(column(readings, "reading"), [*(means - means[0]), *(means[0] - means)], atol=1e-6)
    assert column(readings, "fz_n") == [float(n) for n in range(40)] * 2
    channel = found["quadrature"].to_pylist()[0]
    assert_close([channel[n] for n in ("x0", "y0", "amplitude_x", "amplitude_y", "lag_rad")],
                 [30.0, -12.0, 500.0, 430.0, 0.12], atol=1e-6)  # fmt: skip
    assert channel["radius_after"] < 1e-6 < 20.0 < channel["radius_before"]
    assert channel["miscount_risk"] < 1e-9
    limits = CampaignLimits("interferometer")
    assert all(check.verdict == "pass" for check in quadrature_checks(found["quadrature"], limits))


def test_raw_signals_carry_the_noise_of_their_phase(tmp_path):
    rows = [HEAD.replace("reading", "signal_x,signal_y"), *quadrature_rows(np.linspace(0.0, 9.0, 800), noise=2.0)]
    readings = artifacts(tmp_path, {"quadrature.csv": rows}, {"interferometer": {"wavelength_nm": 632.99}})["readings"]
    missed = np.array(column(readings, "reading")) - np.linspace(0.0, 9.0, 800).reshape(-1, 4).mean(1)
    sigma = np.sqrt(np.mean(np.square(column(readings, "sigma"))))
    # the mean of four samples scatters by half of one's sigma, and a little by the fit of the ellipse
    assert_between(np.std(missed) / sigma, 0.4, 0.65)


def test_raw_signals_that_cannot_be_read_are_refused(tmp_path):
    head = HEAD.replace("reading", "signal_x,signal_y")
    short = quadrature_rows(np.linspace(0.0, 0.02, 40), noise=2.0)
    fault = faults(tmp_path, {"quadrature.csv": [head, *short]})[0]
    assert "signals of dx" in fault.expected
    assert "short-arc" in fault.expected
    fault = faults(tmp_path, {"quadrature.csv": [head, *(row.replace("dx", "rx") for row in short)]})[0]
    assert_says(fault.expected, "angle", "two")
    files = {"quadrature.csv": [head, *short], "interferometer.csv": [HEAD, "1,0,0,fz,0,dz,1"]}
    fault = faults(tmp_path, files)[0]
    assert "no raw signals" in fault.expected


APPROACHES = "run,target_mm,direction,cycle,position_mm"


def test_positioning_runs_are_ordered_and_evaluated_by_iso_230_2(tmp_path):
    rows = [APPROACHES, *(f"a,{at},{way},{cycle},{at + off + 0.001 * cycle}" for cycle in (2, 1) for at in (20, 10)
                          for way, off in (("backward", 0.004), ("forward", 0.0005 * at)))]  # fmt: skip
    found = artifacts(tmp_path, {"positioning.csv": rows})
    assert column(found["positions"], "target_mm") == [10.0] * 4 + [20.0] * 4
    table = positioning_rows(found["positions"], Interferometer()).table("string")
    assert ARTIFACTS["positioning"].faults(table) == []
    reported = {(row["figure"], row["subject"]): row["value"] for row in table.to_pylist()}
    # deviations (5, 6 | 4, 5 ... um): forward 6.5, 11.5; backward 5.5, 5.5, each plus 0.5 and less 0.5
    assert_close([reported["mean_forward", "10 mm"], reported["mean_forward", "20 mm"]], [6.5, 11.5], atol=1e-6)
    assert_close([reported["B", "10 mm"], reported["B", "20 mm"], reported["B", None]], [1.0, 6.0, 6.0], atol=1e-6)
    assert_close([reported["E", None], reported["M", None]], [6.0, 2.5], atol=1e-6)
    s = np.sqrt(0.5)
    assert_close([reported["R_forward", None], reported["A", None]], [4 * s, 6.0 + 4 * s], atol=1e-6)


def test_a_positioning_run_without_an_approach_is_refused(tmp_path):
    grid = [f"a,{at},{way},{cycle},{at}" for at in (1, 2) for way in ("forward", "backward") for cycle in (1, 2)]
    fault = faults(tmp_path, {"positioning.csv": [APPROACHES, *grid[1:]]})[0]
    assert fault.value == "run a: 2 targets, 2 cycles, backward, forward, 1 approach missing"
    fault = faults(tmp_path, {"positioning.csv": [APPROACHES, *grid[:2], *grid[4:6]]})[0]
    assert str(fault.value).startswith("run a: ")
    assert str(fault.value).endswith(", 4 approaches missing")
    fault = faults(tmp_path, {"positioning.csv": [APPROACHES, *grid, grid[0]]})[0]
    assert_says(fault.expected, "run, target_mm, direction, cycle", "once")


@pytest.mark.parametrize(
    ("header", "column", "value", "expected"),
    [
        ("run,step,fz_n,v1_mv,v1_mv", "v1_mv", "2 of them", "one column v1_mv"),
        ("run,step,fz_n,v1_mv,v9_mv", None, "v1_mv, v9_mv", SIGNALS_EXPECTED),
        ("run,step,fz_n,v1_mv,v3_mv", None, "v1_mv, v3_mv", SIGNALS_EXPECTED),
        ("run,step,fz_n,speed,other", None, None, SIGNALS_EXPECTED),
    ],
)
def test_signals_are_numbered_from_one_and_each_named_once(tmp_path, header, column, value, expected):
    fault = faults(tmp_path, {"signals.csv": [header, "1,0,0,1,2"]})[0]
    assert (fault.column, fault.value) == (column, value)
    assert fault.expected.startswith(expected)


def test_a_unit_that_no_row_could_want_is_a_fault(tmp_path):
    entry = {"path": "raw.csv", "units": {"reading": "s", "load": "mm"}}
    found = faults(tmp_path, {"raw.csv": [HEAD, "1,0,0,fz,2,dz,1"]}, {"files": {"interferometer": entry}})
    assert [(fault.column, fault.value) for fault in found[:2]] == [("load", "mm"), ("reading", "s")]
    for fault, units in zip(found[:2], ("N or N m", "um or arcsec"), strict=True):
        assert_says(fault.expected, "become", units)


def test_uncompensated_readings_are_brought_to_the_air_they_were_taken_in(tmp_path):
    rows = [f"{HEAD},air_temperature_c,air_pressure_hpa,relative_humidity_pct",
            "1,0,0,fz,0,dz,0,20,1000,50", "1,1,60,fz,9,dz,400,20,1010,50", "1,2,90,fz,9,rx,400,20,1010,50"]  # fmt: skip
    files = {"interferometer.csv": rows}
    section = {"compensated": False, "dead_path_mm": 100.0}
    dead = column(artifacts(tmp_path, files, {"interferometer": section})["readings"], "reading")
    none = column(artifacts(tmp_path, files, {"interferometer": {"compensated": False}})["readings"], "reading")
    # The index grows by 2.68e-7 per hPa (Stone and Zimmerman); at 20 degrees C and 1010 hPa it is 1.000270.
    assert_close(none[1:], [400.0 / 1.000270] * 2, atol=400 * 2e-6)
    assert_close(np.subtract(dead, none), [0.0, -100e3 * 10 * 2.68e-7, 0.0], atol=100e3 * 10 * 0.02e-7)
    towards = {"interferometer.csv": [row.replace(",400,", ",-400,") for row in rows]}
    nearer = artifacts(tmp_path, towards, {"interferometer": section | {"dead_path_mm": -100.0}})
    assert_close(column(nearer["readings"], "reading"), np.negative(dead), atol=1e-12)  # the path gets shorter
    lacking = {"interferometer.csv": [HEAD, "1,0,0,fz,0,dz,0"]}
    lacks = [fault.column for fault in faults(tmp_path, lacking, {"interferometer": section})]
    assert lacks == ["air_temperature_c", "air_pressure_hpa", "relative_humidity_pct"]


def test_growth_of_the_frame_is_corrected_and_the_remaining_uncertainty_reported(tmp_path):
    around = "air_temperature_c,air_pressure_hpa,relative_humidity_pct,material_temperature_c"
    rows = [f"{HEAD},{around}", "1,1,60,fz,9,dz,400,20,1000,50,21.5", "1,0,0,fz,0,dz,0,20,1000,50,21.0",
            "1,2,90,fz,9,rx,40,20,1000,50,22.0", "2,0,99,fz,9,dz,1,20,1000,50,25"]  # fmt: skip
    steel = {"length_mm": -300.0, "expansion_per_k": 11.5e-6, "expansion_sigma_per_k": 1e-6}
    spread = {"air_pressure_hpa": 1.0, "material_temperature_c": 0.1, "index": 0.0}
    optics = {"dead_path_mm": 100.0, "material": {"dz": steel}, "surroundings_sigma": spread}
    found = artifacts(tmp_path, {"interferometer.csv": rows}, {"interferometer": optics})
    # 300 mm of steel on the side where growth lowers the reading: 3.45 um per K since the start of the run
    assert_close(column(found["readings"], "reading"), [0.0, 400.0 + 0.5 * 3.45, 40.0, 1.0], atol=1e-9)
    reported = {(row["subject"], row["correction"]): row for row in found["reading_corrections"].to_pylist()}
    assert list(reported) == [("dz", "air"), ("rx", "air"), ("dz", "material")]
    assert reported["dz", "air"]["largest"] is None
    # 2.68e-7 per hPa: of the displacement, and of path and displacement with the two errors of a difference
    index = 2.68e-7
    assert_close(reported["dz", "air"]["sigma"], np.hypot(400.0, (100e3 + 400.0) * np.sqrt(2.0)) * index, atol=3e-4)
    assert_close(reported["dz", "material"]["largest"], 0.5 * 3.45, atol=1e-9)
    own = 300e3 * np.hypot(0.5 * 1e-6, 11.5e-6 * 0.1 * np.sqrt(2.0))
    assert_close(reported["dz", "material"]["sigma"], own, atol=1e-6)
    fault = faults(tmp_path, {"interferometer.csv": [HEAD, "1,0,0,fz,0,dz,0"]}, {"interferometer": optics})[0]
    assert (fault.column, fault.value) == ("material_temperature_c", None)
    assert "as [interferometer" in fault.expected
    six = {"displacement.csv": [f"run,step,time_s,{SIX},{AXES}", "1,0,0" + ",0" * 12]}
    (tmp_path / "interferometer.csv").unlink()
    found = faults(tmp_path, six, {"interferometer": {**optics, "beams": {"dz": {"arm_mm": [1.0, 0.0, 0.0]}}}})
    assert [fault.file for fault in found] == ["campaign.toml"] * 2
    assert [fault.column for fault in found] == ["interferometer.beams", "interferometer.material"]


def test_positions_are_those_at_20_degrees_and_as_sure_as_the_expansion_is(tmp_path):
    grid = [(at, way, cycle) for at in (0, 500) for way in ("forward", "backward") for cycle in (1, 2)]
    rows = [f"a,{at},{way},{cycle},{at * (1 + 2e-5)},22" for at, way, cycle in grid]
    axis = {"axis": {"expansion_per_k": 1e-5, "expansion_sigma_per_k": 1e-6}}
    optics = Interferometer.model_validate({"material": axis})
    head = f"{APPROACHES},material_temperature_c"
    found = artifacts(tmp_path, {"positioning.csv": [head, *rows]}, {"interferometer": {"material": axis}})
    assert_close(column(found["positions"], "position_mm"), [0.0] * 4 + [500.0] * 4, atol=1e-9)
    reported = found["reading_corrections"].to_pylist()
    assert [(row["subject"], row["unit"]) for row in reported] == [("axis", "um")]
    assert_close([reported[0]["largest"], reported[0]["sigma"]], [10.0, 1.0], atol=1e-3)
    lines = {
        (r["figure"], r["subject"]): r for r in positioning_rows(found["positions"], optics).table("string").to_pylist()
    }
    # deviations without scatter: 2 K of 1e-6 per K over half a metre is all that M is uncertain by
    assert_close(lines["M", None]["sigma"], 1.0 * np.sqrt(1.0 - 2.0 / np.pi), atol=0.05)


def test_an_overload_test_that_is_declared_is_read_and_one_that_is_not_is_a_fault(tmp_path):
    """A sensor of 10 kN and 5 kN m with 120 % overload, loaded to just that; torques to 9 kN m are 180 %."""
    rows = [HEAD, "1,0,0,fx,0,dx,0", "1,1,60,fx,12000,dx,2760", "2,0,0,mz,0,rz,0", "2,1,60,mz,-6000,rz,-402"]
    loading = {"fx_n": 10000.0, "mz_nm": 5000.0}
    found = faults(tmp_path, {"interferometer.csv": rows}, {"loading": loading})
    assert len(found) == 2
    for fault in found:
        assert_says(fault.expected, "[loading] overload = 1.2")
    readings = artifacts(tmp_path, {}, {"loading": {**loading, "overload": 1.2}})["readings"]
    assert column(readings, "fx_n")[1] == 12000.0
    higher = [*rows[:-1], "2,1,60,mz,-9000,rz,-603"]
    (fault,) = faults(tmp_path, {"interferometer.csv": higher}, {"loading": {**loading, "overload": 1.2}})
    assert_says(fault.expected, "6000 N m", "mz")
    assert "overload = 1.8" in fault.expected
    own = {"loading": {**loading, "overload": {"fx": 1.2, "mz": 1.8}}}
    assert column(artifacts(tmp_path, {}, own)["readings"], "mz_nm")[-1] == -9000.0
    newtons = [HEAD, "1,0,0,fx,0,dx,0", "1,1,60,fx,12000000,dx,2760"]
    fault = faults(tmp_path, {"interferometer.csv": newtons}, own)[0]
    assert_says(fault.expected, "12000 N", "fx")
    assert fault.expected.endswith("is its unit right?")


def test_every_fault_of_bad_tables_is_reported_at_once(tmp_path):
    rows = [HEAD, "1,0,0,fz,0,dz,0", "1,0,0,mx,4,dx,0", "1,1,60,fz,5,dz,1", "1,1,60,fz,5,dz,1", "1,2,50,fq,1,dw,nan",
            "1,3,99,fz,20,dz,", "1,4,100,fz,2,dz,2e6"]  # fmt: skip
    signals = ["run,step,load_axis,load,fz_n,v1_mv", "1,0,fz,0,3,1"]
    found = faults(tmp_path, {"interferometer.csv": rows, "signals.csv": signals}, {"loading": {"fz_n": 10.0}})
    for row, name, value, expected in (
        (3, "load", "4.0", "one load per step"),
        (5, "channel", "dz", "every run, step, channel once"),
        (6, "channel", "dw", "one of dx, dy, dz, rx, ry, rz"),
        (6, "load_axis", "fq", "one of fx"),
        (6, "time_s", "50.0", LATER),
        (6, "reading", "nan", "a finite number"),
        (7, "load", "20.0", "at most 10 N of fz either way, by [loading]"),
        (7, "reading", "", "a number in every row"),
        (8, "reading", "2000000.0", "less than a metre; is the unit right?"),
        (None, None, "fz_n, load_axis, load", "either columns fx_n"),
    ):
        file = "interferometer.csv" if row else "signals.csv"
        assert expected in assert_fault(found, file=file, row=row, column=name, value=value).expected
    assert len(found) == 10


FOUR_STEPS = {
    "interferometer.csv": (f"{HEAD},role", "{run},{step},{time},fz,{load},dz,1,calibration"),
    "displacement.csv": (f"run,step,time_s,{SIX},{AXES}", "{run},{step},{time},0,0,{load},0,0,0,.1,.1,.1,0,0,0"),
    "signals.csv": ("run,step,time_s,load_axis,load,v1_mv,v2_mv", "{run},{step},{time},fz,{load},1,2"),
}


def test_a_time_too_late_is_reported_once_where_times_go_back(tmp_path):
    rows = [f"1,{step},{time},fz,{step},dz,1" for step, time in enumerate((0, 9, 1, 2, 3))]
    (fault,) = faults(tmp_path, {"interferometer.csv": [HEAD, *rows]})
    assert (fault.row, fault.column, fault.value) == (4, "time_s", "1.0")
    assert fault.expected.startswith(LATER)


@pytest.mark.parametrize("table", FOUR_STEPS)
@pytest.mark.parametrize("word", ["oops", "inf"])
def test_a_cell_that_holds_no_number_is_reported_once_and_nothing_that_follows_from_it(tmp_path, table, word):
    head, row = FOUR_STEPS[table]
    steps = [(run, step) for run in (1, 2) for step in range(4)]
    good = [row.format(run=run, step=step, time=10 * step, load=3 * step) for run, step in steps]
    names = head.split(",")
    for at, name in enumerate(names[1:], 1):
        cells = good[2].split(",")
        cells[at] = word
        (fault,) = faults(tmp_path, {table: [head, *good[:2], ",".join(cells), *good[3:]]})
        assert (fault.file, fault.row, fault.column, fault.value) == (table, 4, name, word)


def test_faults_across_tables(tmp_path):
    files = {
        "interferometer.csv": [f"{HEAD},role", "1,0,0,fz,0,dz,0,calibration", "1,1,60,fz,5,dz,1,verification"],
        "signals.csv": ["run,step,load_axis,load,v1_mv", "1,1,fz,4,1"],
        "displacement.csv": [f"run,step,time_s,load_axis,load,{AXES}"],
    }
    found = faults(tmp_path, files, {"signals": {"sensitivity_mv_per_n": [1.0, 1.0]}})
    fault = assert_fault(found, column="role", value="verification")
    assert_says(fault.expected, "one role")
    fault = assert_fault(found, file="displacement.csv", value=None)
    assert_says(fault.expected, "no displacement")
    fault = assert_fault(found, column="signals.sensitivity_mv_per_n", value="2 numbers")
    assert_says(fault.expected, "one number", "each of the 1")
    del files["displacement.csv"]
    (tmp_path / "displacement.csv").unlink()
    files["interferometer.csv"][2] = "1,1,60,fz,5,dz,1,calibration"
    fault = faults(tmp_path, files)[0]
    assert fault.value == "4.0"
    assert_says(fault.expected, "readings", "run and step")
    fault = faults(_new(tmp_path), {})[0]
    assert_says(fault.expected, "displacement.csv", "signals.csv")


BASE, TOP = np.radians([20, 100, 140, 220, 260, 340]), np.radians([40, 80, 160, 200, 280, 320])
LEGS = [
    {"B_mm": [90.0 * np.cos(a), 90.0 * np.sin(a), 0.0], "b_mm": [50.0 * np.cos(b), 50.0 * np.sin(b), 0.0]}
    for a, b in zip(BASE, TOP, strict=True)
]
SENSOR = {"type": "6-upur", "height_mm": 60.0, "legs": LEGS}


def test_elements_have_to_fit_the_legs(tmp_path):
    files = {"signals.csv": ["run,step,load_axis,load,v1_mv", "1,1,fz,4,1"]}
    rod = {"kind": "cylinder", "length_mm": 30.0, "diameter_mm": 5.0, "youngs_gpa": 200.0, "poisson": 0.3}
    fault = faults(tmp_path, files, {"mechanism": {**SENSOR, "elements": [rod]}})[0]
    assert (fault.column, fault.value) == ("mechanism.elements", "a total length of 0.03 m")
    assert fault.expected.startswith("the length of each leg")
    whole = [rod, {"kind": "rigid"}]
    artifacts(tmp_path, files, {"mechanism": {**SENSOR, "elements": whole}})
    upright = [{"B_mm": leg["b_mm"], "b_mm": leg["b_mm"]} for leg in LEGS]
    loose = faults(tmp_path, files, {"mechanism": {**SENSOR, "legs": upright, "elements": whole}})[0]
    assert (loose.column, loose.value) == ("mechanism.legs", "legs that do not constrain the platform")


def test_a_given_compliance_is_checked_cell_by_cell(tmp_path):
    sections = {"mechanism": {**SENSOR, "compliance_file": "c.csv"}}
    files = {"signals.csv": ["run,step,load_axis,load,v1_mv", "1,1,fz,4,1"]}
    good = np.diag([1e-8, 1e-8, 1e-9, 1e-6, 1e-6, 1e-6])
    good[0, 4] = good[4, 0] = 2e-8
    lines = [",".join(map(str, row)) for row in good]
    table = artifacts(tmp_path, {**files, "c.csv": ["fx,fy,fz,mx,my,mz", *lines]}, sections)["given_compliance"]
    assert_close(np.reshape(column(table, "coefficient"), (6, 6)), good, atol=0.0)
    assert column(table, "unit")[3:7] == ["m/(N m)", "m/(N m)", "m/(N m)", "m/N"]
    document = {"mechanism": sections["mechanism"]}
    assert tmp_path / "c.csv" in raw_files(tmp_path, document)  # so that a change of it is noticed
    wrong = [*lines[:4], lines[4].replace("2e-08", "3e-08"), lines[5]]
    fault = faults(tmp_path, {**files, "c.csv": wrong}, sections)[0]
    assert (fault.file, fault.row, fault.column, fault.value) == ("c.csv", 1, "my", "2e-08")
    assert_says(fault.expected, "3e-08", "row 5", "column fx")
    broken = ["1,2", *lines[1:5], lines[5].replace("1e-06", "x")]
    cells, number = faults(tmp_path, {**files, "c.csv": broken}, sections)[:2]
    assert (cells.row, cells.value) == (1, "2 cells")
    assert cells.expected.startswith("six numbers")
    assert (number.row, number.column, number.value) == (6, "mz", "x")
    assert number.expected.startswith("a finite number")
    absent = faults(tmp_path, files, {"mechanism": {**SENSOR, "compliance_file": "no.csv"}})[0]
    assert "existing text file" in absent.expected
    negative = [",".join(map(str, row)) for row in good * np.where(np.eye(6) == 0, 1.0, [1, 1, -1, 1, 1, 1])]
    fault = faults(tmp_path, {**files, "c.csv": negative}, sections)[0]
    assert_says(str(fault), "negative eigenvalue")


def deviating(cell="0.5"):
    grid = [f"x,{target},{way},{cycle}" for target in (0, 10) for way in ("forward", "backward") for cycle in (1, 2)]
    return ["run,target_mm,direction,cycle,deviation_um", *(f"{row},{cell}" for row in grid)]


def test_deviations_from_targets_become_positions(tmp_path):
    found = artifacts(tmp_path, {"positioning.csv": deviating("2.5")})["positions"]
    target, position = (np.array(found.column(name).to_pylist()) for name in ("target_mm", "position_mm"))
    assert_close(position - target, 0.0025 * np.ones(8), atol=1e-15, what="deviation, mm")


def test_an_approach_needs_a_position_or_a_deviation_and_not_both(tmp_path):
    rows = deviating()
    without = [row.rsplit(",", 1)[0] for row in rows]
    both = [
        "run,target_mm,direction,cycle,deviation_um,position_mm",
        *(f"{row},{row.split(',')[1]}" for row in rows[1:]),
    ]
    for lines in (without, both):
        assert_fault(faults(tmp_path, {"positioning.csv": lines}), file="positioning.csv", column="position_mm")
    empty = [*rows[:-1], rows[-1].rsplit(",", 1)[0] + ","]
    assert_fault(faults(tmp_path, {"positioning.csv": empty}), file="positioning.csv", row=9, column="deviation_um")
