"""The page of a bench: readings before and after modelling by channel, load and time."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from tests.report.bench_tables import AXES, CHANNELS, LEVELS, NOISE, bench_tables, rejected
from tests.report.diagnosis_parts import PARTS, part_of, state_of, text_of
from tests.report.diagnosis_tables import row, rows, size
from tests.report.test_page import Reader, render
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.load_corrections import load_warning, unrecorded_loads
from truing.report.diagnosis.prediction_errors import part_names, reading_misses
from truing.report.diagnosis.reading_gain import against_load, where_missed
from truing.report.measured_section import measured
from truing.report.page_head import build_head

RUNS = len(AXES) * len(CHANNELS)


@pytest.fixture(scope="module")
def tables():
    return bench_tables()


@pytest.fixture(scope="module")
def gain(tables):
    return part_of("gain", tables)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_map_holds_the_rms_over_the_declared_noise(tables, gain):
    before, after = gain.figures[1][0].data
    errors = tables["reading_errors"].assign(fz=tables["readings"]["fz_n"])
    under = errors["run"].isin(errors.loc[errors["fz"] != 0.0, "run"]) & (errors["channel"] == "ry")
    assert list(before.x) == list(AXES)
    assert list(before.y)[: len(CHANNELS)] == list(CHANNELS)
    for trace, column in ((before, "missed_before"), (after, "missed_after")):
        reported = float(trace.text[list(trace.y).index("ry")][list(trace.x).index("fz")])
        assert reported == pytest.approx(_rms(errors.loc[under, column]) / NOISE["ry"], rel=0.05)


def test_the_panels_are_those_that_are_missed_most(tables, gain):
    figure = gain.figures[2][0]
    titles = [note.text for note in figure.layout.annotations]
    assert titles == ["ry under fz (arcsec)", "rx under fz (arcsec)"]
    first = [trace for trace in figure.data if trace.xaxis == "x" and trace.name == "without the causes"]
    drawn = sorted((x, y) for trace in first for x, y in zip(trace.x, trace.y, strict=True))
    own = tables["reading_errors"].assign(fz=tables["readings"]["fz_n"]).query("channel == 'ry'")
    own = own[own["run"].isin(own.loc[own["fz"] != 0.0, "run"])]
    assert_close(np.array(drawn), np.array(sorted(zip(own["fz"], own["missed_before"], strict=True))), atol=1e-12)
    loading, unloading = first
    assert np.abs(loading.x).max() == 9000.0
    assert np.abs(unloading.x).max() == 6000.0


def test_loads_at_once_are_in_one_column_and_the_panels_are_those_that_go_with_the_load(tables):
    readings = tables["readings"].copy()
    readings["fx_n"] += np.where(
        readings["fz_n"] != 0.0, 500.0 * np.random.default_rng(3).choice([-1, 1], len(readings)), 0
    )
    misses = reading_misses({**tables, "readings": readings})
    assert list(where_missed(misses, True).data[0].x) == ["fx", "mx", "several"]
    titles = [note.text for note in against_load(misses, True).layout.annotations]
    assert titles == ["ry under fz (arcsec)", "rx under fz (arcsec)"]


def test_the_order_is_that_of_time_and_runs_are_apart(tables, gain):
    shuffled = {**tables, "reading_errors": tables["reading_errors"].sample(frac=1.0, random_state=1)}
    figures = [one.figures[3][0] for one in (gain, part_of("gain", shuffled))]
    for own, other in zip(figures[0].data, figures[1].data, strict=True):
        assert_close(own.y, other.y, atol=0.0)
    lines = [shape for shape in figures[0].layout.shapes if shape.type == "line" and shape.xref == "x"]
    assert len(lines) == len(AXES) - 1
    assert list(figures[0].layout.xaxis.ticktext) == ["1: fx", "5: fz", "9: mx"]


def test_the_table_holds_each_channel(tables, gain):
    listing = gain.listings[0]
    assert [line[0] for line in listing.rows] == list(CHANNELS)
    own = tables["reading_errors"].query("channel == 'rx'")
    line = dict(zip(listing.heads, listing.rows[2], strict=True))
    assert line["runs"] == "3"
    assert float(line["rms before"].partition(" (")[0]) == pytest.approx(_rms(own["missed_before"]), rel=0.005)
    assert float(line["largest after"]) == pytest.approx(own["missed_after"].abs().max(), rel=0.005)


def test_held_out_runs_are_shown_by_themselves():
    part = part_of("gain", bench_tables(held=4, signals=0))
    names = [line[0] for line in part.listings[0].rows]
    assert "dx, fitted runs" in names
    assert "dx, held-out runs" in names
    assert_says(part.lead, "held-out runs", "4.2 arcsec", "without the causes", "0.22 arcsec")
    assert "0.22 arcsec with them" in part.lead


def test_several_findings_report_their_gain_over_all_channels_of_a_unit():
    tilt = row("cosine-error", subject="channel rx", parameters={"angle": size(0.008, 0.001, "rad")}, unit="arcsec")
    off = row("load-eccentricity", subject="load fz", parameters={"offset_x": size(5.0, 0.1, "mm")}, unit="arcsec")
    tables = bench_tables(rows(off, tilt), signals=0)
    text = build_head("c", tables).verdicts[0][1]
    own = tables["reading_errors"].query("unit == 'arcsec'")
    before, after = (f"{_rms(own[f'missed_{when}']):#.2g}" for when in ("before", "after"))
    assert_says(text, "both", "lowers", "fitted runs", f"{before} arcsec", f"{after} arcsec", "noise (0.20 arcsec)")


def test_readings_missed_by_less_than_noise_leaves_are_no_success():
    tables = bench_tables(rows(*rejected()), signals=0)
    errors = tables["reading_errors"]
    tables["reading_errors"] = errors.assign(
        **{f"missed_{k}": 0.4 * errors["missed_after"] for k in ("before", "after")}
    )
    mark, text = build_head("c", tables).verdicts[0]
    assert mark == "warn"
    assert_says(text, "significantly less", "noise")
    assert_says(text, "declared noise", "too large")
    part = part_of("gain", tables)
    assert state_of("gain", tables) == "attention"
    assert_says(part.lead, "significantly below", "noise floor")


def test_the_noise_of_channels_and_signals_is_reported_with_what_is_not_declared():
    tables = bench_tables()
    readings = tables["readings"].copy()
    first = readings.index[readings["channel"] == "dx"][:3]
    readings.loc[first, "sigma"] = np.nan
    readings.loc[readings["channel"] == "dz", "sigma"] = np.nan
    readings.loc[readings.index[readings["channel"] == "rx"][:3], "sigma"] = 0.4
    raw = pd.DataFrame({"channel": ["ry"], "sigma_source": ["ellipse"]})
    declared = pd.DataFrame({"signal_mv": [0.01]})
    given = {**tables, "readings": readings, "quadrature": raw}
    reported = {line[0]: line[-1] for line in measured({**given, "declared_noise": declared}).listings[1].rows}
    assert_says(reported["dx"], "0.500 µm", "3 not declared")
    assert reported["dz"] == "not declared"
    assert reported["rx"] == "0.200 arcsec to 0.400 arcsec"
    assert_says(reported["ry"], "0.200 arcsec", "ellipse")
    assert reported["v1"] == "0.0100 mV"
    unknown = {**given, "declared_noise": declared * np.nan}
    assert measured(unknown).listings[1].rows[-1][-1] == "not declared"


def test_nothing_found_is_reported_unit_by_unit():
    tables = bench_tables(rows(*rejected()), signals=0)
    mark, text = build_head("c", tables).verdicts[0]
    assert mark == "pass"
    assert_says(text, "load eccentricity", "0.11 mm", "20 N per kN·m", "stiffness scale", "0.40 %")
    part = part_of("gain", tables)
    assert_says(part.lead, "arcsec", "consistent", "noise floor")
    assert_says(part.lead, "µm", "0.85 times", "noise floor")
    assert {trace.name for trace in part.figures[1][0].data if trace.name} == {"simulation without changes"}


def test_components_of_one_cause_are_in_one_line():
    tables = bench_tables()
    both = tables["detectable"].query("cause == 'load-eccentricity'").iloc[:1]
    tables["detectable"] = both.assign(parameter="offset_y offset_z", size=0.3, subject="load fx")
    listing = part_of("hidden", tables).listings[0]
    assert listing.rows[0][1:5] == ("offset", "load fx", "0.30 mm", "0.30 mm")


def test_a_page_of_a_bench_speaks_of_no_poses(tables):
    text = Reader(render(tables)).text
    assert not re.findall(r"\b[Pp]oses?\b", text.partition("Provenance The digest")[0])
    assert_says(text, "runs left out in turn", "4.2 arcsec", "0.22 arcsec", "consistent")
    assert_says(text, "No loads", "computed")


def test_a_single_run_is_left_out_by_load_steps():
    tables = bench_tables()
    first = tables["reading_errors"]["run"].iloc[0]
    several = part_names(tables)
    alone = part_names({**tables, "reading_errors": tables["reading_errors"].assign(run=first)})
    assert several.held_out.startswith("runs")
    assert alone.held_out.startswith("load steps")
    assert "Runs" not in alone.fitted_or_not


def test_measured_shows_loads_channels_and_surroundings(tables):
    section = measured(tables)
    assert_says(section.lead, f"{RUNS * len(LEVELS)} load steps", f"{RUNS} runs", "9.4 h", "one load")
    assert_says(section.lead, "dx, dz, rx, ry", "one in each", "6 signals", "v1 to v6")
    loads, channels, surroundings, runs = section.listings
    assert loads.rows[1] == ("fz", "4", "40", "6", "-9,000 N", "9,000 N", "up and down, both signs")
    assert [line[0] for line in channels.rows] == [*CHANNELS, *(f"v{k}" for k in range(1, 7))]
    assert surroundings.rows == (("temperature of the air", "20.01 °C", "20.12 °C", "156"),)
    assert runs.rows[4][:5] == ("5", "calibration", "fz", "dx", "13")
    facts = dict(build_head("c", tables).screen.facts)
    assert facts["instrument"] == "interferometer: dx dz rx ry, 6 signals"
    assert facts["data"].startswith("12 runs, 156 load steps")


def test_unread_values_are_empty_cells():
    tables = bench_tables()
    unread = (tables["readings"]["channel"] == "dz") & (tables["readings"]["run"] == 6)
    tables["readings"] = tables["readings"][~unread]
    counts = measured(tables).figures[1][0].data[0]
    assert counts.text[1][1] == ""
    assert counts.text[0][1] == "10"


def test_parasitic_loads_are_reported_where_a_calibration_ignores_them(tables):
    assert unrecorded_loads(assessed_causes(tables), tables) is None
    calibrated = {**tables, "sensor_matrix": pd.DataFrame({"matrix": ["G_B"]})}
    warned = [text for mark, text in build_head("c", calibrated).verdicts if mark == "warn"]
    # 12.03 mm and 7.98 mm at 9000 N.
    assert len(warned) == 1
    assert_says(warned[0], "z load", "108 N·m", "about y", "72 N·m", "about x")
    assert unrecorded_loads(assessed_causes(calibrated), calibrated).lead == warned[0]
    choice = pd.DataFrame({"model": ["weighted"], "figure": ["loads_as_diagnosed"], "value": [1.0]})
    reported = unrecorded_loads(assessed_causes(calibrated), {**calibrated, "sensor_choice": choice})
    assert_says(reported.lead, "z load", "108 N·m", "about y", "72 N·m", "about x")
    assert load_warning(assessed_causes(calibrated), {**calibrated, "sensor_choice": choice}) == ""
    uneven = {"force_x": size(0.002, 1e-4, "1/m"), "force_x_asymmetry": size(-0.004, 1e-4, "1/m")}
    torque = rows(row("load-imbalance", subject="load mx", parameters=uneven))
    torqued = load_warning(assessed_causes({"diagnosis": torque}), calibrated)
    assert_says(torqued, "torque about x", "18 N", "along x")
    doubted = load_warning(assessed_causes({"diagnosis": torque.assign(verdict="suspected")}), calibrated)
    assert_says(doubted, "suspected", "18 N", "would bias")


def test_a_sensors_pulls_are_named_by_its_elements():
    names = ["platform_radius", "stiffness of 3 spring axial", "stiffness of 1 compliance scale"]
    pulls = pd.DataFrame({"leg": [1.0, 2.0, np.nan], "parameter": names, "identifiable": True})
    tables = {"readings": None, "pulls": pulls.assign(pull_before=2.0, pull_after=[0.5, 0.4, 0.3])}
    part = PARTS["pulls"](tables)
    assert part.title == "Pulls: does the sensor agree with nominal?"
    named = {line[0] for line in part.listings[1].rows}
    assert named == {"platform radius of leg 1", "axial stiffness of spring 3 of leg 2", "stiffness of compliance 1"}


def test_signals_alone_are_measured_and_say_why_nothing_was_diagnosed():
    whole = bench_tables(signals=8)
    whole["diagnosis"] = whole["diagnosis"].iloc[:0]
    whole["diagnosis"].attrs["why_not"] = "needs the elements of a leg, or a compliance_file"
    tables = {name: whole[name] for name in ("signals", "diagnosis")}
    head = build_head("c", tables)
    mark, text = head.verdicts[0]
    assert mark == "none"
    assert_says(text, "Diagnosis", "not evaluated", whole["diagnosis"].attrs["why_not"])
    assert state_of("diagnosis", tables) == "not tested"
    assert_says(text_of(measured(tables)), "8 signals", "v1 to v8", "not measured")
    assert "reading" not in dict(head.screen.facts)["data"]
    Reader(render(tables))


def test_names_of_runs_stay_text():
    attack = "</script><img src=x onerror=alert(1)>"
    tables = bench_tables(signals=0)
    for name in ("readings", "reading_errors"):
        tables[name]["run"] = attack + tables[name]["run"].astype(str)
    read = Reader(render(tables))
    assert not [tag for tag, _ in read.elements if tag == "img"]
    assert attack in read.text
    for script in read.scripts[1:]:  # the first is the style
        assert "<img" not in script
        assert "</" not in script


def test_the_loads_to_apply_next_are_in_a_row_per_run_with_all_steps_to_take_along():
    levels = [0.0, 5000.0, 10000.0, 5000.0, 0.0]
    loads = dict.fromkeys(("fx_n", "fy_n", "mx_nm", "my_nm", "mz_nm"), 0.0)
    steps = [
        {
            "purpose": "creep load fz against hysteresis load fz",
            "run": run,
            "step": step,
            "time_s": 480.0 * step,
            **loads,
        }
        | {"fz_n": load, "branch": "loading", "channels": "dx dz", "conditions": "a step every 8 min", "times": 3.0}
        | {"expected": f"odds of {run * 5}:1", "need": "rival", "measurements": 6}
        for run in (1, 2)
        for step, load in enumerate(levels)
    ]
    short = "To tell it from hysteresis, apply these 2 runs of loads, 3 times each: so it is."
    then = {"next_in_short": short, "advice_kind": "separate"}
    found = row("creep", subject="load fz", parameters={"fraction": size(0.02, 0.001)}, **then)
    tables = bench_tables(rows(found)) | {"next_loads": pd.DataFrame(steps)}
    part = part_of("next", tables)
    assert_says(part.lead, "1 question", "open")
    (listing,) = part.listings
    assert_says(listing.caption, "creep load fz", "hysteresis load fz", "2 different runs", "6 runs")
    first = ("1", "3", "fz 0, 5000, 10000, 5000, 0 N", "dx dz", "a step every 8 min", "–", "odds of 5:1")
    assert listing.rows[0] == first
    assert listing.csv.splitlines()[2] == "1,1,480,0,0,5000,0,0,0,dx dz"
    text = "To tell it from hysteresis, apply these 2 runs of loads, 3 times each: so it is."
    assert any(words == text for _, words in build_head("c", tables).verdicts)
