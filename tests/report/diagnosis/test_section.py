"""The diagnosis section shows findings, their certainty and gain, for any tables."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from tests.report import diagnosis_tables as made
from tests.report.diagnosis_parts import part_of, parts_of, state_of, text_of, verdict_of
from tests.report.diagnosis_tables import GAIN_3, MOVED, NOISE, diagnosis_tables, per_leg, rejected, row, rows, size
from tests.report.test_page import ATTACKS, Reader, render
from tests.sentences import assert_says, says
from truing.report.calibration.section import calibration
from truing.report.diagnosis.section import diagnosis
from truing.report.page import MOST_ROWS
from truing.report.page_head import build_head


def test_not_evaluated_is_neither_a_pass_nor_a_failure():
    tables = diagnosis_tables()
    tables["diagnosis"] = tables["diagnosis"].iloc[:0]
    section = diagnosis(tables)
    assert state_of("diagnosis", tables) == "not tested"
    assert not section.parts
    verdicts = build_head("c", tables).verdicts
    assert any(mark == "none" and "Diagnosis not evaluated" in text for mark, text in verdicts)


def test_a_finding_says_how_sure_it_is():
    section = diagnosis(diagnosis_tables())
    text = section.statements[0][1].replace("\u00a0", " ")
    for words in ("at most 0.05 % of campaigns", "signal-to-noise ratio 41", "above 99.9 %", "ranking is unchanged if"):
        assert words in text


def test_the_ranking_that_depends_on_plausible_scales_is_hatched_and_reported():
    part = part_of("evidence", diagnosis_tables(rows(row("actuator-gain", parameters=GAIN_3, scale_holds="changes"))))
    assert_says(part.lead, "ranking changes", "actuator gain")
    assert list(part.figures[0][0].data[0].marker.pattern.shape) == ["/"]


def test_the_figure_of_evidence_orders_candidates_and_names_the_next_best():
    part = part_of("evidence", diagnosis_tables())
    figure = part.figures[0][0]
    order = list(figure.layout.yaxis.categoryarray)
    assert order[0] == "platform deformation matrix "
    assert order[1] == "nonparametric effect "
    bars = [trace for trace in figure.data if trace.type == "bar"]
    places = {name: x for trace in bars for name, x in zip(trace.y, trace.x, strict=True)}
    assert [places[name] for name in order] == sorted(places.values(), reverse=True)
    assert places["base deformation "] > 0.0 > places["flexure shift "]
    # 812 - 640 natural logarithms are 74.7 decades.
    assert "10⁷⁵ times less probable" in part.lead


@pytest.mark.parametrize(("reason", "probability", "is_reported"), [("chance", 0.999, True), ("ended", 0.999, False)])
def test_a_rejected_cause_with_like_odds_alone_is_explained(reason, probability, is_reported):
    first = row("actuator-gain", parameters=GAIN_3, log_evidence=136.5, probability=probability)
    second = row("leg-drift", log_evidence=111.6)
    other = row("thermal-expansion", "rejected", log_evidence=137.5, p_value=0.72, reason_code=reason)
    lead = part_of("evidence", diagnosis_tables(rows(first, second, other))).lead
    assert ("Taken alone, the rejected cause thermal expansion" in lead and "(p = 0.72)" in lead) == is_reported


@pytest.mark.parametrize(("reason", "words"), [("contained", "part of a found cause"), ("chance", "")])
def test_a_clear_cause_that_is_rejected_says_why(reason, words):
    """A row *rejected, p < 1e-6, probability 1* contradicts itself."""
    other = row("thermal-expansion", "rejected", p_value=1e-9, probability=1.0, reason_code=reason)
    part = part_of("evidence", diagnosis_tables(rows(row("actuator-gain", parameters=GAIN_3), other)))
    (listing,) = (listing for listing in part.listings if "candidates" in listing.caption)
    decisions = [cells[2] for cells in listing.rows]
    assert decisions == ["found", f"rejected: {words}" if words else "rejected"]


def test_without_evidence_probabilities_are_drawn_and_without_these_nothing():
    found = row("actuator-gain", parameters=GAIN_3, log_evidence=np.nan)
    figure = part_of("evidence", diagnosis_tables(rows(found))).figures[0][0]
    assert "Probability" in figure.layout.title.text
    assert not part_of("evidence", diagnosis_tables(rows({**found, "probability": np.nan}))).figures


def test_the_share_that_was_removed_follows_from_before_after_and_floor():
    tables = diagnosis_tables()
    part = part_of("gain", tables)
    share = 100.0 * (1.0 - (7.9**2 - 7.2**2) / (34.2**2 - 7.2**2))
    assert_says(part.lead, f"{share:.3g} %", "variance", "noise")
    assert state_of("gain", tables) == "ok"


@pytest.mark.parametrize(("after", "state"), [(7.2, "ok"), (7.9, "ok"), (13.0, "ok"), (20.0, "fails"), (6.0, "ok")])
def test_residuals_beyond_the_noise_fail_the_check(after, state):
    found = row("actuator-gain", parameters=GAIN_3, heldout_rms_after=after)
    tables = diagnosis_tables(rows(found))
    part = part_of("gain", tables)
    assert state_of("gain", tables) == state
    assert ("times the noise floor" in part.lead.partition("error on calibration")[0]) is (not 6.6 < after < 8.0)


@pytest.mark.parametrize(("after", "state"), [(7.9, "ok"), (10.0, "attention"), (20.0, "fails")])
def test_more_than_noise_where_it_was_fitted_is_an_incomplete_picture(after, state):
    """Uncertain parameters raise the errors of held-out poses, but not those of fitted ones."""
    tables = diagnosis_tables(rows(row("actuator-gain", parameters=GAIN_3, rms_after=after)))
    assert state_of("gain", tables) == state


def test_without_held_out_poses_nothing_is_called_predicted():
    found = row("actuator-gain", parameters=GAIN_3, heldout_rms_before=None, heldout_rms_after=None)
    tables = diagnosis_tables(rows(found)) | {"prediction": made.prediction(held=0)}
    part = part_of("gain", tables)
    assert "held-out poses" not in part.lead
    assert_says(part.lead, "No pose", "held out")
    assert_says(verdict_of("diagnosis", tables).explanation, "lowers", "calibration poses", "33 µm", "7.4 µm")
    assert [trace.name for trace in part.figures[0][0].data] == ["calibration poses"]


def test_errors_far_below_what_noise_should_leave_are_not_called_at_its_floor():
    found = row("actuator-gain", parameters=GAIN_3, noise_floor=19.0)
    tables = diagnosis_tables(rows(found))
    part = part_of("gain", tables)
    assert state_of("gain", tables) == "attention"
    assert not says(part.lead, "consistent", "noise floor")
    assert_says(part.lead, "significantly below", "noise floor (19 µm)", "declared noise", "too large")
    explanation = verdict_of("diagnosis", tables).explanation
    assert_says(explanation, "significantly below", "noise (19 µm)", "declared noise", "too large")


def test_few_poses_below_the_noise_may_be_chance():
    found = row("actuator-gain", parameters=GAIN_3, heldout_rms_after=5.0)
    tables = diagnosis_tables(rows(found))
    few = tables["prediction"]
    tables["prediction"] = few[few["role"].eq("calibration") | (few["pose"] == few["pose"].max())].iloc[-4:]
    part = part_of("gain", tables)
    assert state_of("gain", tables) == "ok"
    assert_says(part.lead, "too few", "chance")


def test_only_a_run_that_left_a_model_is_reported_to_have_one():
    tables = diagnosis_tables()
    assert_says(diagnosis(tables).lead, "extended model", "model.toml")
    del tables["pulls"]
    assert "model.toml" not in diagnosis(tables).lead
    assert_says(diagnosis(tables).lead, "1 found", "included", "results below")
    del tables["next_poses"]
    assert "without a mechanism" in part_of("next", tables).lead


def test_a_found_cause_is_not_called_untestable():
    found = row("thermal-expansion", parameters={"alpha": size(1e-5, 1e-6, "1/K")})
    part = part_of("hidden", diagnosis_tables(rows(found, *rejected())))
    assert "cannot show" not in part.lead
    assert_says(text_of(part), "only beyond", "plausible sizes")
    assert_says(part_of("hidden", diagnosis_tables()).lead, "cannot show", "thermal expansion")


def test_only_the_first_targets_of_many_columns_are_named():
    table = made.detectable()
    table.loc[table["cause"] == "thermal-expansion", "parameter"] = " ".join(f"CODE{k}_x" for k in range(300))
    part = part_of("hidden", diagnosis_tables() | {"detectable": table})
    (named,) = [row[2] for row in part.listings[1].rows if row[0] == "thermal expansion"]
    assert named == "CODE0_x CODE1_x CODE2_x CODE3_x CODE4_x CODE5_x and 294 more"


def test_nothing_found_reports_how_far_the_simulation_misses_as_it_is():
    part = part_of("gain", diagnosis_tables(rows(*rejected())))
    assert "without the causes" not in part.lead
    assert_says(part.lead, "7.9 µm", "consistent", "noise floor")
    names = [trace.name for trace in part.figures[0][0].data]
    assert all("simulation without changes" in name for name in names)


def test_before_and_after_are_joined_pose_by_pose():
    tables = diagnosis_tables()
    figure = part_of("gain", tables).figures[1][0]
    drawn = {trace.name: trace for trace in figure.data if trace.mode == "markers"}
    assert [trace.name for trace in drawn.values() if trace.showlegend] == ["without the causes", "with the causes"]
    own = tables["prediction"].query("role == 'verification'")
    assert np.array_equal(drawn["with the causes, held-out poses"].y, own["rms_after"])
    assert np.array_equal(drawn["without the causes, held-out poses"].y, own["rms_before"])


def test_the_table_of_gains_holds_the_roots_of_mean_squares_within_their_intervals():
    tables = diagnosis_tables()
    listing = part_of("gain", tables).listings[0]
    own = tables["prediction"].query("role == 'verification'")
    expected = np.sqrt(np.mean(own["rms_before"] ** 2))
    text, _, interval = listing.rows[1][2].partition(" (")
    low, high = (float(part) for part in interval.rstrip(")").split(" to "))
    assert float(text) == pytest.approx(expected, rel=0.005)
    assert own["rms_before"].min() < low < expected < high < own["rms_before"].max()


def test_plain_calibrations_are_next_to_the_extended_one():
    tables = diagnosis_tables()
    extended = tables["accuracy"].query("model == '6-pus' and deformation == 'matrix'")
    tables["accuracy"] = pd.concat([tables["accuracy"], extended.assign(model="extended")], ignore_index=True)
    figure = part_of("gain", tables).figures[2][0]
    named = [
        "plain, the deformation ignored ",
        "plain, linear deformation ",
        "plain, matrix deformation ",
        "extended model ",
    ]
    assert list(figure.data[0].y) == named
    assert figure.data[0].x[2] == figure.data[0].x[3]


def test_the_extended_model_has_its_row_among_the_calibrations():
    tables = diagnosis_tables()
    choice, accuracy = tables["model_choice"], tables["accuracy"]
    own = choice.query("model == '6-pus' and deformation == 'matrix' and estimator == 'errors-in-variables'")
    own = own[~own["figure"].isin(["chosen", "indistinguishable"])]
    tables["model_choice"] = pd.concat([choice, own.assign(model="extended", estimator="points")], ignore_index=True)
    tables["accuracy"] = pd.concat([accuracy, accuracy.query("model == '6-pus'").assign(model="extended")])
    section = calibration(tables)
    assert_says(section.lead, "extended model", "diagnosis", "3 µm", "6 arcsec")
    listing = next(x for x in section.listings if x.caption.startswith("The extended model"))
    assert listing.rows[0][1:3] == ("extended", "matrix")


def test_the_matrix_is_a_heat_map_and_chance_is_in_brackets():
    figure = part_of("sizes", diagnosis_tables()).figures[0][0]
    assert figure.data[0].type == "heatmap"
    assert figure.data[0].text[0][0] == "25.0"
    assert figure.data[0].text[5][5] == "(1.3)"  # 2.6 sigma, and one of 36


def test_parameters_of_legs_are_bars_in_the_units_of_a_laboratory():
    part = part_of("sizes", diagnosis_tables(rows(row("actuator-gain", parameters=per_leg("gain")))))
    bars = part.figures[0][0].data[0]
    assert np.allclose(bars.y, [0.2 * leg for leg in range(1, 7)])  # per cent
    assert np.allclose(bars.error_y.array, 1.96 * 0.02)
    assert part.listings[0].rows[0][:2] == ("gain_1", "0.200 ± 0.020 %")


def test_text_counts_and_unknown_sigmas_are_reported_as_they_are():
    parameters = {"driver": size("temperature_c"), "bowl": size(1e-3, float("nan"), "mm/K"), "from_pose": size(23)}
    part = part_of("sizes", diagnosis_tables(rows(row("base-deformation", parameters=parameters))))
    reported = {cells[0]: cells[1] for cells in part.listings[0].rows}
    assert reported == {"driver": "temperature_c", "bowl": "1 µm/K", "from_pose": "23"}


def test_parts_are_in_the_order_in_which_they_are_read():
    tables = diagnosis_tables() | {"changes": made.changes()}
    order = ["diagnosis", "evidence", "gain", "sizes", "pulls", "swallowed", "hidden", "next", "changes"]
    parts = parts_of(tables)
    assert list(parts) == order
    assert parts["swallowed"].see[0][0] == "knowledge"


@pytest.mark.parametrize(
    "left", [set(), {"detectable"}, {"pulls", "pull_sums", "accuracy"}, {"prediction", "absorption"}]
)
def test_any_empty_or_missing_table_leaves_a_page(left):
    whole = diagnosis_tables()
    beside = {"detectable", "pulls", "pull_sums", "prediction", "next_poses", "accuracy", "absorption", "calibration"}
    empty = {name: table if name in {"diagnosis", *left} else table.iloc[:0] for name, table in whole.items()}
    fewer = {name: table for name, table in whole.items() if name not in beside - left}
    for tables in (empty, fewer):
        assert {"evidence", "gain", "sizes", "hidden", "next"} <= set(parts_of(tables))
        build_head("c", tables)


@pytest.mark.parametrize(
    "column", ["p_value", "probability", "rms_before", "rms_after", "heldout_rms_after", "noise_floor"]
)
def test_numbers_that_were_not_evaluated_do_not_stop_the_page(column):
    found = rows(row("platform-deformation-matrix", parameters=made.matrix()), row("unexplained", **NOISE), *rejected())
    tables = diagnosis_tables(found.assign(**{column: np.nan}))
    assert "nan" not in " ".join(text_of(part) for part in parts_of(tables).values()).lower().split()
    build_head("c", tables)


def test_rows_of_a_run_that_reported_less_are_read():
    """A diagnosis without the columns that may be absent, and without any of the tables next to it."""
    tables = diagnosis_tables()
    old = tables["diagnosis"].drop(columns=["signal_to_noise", "log_evidence", "scale_holds"])
    parts = parts_of({"diagnosis": old})
    assert parts["evidence"].figures
    assert parts["next"].state == parts["hidden"].state == "not evaluated"


def test_names_from_the_data_stay_text():
    attack = " ".join(ATTACKS)
    clean, tainted = diagnosis_tables(), diagnosis_tables()
    found = row("my-cause", subject=f"target {attack}", parameters={attack: size(1.0, 0.1, attack)}, explanation=attack)
    found |= {"next_measurement": attack}
    unexplained = row("unexplained", follows=attack.replace(" ", ""), parameters=per_leg("kappa"))
    plain_found = row("my-cause", subject="target P", parameters={"p": size(1.0, 0.1, "u")}, explanation="Said.")
    plain_unexplained = row("unexplained", follows="time_s", parameters=per_leg("kappa"))
    for tables, several in ((tainted, [found, unexplained]), (clean, [plain_found, plain_unexplained])):
        tables["diagnosis"] = rows(*several, *rejected())
        tables["changes"] = made.changes()
    tainted["detectable"]["subject"] = f"target {attack}"
    tainted["next_poses"]["purpose"] = tainted["next_poses"]["expected"] = attack
    tainted["changes"]["parameter"] = tainted["changes"]["parameter"].replace("l", attack)
    tainted["pulls"]["parameter"] = tainted["pulls"]["parameter"].replace("l", attack)
    tainted["prediction"]["pose"] = [f"{attack} {k}" for k in range(46)]
    clean["detectable"]["subject"] = "target P"
    pages = Reader(render(clean)), Reader(render(tainted, attack))
    assert [tag for tag, _ in pages[0].elements] == [tag for tag, _ in pages[1].elements]
    for script in pages[1].scripts[1:]:
        assert "<img" not in script
        assert "<svg" not in script
        assert "</" not in script.replace("\\u003c", "<").replace("</sup>", "")
    for part in parts_of(tainted).values():
        for figure, _ in part.figures:
            drawn = json.dumps(figure.to_plotly_json(), default=str)
            assert "<img" not in drawn
            assert "<svg" not in drawn
            assert "<a " not in drawn


def test_a_hundred_legs_and_targets_fit():
    legs = 100
    found = [
        row("actuator-gain", parameters=per_leg("gain", legs)),
        row("leg-drift", parameters=per_leg("drift", legs, "mm")),
    ]
    moved = [row("target-moved", "rejected", subject=f"target T{k}", parameters=MOVED) for k in range(legs)]
    tables = diagnosis_tables(rows(*found, *moved)) | {"pulls": made.pulls(legs), "changes": made.changes(legs)}
    tables["detectable"] = made.detectable(targets=3000)
    parts = parts_of(tables)
    assert len(parts["sizes"].figures[0][0].layout.xaxis.ticktext) < 30
    assert len(parts["evidence"].figures[0][0].layout.yaxis.categoryarray) == 16
    assert parts["evidence"].listings[0].folded
    assert f"The first {MOST_ROWS:,} of" in parts["hidden"].listings[1].note
    assert len(render(tables).encode()) < 9e6


def test_a_matrix_of_many_legs_is_drawn_without_numbers():
    tables = diagnosis_tables(rows(row("platform-deformation-matrix", parameters=made.matrix(24))))
    figure = part_of("sizes", tables).figures[0][0]
    assert np.asarray(figure.data[0].z).shape == (24, 24)
    assert not figure.data[0].texttemplate


def test_numbers_of_effects_are_among_those_of_the_extended_model():
    tables = diagnosis_tables()
    fitted = tables["calibration"]
    own = fitted.query("model == '6-pus' and deformation == 'none'").assign(model="extended", effect_of=None)
    effects = own.head(4).assign(nominal=np.nan, tolerance=np.nan, pull=np.nan, identified=0.05, sigma=0.003, unit="mm")
    effects = effects.assign(leg=np.nan, parameter=["dx", "dy", "dx", "dy"])
    effects["effect_of"] = ["target-moved target P07"] * 2 + ["target-moved target P08"] * 2
    tables["calibration"] = pd.concat([fitted, own, effects], ignore_index=True)
    listing = next(x for x in calibration(tables).listings if "deformation ignored" in x.caption)
    reported = {cells[1].replace("\u00a0", " "): cells[-1] for cells in listing.rows if cells[0] == "extended"}
    assert reported["dx of target-moved target P07 (mm)"].replace("\u00a0", " ") == "0.0500 ± 0.0030"
    assert "dx of target-moved target P08 (mm)" in reported
