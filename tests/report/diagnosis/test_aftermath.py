"""Pulls, detectable effects, next measurements, and changes since an earlier model."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest

from tests.report import diagnosis_tables as made
from tests.report.diagnosis_parts import part_of, state_of, text_of
from tests.report.diagnosis_tables import GAIN_3, diagnosis_tables, row, rows
from tests.sentences import assert_says
from truing.belonging.relation import RelationState
from truing.report.diagnosis.pulls import changes, pulls, pulls_verdict
from truing.report.page import PageHead
from truing.report.page_head import build_head
from truing.report.rendering.render import render_page


@pytest.mark.parametrize(
    ("after", "p", "state", "words"),
    [
        (33.0, 0.3, "ok", "agrees with its nominal values"),
        (49.0, 0.02, "attention", "farther"),
        (90.0, 1e-9, "fails", "farther"),
        (9.0, 0.99, "ok", "closer"),
    ],
)
def test_pulls_are_compared_with_their_band(after, p, state, words):
    tables = diagnosis_tables() | {"pull_sums": made.pull_sums(after).assign(p_value=p)}
    part = part_of("pulls", tables)
    assert state_of("pulls", tables) == state
    assert words in part.lead
    # sqrt(1080 / 30), and the band sqrt(16.8 / 30) .. sqrt(47 / 30).
    assert_says(part.lead, "Rms pull", "6.0", "without the causes")
    assert_says(part.lead, "95 %", "tolerances", "0.75 to 1.3")


def _with_far_numbers(*pulls_of: tuple[int, str, float, float]):
    """Tables of a campaign in which all pulls are 0.1 but these, each with the error of its number, mm."""
    table = made.pulls().assign(pull_after=0.1, offset_after=0.03, explained_after=0.01, unit="mm")
    for leg, name, pull, offset in pulls_of:
        own = (table["leg"] == leg) & (table["parameter"] == name)
        table.loc[own, ["pull_after", "offset_after", "explained_after"]] = pull, offset, pull**2
    total = float((table["pull_after"] ** 2).sum())
    return diagnosis_tables() | {"pulls": table, "pull_sums": made.pull_sums(max(total, 48.0)).assign(p_value=1e-9)}


def test_one_wrong_number_of_the_description_is_named_with_its_size():
    alone = pulls_verdict(_with_far_numbers((2, "b_x", -40.0, -10.0)), {})
    assert alone is not None
    assert_says(alone.explanation, "does not fit the machine", "one wrong number")
    assert_says(alone.explanation, "Did you mean", "b_x of leg 2 smaller by 10.00 ±")
    assert "Equally likely" not in alone.explanation
    both = pulls_verdict(_with_far_numbers((2, "b_x", -40.0, -10.0), (5, "a_x", 30.0, 9.0)), {})
    assert both is not None
    assert "Did you mean" not in both.explanation, "no single number explains two far ones"
    assert "farther" in both.explanation
    of_leg = pulls_verdict(_with_far_numbers((2, "b_x", -40.0, -10.0), (2, "a_x", 30.0, 9.0)), {})
    assert of_leg is not None
    assert_says(of_leg.explanation, "nearly all pulls are of leg 2")


def test_no_number_is_named_where_each_is_as_far_off_as_chance_allows():
    sums = made.pull_sums(48.0).assign(p_value=0.02)
    near = (1, "a_x", 2.9, 0.62), (2, "b_x", -2.5, -0.5)
    within = pulls_verdict(_with_far_numbers((4, "a_x", 3.1, 0.69), *near) | {"pull_sums": sums}, {})
    assert within is not None
    assert within.state is RelationState.ATTENTION
    assert "Did you mean" not in within.explanation
    assert_says(within.explanation, "tolerances are too small, or a cause is missing")
    beyond = pulls_verdict(_with_far_numbers((4, "a_x", 5.2, 0.69), *near) | {"pull_sums": sums}, {})
    assert beyond is not None
    assert_says(beyond.explanation, "one wrong number explains it")
    assert_says(beyond.explanation, "Did you mean a_x of leg 4")


def test_one_wrong_number_is_named_where_the_sum_of_all_pulls_hides_it():
    tables = _with_far_numbers((3, "l", 5.2, 0.434)) | {"pull_sums": made.pull_sums(28.0).assign(p_value=0.6)}
    found = pulls_verdict(tables, {})
    assert found is not None
    assert found.state is RelationState.FAILS
    assert_says(found.explanation, "one number is farther", "corrected for")
    assert_says(found.explanation, "Did you mean", "l of leg 3 larger by 0.434 ± 0.083 mm")
    assert_says(part_of("pulls", tables).lead, "one number is farther")
    within = _with_far_numbers((3, "l", 2.8, 0.2)) | {"pull_sums": made.pull_sums(28.0).assign(p_value=0.6)}
    of_chance = pulls_verdict(within, {})
    assert of_chance is not None, "one of dozens of numbers beyond 2.8 sigma is chance"
    assert of_chance.state is RelationState.OK


def test_pulls_of_parameters_that_the_data_do_not_determine_are_left_out():
    part = part_of("pulls", diagnosis_tables())
    assert all("b_y" not in text for trace in part.figures[0][0].data for text in trace.text)
    assert_says(part.figures[0][1], "Not shown", "6 parameters", "not determine")


@pytest.mark.parametrize("table", ["pulls", "pull_sums"])
def test_empty_pulls_are_not_evaluated(table):
    tables = diagnosis_tables()
    tables[table] = tables[table].iloc[:0]
    assert state_of("pulls", tables) == "not tested"
    del tables["pulls"]
    assert pulls(tables) is None


def test_every_cause_has_its_smallest_detectable_size():
    part = part_of("hidden", diagnosis_tables())
    reported = {cells[0]: cells for cells in part.listings[0].rows}
    assert reported["actuator backlash"][2:5] == ("6 legs", "1.3 µm", "1.8 µm")
    assert reported["thermal expansion"][3] == "not at any plausible size"
    assert reported["target moved"][2:5] == ("30 targets", "20 µm", "23 µm")
    assert reported["actuator gain"][2] == "the whole"
    assert_says(part.lead, "cannot show", "thermal expansion")


def test_a_parameter_of_an_accepted_cause_is_not_called_masked():
    part_of_it = row(
        "thermal-expansion",
        "rejected",
        reason_code="contained",
    )
    part = part_of("hidden", diagnosis_tables(rows(row("leg-drift"), part_of_it)))
    assert "cannot show" not in part.lead
    assert {cells[0]: cells[3] for cells in part.listings[0].rows}["thermal expansion"] == "part of what was found"


def test_the_whole_is_counted_next_to_its_parts():
    table = made.detectable()
    whole = pd.DataFrame([("actuator-backlash", "", "backlash", 0.0008, "mm", 0.8)], columns=table.columns)
    part = part_of("hidden", diagnosis_tables() | {"detectable": pd.concat([whole, table], ignore_index=True)})
    reported = {cells[0]: cells[2:5] for cells in part.listings[0].rows}
    assert reported["actuator backlash"] == ("the whole, 6 legs", "0.80 µm", "1.8 µm")


def test_without_sizes_the_explanations_of_rejected_causes_are_shown():
    tables = diagnosis_tables()
    del tables["detectable"]
    part = part_of("hidden", tables)
    assert part.state == "not evaluated"
    assert_says(text_of(part), "not show", "leg-drift")


def test_configurations_are_ready_for_the_machine():
    tables = diagnosis_tables()
    part = part_of("next", tables)
    listing = part.listings[0]
    own = tables["next_poses"]
    assert listing.heads == ("pose", *(f"rho{leg}_mm" for leg in range(1, 7)), "expected result")
    lines = [line.split(",") for line in listing.csv.splitlines()]
    assert lines[0] == ["pose", *(f"rho{leg}_mm" for leg in range(1, 7))]
    assert np.allclose(np.array(lines[1:], dtype=float)[:, 1:], own[lines[0][1:]].to_numpy(), atol=0.5e-4)
    page = render_page(PageHead("c", ()), [part])
    (held,) = re.findall(r'<script type="application/json">(.*?)</script>', page)
    assert json.loads(held) == listing.csv


def test_each_purpose_has_its_own_table():
    tables = diagnosis_tables() | {"next_poses": made.next_poses(("a against b", "a"), 3)}
    captions = [listing.caption for listing in part_of("next", tables).listings]
    assert captions == ["a against b: 3 configurations", "a: 3 configurations"]


def test_the_head_says_what_to_measure_and_leaves_the_readings_to_the_table():
    short = "To know K22 twice as well, measure these 2 configurations: it falls to 0.2 um/mm."
    then = {"next_measurement": "To know K22, move a lot.", "next_in_short": short, "advice_kind": "sharpen"}
    tables = diagnosis_tables(rows(row("actuator-gain", parameters=GAIN_3, **then)))
    text = "Optional: to know K22 twice as well, measure these 2 configurations: it falls to 0.2 µm/mm."
    head = build_head("c", tables)
    assert ("next", text) in head.verdicts
    link = '<a href="#next">What to measure next</a>'
    assert render_page(head, [part_of("next", tables)]).count(link) == 2  # in the bar of sections, next to the sentence
    assert link not in render_page(head, [])
    assert_says(part_of("next", tables).statements[0][1], "measure", "2 configurations", "falls", "0.2 µm/mm")


def test_without_configurations_the_words_of_the_findings_stand():
    tables = diagnosis_tables()
    tables["next_poses"] = tables["next_poses"].iloc[:0]
    part = part_of("next", tables)
    assert part.state == "not evaluated"
    assert part.statements == (("next", "Platform deformation matrix: Move one actuator at a time."),)
    assert ("next", "Optional: move one actuator at a time.") in build_head("c", tables).verdicts


def test_a_change_is_reported_with_its_indistinguishable_alternatives():
    tables = diagnosis_tables() | {"changes": made.changes()}
    part = part_of("changes", tables)
    assert state_of("changes", tables) == "attention"
    assert_says(part.lead, "1 of 35", "changed", "l of leg 4", "150.0 ± 2.0 µm", "a_y4")
    assert part.lead.count(" of leg ") == 1
    assert_says(part.lead, "earlier model", "a_y4", "cannot")
    assert part.listings[0].rows[0][0] == "l of leg 4"
    assert part.listings[0].rows[0][5:7] == ("0.1500 ± 0.0020", "a_y4")
    assert part.listings[0].marks.count("changed") == 1
    assert "fail" not in part.listings[0].marks
    assert ("warn", part.lead) in build_head("c", tables).verdicts


def test_no_change_is_a_pass_and_nothing_in_common_is_not_evaluated():
    tables = diagnosis_tables() | {"changes": made.changes(moved=False)}
    assert state_of("changes", tables) == "ok"
    text = "Since the earlier model, none of 35 numbers changed beyond chance."
    assert ("pass", text) in build_head("c", tables).verdicts
    tables["changes"] = tables["changes"].assign(z=np.nan)
    assert part_of("changes", tables).state == "not evaluated"
    assert not [text for _, text in build_head("c", tables).verdicts if "earlier" in text]
    assert changes(diagnosis_tables()) is None


def test_another_machine_is_reported_as_such():
    table = made.changes().assign(changed=True, change=np.nan, sigma_change=np.nan, z=np.nan)
    tables = diagnosis_tables() | {"changes": table}
    part = part_of("changes", tables)
    assert state_of("changes", tables) == "attention"
    assert_says(part.lead, "another machine", "rebuilt")
    assert not part.figures


def test_a_number_of_an_effect_that_changed_is_reported_with_its_effect():
    table = made.changes()
    table.loc[table["changed"], ["parameter", "effect_of", "leg", "instead"]] = [
        "alpha",
        "thermal-expansion",
        np.nan,
        None,
    ]
    part = part_of("changes", diagnosis_tables() | {"changes": table})
    assert_says(part.lead, "alpha", "thermal-expansion")
