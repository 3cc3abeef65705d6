"""The page shows the chosen calibration with reason, parameters, identifiability, and requirements."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest

from tests.report.calibration_tables import MODELS, calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.test_page import ATTACKS, PLOTLY, Reader
from tests.sentences import assert_says
from truing.report.calibration.requirements import requirements
from truing.report.calibration.section import calibration
from truing.report.identifiability_section import knowledge
from truing.report.model_tests import below_noise
from truing.report.page import ReportSection
from truing.report.page_head import build_head
from truing.report.rendering.render import render_page
from truing.report.sections import build_sections

PARTS = (calibration, knowledge, requirements)
OURS = ("calibration", "knowledge", "requirements")
MANDATORY = ("calibration", "observability", "requirements")
SMALL = {"legs": 3, "models": ("6-pus", "beam"), "deformations": ("linear", "matrix")}


def sections_of(tables) -> dict[str, ReportSection]:
    found = [section for part in PARTS if (section := part(tables)) is not None]
    return {section.id: section for section in found}


def page_of(tables) -> Reader:
    return Reader(render_page(build_head("c", tables), list(sections_of(tables).values())))


@pytest.fixture(scope="module")
def tables():
    return calibration_tables()


@pytest.fixture(scope="module")
def sections(tables):
    return sections_of(tables)


def listing(section, words):
    return next(item for item in section.listings if words in item.caption)


def test_calibration_and_requirements_are_essential_and_what_can_be_known_is_behind():
    order = [section.id for section in build_sections({**campaign_tables(poses=3), **calibration_tables(**SMALL)}, {})]
    known, behind, required = (order.index(name) for name in OURS)
    assert known < required < order.index("deformation") < behind


def test_every_section_has_its_figures(sections):
    assert [len(sections[name].figures) for name in OURS] == [3, 3, 1]


def test_every_figure_says_what_it_shows(sections):
    for name in OURS:
        for figure, caption in sections[name].figures:
            assert len(figure.layout.title.text) > 10
            assert len(figure.layout.title.subtitle.text) > 20
            assert caption.endswith(".")


def test_the_lead_names_the_choice_and_its_reasons(sections):
    lead = sections["calibration"].lead
    for words in (
        "the 6-pus model with matrix deformation",
        "3 µm and 6 arcsec",
        "1.02 times the noise floor",
        "do not distinguish the chosen calibration from the beam model",
        "10 other calibrations are less probable or less accurate: held-out error 1.02 to 5.10 times",
    ):
        assert words in lead


def test_the_gain_over_the_nominal_is_reported_where_it_is_known():
    tables = calibration_tables()
    rows = [("6-pus", "none", "nominal", f"{what}_mean_verification", 300.0) for what in ("position", "orientation")]
    columns = ["model", "deformation", "estimator", "figure", "value"]
    nominal = pd.DataFrame(rows, columns=columns).assign(unit="um")
    tables["model_choice"] = pd.concat([tables["model_choice"], nominal], ignore_index=True)
    lead = calibration(tables).lead
    assert_says(lead, "nominal parameters", "300 µm")
    assert "100 times that of the chosen calibration" in lead


def test_all_twelve_calibrations_are_side_by_side_in_both_ways(sections):
    ours, theirs = (item for item in sections["calibration"].listings if "held out / noise" in item.heads)
    assert len(ours.rows) == len(theirs.rows) == 12
    assert [row[:3] for row in ours.rows if row[0]] == [
        ("chosen", "6-pus", "matrix"),
        ("equal", "beam", "matrix"),
    ]
    assert not ours.folded
    assert theirs.folded


def test_the_loss_of_accuracy_by_simpler_models_is_reported(sections):
    caption = sections["calibration"].figures[0][1]
    assert "jacobian 12 µm" in caption
    assert "not equivalent" in caption


def test_bars_hold_the_mean_and_the_maximum_of_each_calibration(tables, sections):
    figure = sections["calibration"].figures[0][0]
    own = tables["accuracy"].query("model == 'beam' and deformation == 'linear' and role == 'verification'")
    bars = [t for t in figure.data if t.offsetgroup == "verification"][:2]
    place = list(zip(*bars[0].y, strict=True)).index(("linear", "beam"))
    assert bars[0].x[place] == own["position_error_um"].max()
    assert bars[1].x[place] == pytest.approx(own["position_error_um"].mean(), rel=1e-12)
    assert [shape.x0 for shape in figure.layout.shapes] == pytest.approx([3.3, 6.4], rel=1e-12)


def test_deviations_are_in_a_row_per_kind_and_a_column_per_leg(tables, sections):
    shown = listing(sections["calibration"], "Parameters of the 6-pus model with matrix deformation")
    assert shown.heads == ("parameter", *(f"leg {k}" for k in range(1, 7)))
    rows = {row[0].replace("\u00a0", " "): row[1:] for row in shown.rows}
    assert set(rows) == {
        *(f"{name} (mm)" for name in ("a_x", "a_y", "b_x", "b_y", "l")),
        "u_x (mrad)",
        *(f"K, ρ{k} (µm/mm)" for k in range(1, 7)),
    }
    assert all(cell.endswith("*") for cell in rows["b_y (mm)"])
    own = tables["calibration"].query("model == '6-pus' and deformation == 'matrix' and parameter == 'K23'").iloc[0]
    text = rows["K, ρ3 (µm/mm)"][1].replace("\u00a0", " ")
    value, _, sigma = text.split()  # the entry itself, and no pull: a deformation departs from no drawing
    assert float(value) == pytest.approx(1e3 * own["identified"], abs=1e3 * own["sigma"])
    assert float(sigma) == pytest.approx(1e3 * own["sigma"], rel=0.1)


def test_tables_of_all_calibrations_are_folded_by_deformation(sections):
    folded = [item for item in sections["calibration"].listings if item.caption.startswith("All parameters")]
    assert len(folded) == 6
    assert all(item.folded for item in folded)
    assert [row[0] for row in folded[0].rows] == [model for model in MODELS for _ in range(6)]


def test_strong_correlations_are_listed_and_all_are_drawn(sections):
    strong = listing(sections["calibration"], "Correlations")
    assert strong.rows == (("a_x of leg 1", "a_y of leg 1", "-0.970"),)
    heat = sections["calibration"].figures[2][0].data[0]
    z = np.asarray(heat.z)
    assert z.shape == (72, 72)
    assert (z == z.T).all()
    assert z[0, 1] == -97
    assert list(heat.x[:2]) == ["a_x of leg 1", "a_y of leg 1"]


def test_the_picture_states_its_amplification_and_amplifies_by_it(tables, sections):
    figure = sections["calibration"].figures[1][0]
    gain = float(figure.layout.title.text.rpartition("amplified ")[2].split()[0])
    linear = next(t for t in figure.data if t.marker.symbol == "x-thin")
    fitted = tables["implicit_calibration"]
    own = fitted.query("model == '6-pus' and deformation == 'linear' and parameter == 'a_x'").iloc[0]
    assert linear.x[0] == pytest.approx(own["nominal"] + gain * (own["identified"] - own["nominal"]), rel=1e-12)
    drawn = [t.marker.symbol for t in figure.data if t.legendgroup and t.mode == "markers"]
    assert drawn == ["circle-open", "x-thin", "triangle-up-open"] * 2  # in both panels


def test_indistinguishable_causes_are_reported_in_words(sections):
    lead = sections["knowledge"].lead
    assert_says(lead, "Poses and readings", "6 of the 11", "a leg")
    assert_says(lead, "a_x, a_y, b_x, b_y, u_x, l", "ρ0", "unidentifiable")
    assert_says(lead, "42 of the 90", "6-pus", "matrix", "only tolerances")
    rows = listing(sections["knowledge"], "cannot distinguish, leg by leg").rows
    assert rows[:3] == (
        ("only a_x1 + 0.01 u_x1 is determined", "1.18"),
        ("a_z1 : ρ0_1 = 1 : -1 is unobservable", "1.20"),
        ("b_z1 : l1 = 1 : 1 is unobservable", ""),
    )
    assert len(rows) == 3 * 6


def test_each_leg_has_its_rank_and_its_identifiable_set(sections):
    rows = listing(sections["knowledge"], "Observability of each leg by poses and readings alone").rows
    assert [row[:3] for row in rows] == [
        *((f"leg {k}", "11", "6") for k in range(1, 7)),
        ("the 6-pus model with matrix deformation", "90", "42"),
    ]
    assert rows[1][3] == "a_x2 a_y2 b_x2 b_y2 u_x2 l2"


def test_shifts_below_every_tolerance_are_not_called_absorption():
    tables = calibration_tables(**SMALL)
    tables["absorption"][["predicted", "observed"]] *= 1e-3
    assert_says(knowledge(tables).lead, "deformation", "bias", "no parameter")


def test_fewer_than_six_legs_have_no_errors_and_no_verdict():
    tables = calibration_tables(**SMALL)
    for name in ("accuracy", "requirements"):
        tables[name] = tables[name].iloc[:0]
    assert_says(calibration(tables).lead, "not constrain", "platform")
    assert_says(requirements(tables).lead, "not constrain", "platform")


def test_only_the_telescope_is_held_against_its_report():
    caption = calibration(calibration_tables(models=("ups", "jacobian"), deformations=("none",))).figures[0][1]
    assert_says(caption, "models", "not equivalent")


def test_long_leg_numbers_are_not_mistaken_for_parameters():
    found = knowledge(calibration_tables(legs=10, models=("6-pus",)))
    sigmas = listing(found, "Standard deviation of each parameter from")
    assert [row[0] for row in sigmas.rows] == ["a_x", "a_y", "b_x", "b_y", "u_x", "l", "ρ0"]
    assert all(row[1:] == ("9.60",) * 10 for row in sigmas.rows[:6])
    assert sigmas.rows[6][1:] == ("–",) * 10


def test_the_lead_names_the_parameters_that_swallow_most():
    tables = calibration_tables()
    absorbed = tables["absorption"]
    most = (absorbed["predicted"] / np.where(absorbed["unit"] == "1", 0.002, 0.5)).abs().idxmax()
    absorbed.loc[most, ["predicted", "observed", "sigma"]] *= 3.0
    name = f"{absorbed.loc[most, 'parameter']} of leg {absorbed.loc[most, 'leg']}"
    lead = knowledge(tables).lead
    named = re.findall(r"(?:bias|;) (\S+ of leg \d+) by about", lead)
    assert name.replace("kappa", "κ") in named[:2]


def test_predicted_and_observed_meet_on_the_line(tables, sections):
    figure = sections["knowledge"].figures[2][0]
    points = [t for t in figure.data if t.mode == "markers"]
    own = tables["absorption"].query("parameter == 'a_x' and deformation == 'none' and estimator == 'implicit'")
    assert any(np.array_equal(np.asarray(t.x), own["predicted"]) for t in points)
    assert "r = 1.000" in figure.layout.annotations[0].text or "r = 0.99" in figure.layout.annotations[0].text
    assert all(t.x == t.y for t in figure.data if t.mode == "lines")


def test_requirements_have_their_verdicts_and_their_colours(sections):
    shown = listing(sections["requirements"], "With the 6-pus model with matrix deformation")
    assert [row[0] for row in shown.rows] == ["meets", "meets", "fails", "undecided", "meets", "not evaluated"]
    assert shown.marks == ("pass", "pass", "fail", "warn", "pass", "none")
    assert shown.rows[2][2:5] == ("100 µm", "200 µm", "160 µm to 260 µm")
    assert_says(sections["requirements"].lead, "3 of 6", "met", "1 not met", "1 undecided", "1 not tested")
    names = {trace.name: list(trace.y) for trace in sections["requirements"].figures[0][0].data}
    assert names == {"meets": ["x", "y", "ry"], "undecided": ["rx"], "fails": ["z"]}


def test_the_head_reports_what_is_not_met_and_the_error():
    head = build_head("c", calibration_tables())
    (failed,) = [text for mark, text in head.verdicts if mark == "fail"]
    assert_says(failed, "3 of 6", "met", "1 not met", "1 undecided", "1 not tested")
    assert_says(failed, "z", "2 times", "limit")


@pytest.mark.parametrize("name", MANDATORY)
def test_empty_tables_are_not_evaluated_and_say_why(name):
    tables = calibration_tables(**SMALL)
    tables[name] = tables[name].iloc[:0]
    found = [section for section in build_sections(tables, {}) if section.id in OURS]
    states = {s.id: s.lead for s in found if s.state in ("not evaluated", "not tested")}
    assert name in states or name == "observability"
    assert all(len(lead) > 20 for lead in states.values())
    Reader(render_page(build_head("c", tables), list(found)))


def test_a_campaign_without_readings_says_that_there_is_nothing_to_calibrate():
    tables = {name: table.iloc[:0] for name, table in calibration_tables().items()}
    states = {s.id: s.lead for s in sections_of(tables).values() if s.id in OURS}
    assert list(states) == list(OURS)
    for lead in states.values():
        assert_says(lead, "no mechanism", "actuator readings")


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("implicit_calibration", calibration),
        ("correlations", calibration),
        ("accuracy", calibration),
        ("model_choice", calibration),
        ("model_choice", requirements),
        ("calibration", knowledge),
        ("absorption", knowledge),
    ],
)
def test_every_other_table_may_be_absent_or_empty(name, part):
    tables = calibration_tables(**SMALL)
    tables[name] = tables[name].iloc[:0]
    empty = part(tables)
    del tables[name]
    absent = part(tables)
    for section in (empty, absent):
        assert section is not None
        assert "nan" not in re.findall(r"\w+", repr((section.lead, section.listings)))
    assert empty.listings == absent.listings
    assert empty.state == absent.state


@pytest.mark.parametrize("name", list(calibration_tables(**SMALL)))
def test_any_single_table_makes_a_page(name):
    assert not page_of({name: calibration_tables(**SMALL)[name]}).open


@pytest.mark.parametrize(
    "kind",
    [
        {"legs": 3, "models": ("ups",), "parameters": ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")},
        {"legs": 10, "models": ("ups",)},
        {"models": ("6-pus",), "deformations": ("none",)},
        {"models": ("6-pus",), "deformations": ("none",), "parameters": ("l",)},
    ],
)
def test_any_mechanism_has_its_page(kind):
    tables = calibration_tables(**kind)
    found = sections_of(tables)
    legs = kind.get("legs", 6)
    shown = listing(found["calibration"], "Parameters of")
    assert len(shown.heads) == 1 + legs
    assert all(len(row) == 1 + legs for row in shown.rows)
    page = Reader(render_page(build_head("c", tables), list(found.values())))
    assert not page.open
    assert "nan" not in page.text.split()


def test_optional_columns_may_be_absent():
    tables = calibration_tables(**SMALL)
    dropped = {
        "calibration": ["tolerance", "pull", "identifiable", "status"],
        "accuracy": ["position_noise_um", "orientation_noise_arcsec"],
        "observability": ["combination", "leg"],
        "requirements": ["message"],
    }
    for name, columns in dropped.items():
        tables[name] = tables[name].drop(columns=columns)
    page = page_of(tables)
    assert "nan" not in page.text.split()


def test_parameters_of_no_leg_have_a_column_of_their_own():
    tables = calibration_tables(models=("6-pus",), deformations=("none",))
    shared = tables["calibration"].iloc[:1].assign(leg=np.nan, parameter="flexure_bending", unit="N m2", nominal=0.09)
    tables["calibration"] = pd.concat([tables["calibration"], shared], ignore_index=True)
    shown = listing(calibration(tables), "Parameters of")
    assert shown.heads[-1] == "all legs"
    assert [row[0] for row in shown.rows if row[-1]] == ["flexure_bending\u00a0(N·m²)"]


def test_calibrations_that_did_not_converge_are_named():
    tables = calibration_tables()
    bad = (tables["calibration"]["model"] == "beam") & (tables["calibration"]["deformation"] == "linear")
    tables["calibration"].loc[bad, "status"] = "diverged"
    section = calibration(tables)
    assert_says(section.lead, "1 calibration", "not converge")
    rows = next(item for item in section.listings if "held out / noise" in item.heads).rows
    assert [row[:3] for row in rows if row[0] == "diverged"] == [("diverged", "beam", "linear")]


def test_without_a_choice_of_model_no_claim_is_made():
    tables = calibration_tables()
    choice = tables["model_choice"]
    choice.loc[choice["figure"] == "chosen", "value"] = 0.0
    lead = calibration(tables).lead
    assert "none was chosen" in lead
    assert "Chosen for" not in lead


def test_names_cannot_inject_anything():
    tables = calibration_tables(**SMALL)
    names = dict(zip(("beam", "linear", "l", "platform-deformation-matrix"), ATTACKS, strict=True))
    for table in tables.values():
        for column in ("model", "deformation", "parameter", "other_parameter", "effect"):
            if column in table:
                table[column] = table[column].replace(names)
        for column in ("message", "combination"):
            if column in table:
                table.loc[table[column].notna(), column] = ATTACKS[0]
    clean, tainted = page_of(calibration_tables(**SMALL)), page_of(tables)
    assert {tag for tag, _ in tainted.elements} == {tag for tag, _ in clean.elements}
    assert all(attack in tainted.text for attack in ATTACKS)
    for script in tainted.scripts[1:]:
        assert "<img" not in script
        assert "<svg" not in script
        assert "</" not in script


def test_markup_in_names_stays_text_in_figures():
    tables = calibration_tables(**SMALL)
    for name in calibration_tables(**SMALL):
        for column in ("model", "deformation", "parameter", "other_parameter", "effect"):
            if column in tables[name]:
                tables[name][column] = tables[name][column].replace({"6-pus": "<b>P</b>", "matrix": "<b>K</b>"})
                tables[name][column] = tables[name][column].replace({"l": "<b>l</b>"})
    for section in sections_of(tables).values():
        for figure, _ in section.figures:
            assert "<b>" not in json.dumps(figure.to_plotly_json(), default=str)


def test_the_page_stays_small_and_is_the_same_for_the_same_tables(tables, sections):
    page = render_page(build_head("c", tables), list(sections.values()))
    assert page == render_page(build_head("c", tables), list(sections_of(calibration_tables()).values()))
    assert len(page.replace(PLOTLY, "").encode()) < 3e5


def test_a_model_that_is_far_off_does_not_hide_the_others():
    tables = calibration_tables(**SMALL)
    figure = calibration(tables).figures[0][0]
    assert figure.layout.xaxis.type is None
    tables["accuracy"].loc[tables["accuracy"]["model"] == "beam", "position_error_um"] *= 100.0
    figure = calibration(tables).figures[0][0]
    assert figure.layout.xaxis.type == "log"
    assert figure.layout.xaxis.title.text.endswith("log scale")
    assert figure.layout.xaxis2.type is None
    least = min(float(np.min(trace.x)) for trace in figure.data if trace.xaxis == "x")
    assert 10.0 ** figure.layout.xaxis.range[0] < least


def test_a_misfit_far_below_the_noise_is_no_pass():
    assert below_noise("asked", 95.0, 100.0, "why") is None
    assert below_noise("asked", 1.0, 3.0, "why") is None  # chance leaves as little once in five
    test = below_noise("asked", 30.0, 100.0, "the declared noise is too large")
    assert test is not None
    assert test.state == "fail"
    assert_says(test.statement, "significantly less", "declared noise", "too large")
