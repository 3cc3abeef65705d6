"""Sections of a loaded sensor: sentences and figures, also with missing tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.sensor.effects import LoadEccentricity
from tests.blind.generator.sensor.layout import DataFaults, Programme
from tests.report.diagnosis_parts import state_of
from tests.sentences import assert_says
from tests.stages.benches import bench, layout
from truing.report.exclusion_section import excluded
from truing.report.sections import build_sections
from truing.report.sensor.calibration import calibration, calibration_verdict
from truing.report.sensor.deformation import deformation, deformation_verdict
from truing.report.sensor.displacement import displacement
from truing.report.tables import CHANNELS, LOADS, WHY_NOT
from truing.schemas.verdict import ReasonCode

STAGES = ("ingest", "pose", "deformation", "calibrate")


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> dict[str, pd.DataFrame]:
    """A bench whose z load is off its line, with a channel never measured under it and some gross errors."""
    faults = DataFaults(gross_share=0.01, never=("rz",))
    made = layout(programme=Programme(channels="all"), faults=faults, signals=6)
    off = LoadEccentricity(2, (0.012, -0.008, 0.0))
    made = bench(tmp_path_factory.mktemp("page") / "c", made, 8, [off], stages=STAGES)
    frames = {name: made.frame(name) for name, table in made.tables.items() if not isinstance(table, str)}
    frames["sensor_matrix"].attrs[WHY_NOT] = made.outcomes["calibrate"].why_not
    return frames


def test_the_page_has_a_bench_and_no_machine(tables):
    found = build_sections(tables, {})
    sections = {section.id: section for section in found}
    essential = ["diagnosis", "qa", "calibration", "requirements"]
    appendix = ["measured", "displacement", "deformation", "tolerances", "alike", "uncertainty", "excluded"]
    assert [section.id for section in found] == [*essential, *appendix, "provenance", "glossary"]
    assert sections["requirements"].state == "not tested"


def test_displacement_shows_what_was_never_measured(tables):
    section = displacement(tables)
    assert_says(section.lead, "Never measured", "unknown", "rz")
    rows = {row[0]: row[2:] for row in section.listings[0].rows}
    assert rows["fz"][-1] == "not measured"
    assert all(int(cell) > 12 for cell in rows["fz"][:-1])
    (figure, _) = section.figures[0]
    crosses = sum(len(trace.x) for trace in figure.data if trace.marker.symbol == "x-thin")
    assert crosses == tables["reading_residuals"]["rejected"].sum() > 0


def test_deformation_names_the_entries_that_differ_and_draws_both(tables):
    section = deformation(tables)
    assert "ry under fz" in section.lead
    assert_says(section.lead, "36 entries", "6", "never measured")
    own, others, entries = (figure for figure, _ in section.figures)
    simulated = [trace for trace in own.data if trace.name == "simulated"]
    assert len(simulated) == 5
    curves = tables["axis_curves"].query("load == 'fz' and channel == 'dz'").sort_values("applied", kind="stable")
    line = next(one for one in simulated if len(one.y) == len(curves) and np.allclose(one.y, curves["simulated"]))
    np.testing.assert_allclose(line.x, 1e-3 * curves["applied"])
    empty = [note.text for note in others.layout.annotations].count("not measured")
    assert empty == 0  # a channel that nobody read has no row of panels
    matrix = entries.data[0]
    assert matrix.z[4][2] < -4.0
    assert "not" in matrix.text[5][0]


def test_calibration_gives_the_choice_and_the_matrix(tables):
    section = calibration(tables)
    assert_says(section.lead, "Chosen", "weighted, forward", "zero common", "linear")
    assert_says(section.lead, "least squares", "no zero")
    tests, matrix = section.listings[:2]
    assert [row[0] for row in tests.rows] == ["pass", "not evaluated"]
    assert state_of("calibration", tables) == "ok"
    assert [row[0] for row in matrix.rows] == ["fx (N)", "fy (N)", "fz (N)", "mx (N·m)", "my (N·m)", "mz (N·m)"]
    assert matrix.csv.count("\n") == 37
    held, classes, merit = (figure for figure, _ in section.figures)
    assert len(held.data) == 6
    assert {name for trace in classes.data for name in trace.x} >= {"hysteresis", "crosstalk", "zero return"}
    assert [trace.name for trace in merit.data] == ["G", "G'", "G, elastic joints"]


def test_scatter_that_a_fit_learned_from_its_residuals_is_not_called_noise(tables):
    """Residuals contain what a linear model lacks: agreement with them is no agreement with the noise of the
    signals."""
    choice = tables["sensor_choice"].copy()
    learned = choice["model"].str.startswith("least squares")
    name = choice.loc[learned, "model"].iloc[0]
    choice.loc[choice["figure"] == "chosen", "value"] = (choice["model"] == name).astype(float)
    sentences = {
        model: calibration_verdict({**tables, "sensor_choice": own}, {}).explanation
        for model, own in (("weighted", tables["sensor_choice"]), ("least squares", choice))
    }
    assert_says(sentences["weighted"], "the noise")
    assert "noise" not in sentences["least squares"]
    for sentence in sentences.values():
        assert_says(sentence, "% of the largest load")


def test_gross_readings_are_among_what_was_left_out(tables):
    section = excluded(tables)
    count = int(tables["reading_residuals"]["rejected"].sum())
    assert f"{count} reading" in section.lead
    assert any(len(listing.rows) == count for listing in section.listings)


def test_theory_alone_says_why_there_is_no_matrix(tables):
    matrices = tables["sensor_matrix"].query("matrix in ['G', \"G'\"]").copy()
    matrices.attrs[WHY_NOT] = "V V^T is singular, the channels are not independent"
    empty = {name: tables[name].iloc[:0] for name in ("sensor_choice", "error_classes")}
    theory = {**tables, **empty, "sensor_matrix": matrices}
    section = calibration(theory)
    assert state_of("calibration", theory) == "not tested"
    assert {row[0] for row in section.listings[0].rows} == {"not evaluated"}
    assert_says(section.lead, "V V^T", "singular")


@pytest.mark.parametrize(
    ("section", "name"),
    [(displacement, "displacement"), (deformation, "compliance"), (calibration, "sensor_matrix")],
)
def test_checks_not_evaluated_are_reported_as_such(tables, section, name):
    nothing = tables[name].iloc[:0].copy()
    nothing.attrs[WHY_NOT] = "the instrument was away"
    found = section({**tables, name: nothing})
    assert found.lead == "The instrument was away."
    assert found.state == ("" if name == "sensor_matrix" else "not evaluated")  # the verdict says it of calibrations
    assert section({}) is None


@pytest.mark.parametrize(
    ("apart", "said", "code", "mark"),
    [
        (0, ("reproduces all 36 measured entries",), ReasonCode.RIGID, "pass"),
        (4, ("differs from 4 of the 36", "reproduces the other 32"), ReasonCode.SIMULATION_MISSES, "warn"),
        (36, ("reproduces none of the 36 measured entries",), ReasonCode.SIMULATION_MISSES, "warn"),
    ],
)
def test_a_simulation_that_misses_entries_cannot_be_read_as_agreement(apart, said, code, mark):
    """The number of entries that agree and differ, the mark of the section, and the word of the test."""
    entries = [(response, load) for response in CHANNELS for load in LOADS]
    rows = pd.DataFrame(entries, columns=["response", "load"]).assign(coefficient=1e-8, sigma=1e-10, unit="m/N")
    pulls = [9.0 + k if k < apart else 0.5 for k in range(36)]
    verdicts = ["differs" if k < apart else "agrees" for k in range(36)]
    measured = rows.assign(model="matrix", pull=pulls, verdict=verdicts)
    compliance = pd.concat([measured, rows.assign(model="simulated", pull=None, verdict=None)], ignore_index=True)
    facts = [("agreement_p_value", 1e-9 if apart else 0.4), ("symmetry_p_value", 0.5)]
    errors = pd.DataFrame(
        [("matrix", figure, p, "1") for figure, p in facts], columns=["model", "figure", "value", "unit"]
    )
    tables = {"compliance": compliance, "deformation_errors": errors}
    section = deformation(tables)
    for fact in said:
        assert_says(section.lead, fact)
    verdict = deformation_verdict(tables, {})
    assert (verdict.reason_code, verdict.mark) == (code, mark)
    assert section.listings[0].rows[0][0] == ("contradicted" if apart else "pass")
