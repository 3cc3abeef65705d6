"""The first screen: which machine, instrument, dates and counts, one change of an error, and three links."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.report.bench_tables import bench_tables
from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.diagnosis_tables import diagnosis_tables
from tests.report.test_page import ATTACKS, Reader, render, sections_of
from truing.report.comments import with_comments
from truing.report.diagnosis.assessed_causes import assessed_causes, modelled_of
from truing.report.diagnosis.gain import compared_calibrations
from truing.report.diagnosis.next_steps import next_steps
from truing.report.diagnosis.prediction_errors import errors_of_models, root_mean_square
from truing.report.first_screen import first_screen, sigma_of_rms
from truing.report.measured_section import campaign_span
from truing.report.numbers import plain, quantity
from truing.report.page import CampaignFacts, Depth, RawFileFacts, ReportSection, all_of
from truing.report.page_head import _positioning_tiles, build_head
from truing.report.rendering.render import _with_fixed_spaces, render_page
from truing.report.scene.machine_drawing import _placed_labels, machine_drawing
from truing.report.section_verdict import verdict_rows
from truing.report.sections import build_sections, section_names
from truing.report.similar_numbers_section import alike
from truing.report.stopping_section import stop
from truing.report.verdict import with_verdict
from truing.schemas.needs import Need
from truing.schemas.stage_cost import StageCost

ABOUT = CampaignFacts(
    title="Wing 7, second campaign",
    laboratory="Laboratory of Lengths",
    machine="hexapod with linear actuators at the base (6-PUS)",
    instrument="camera no. 4",
    measured=("2026-11-20", "2026-11-21"),
    made="2026-11-24",
    version="9.9",
)


def test_the_first_screen_has_machine_instrument_dates_counts_and_version() -> None:
    tables = campaign_tables()
    facts = dict(build_head("c", tables, ABOUT).screen.facts)
    assert facts["machine"] == "hexapod with linear actuators at the base (6-PUS)"
    assert facts["instrument"].startswith("camera no. 4; 3-D points")
    assert facts["measured"].startswith("2026-11-20 to 2026-11-21")
    assert facts["data"].startswith(f"{tables['configurations']['pose'].nunique()} poses")
    assert f"{len(tables['observations']):,} points" in facts["data"]
    assert facts["page"] == "2026-11-24, truing 9.9"


def test_without_a_date_it_says_which_key_gives_it() -> None:
    assert "[certificate] begin" in dict(build_head("c", campaign_tables()).screen.facts)["measured"]


@pytest.mark.parametrize("tables", [campaign_tables(), bench_tables()])
def test_errors_of_the_first_screen_equal_those_of_the_section(tables) -> None:
    change = build_head("c", tables).screen.change
    rows = assessed_causes(tables)
    first = errors_of_models(rows, modelled_of(rows), tables)[0]
    assert change is not None
    for reported, size in ((change.before, first.before), (change.after, first.after)):
        number = float(re.match(r"[\d.]+", reported)[0])
        assert number == pytest.approx(float(plain(size)), rel=0.05)


def test_both_errors_have_an_uncertainty_and_it_is_said_of_what_kind_or_why_not() -> None:
    for tables, kind in ((diagnosis_tables(), "scatter of 6 poses"), (bench_tables(), "by noise, from")):
        change = build_head("c", tables).screen.change
        assert change is not None
        assert "±" in change.before
        assert "±" in change.after
        assert kind in change.note
    change = build_head("c", campaign_tables()).screen.change
    assert change is not None
    assert "not known" in change.note


def test_the_uncertainty_of_an_rms_is_that_of_repeated_measurement() -> None:
    """Fixed errors of three sizes plus noise, measured 4,000 times."""
    rng = np.random.default_rng(1)
    for fixed in (0.0, 1.0, 5.0):
        course = fixed * np.sin(np.arange(60.0)) / np.sqrt(np.mean(np.sin(np.arange(60.0)) ** 2))
        rms = np.sqrt(np.mean((course + rng.standard_normal((4000, 60))) ** 2, axis=1))
        assert sigma_of_rms(float(np.hypot(fixed, 1.0)), 1.0, 60.0) == pytest.approx(rms.std(), rel=0.05)


def test_links_lead_to_sections_of_the_page() -> None:
    read = Reader(render(campaign_tables()))
    hrefs = [a["href"] for tag, a in read.elements if tag == "a"]
    for name in ("diagnosis", "next", "stop"):
        assert f"#{name}" in hrefs


def placed(body: str) -> dict[str, pd.DataFrame]:
    """Three targets of the base and two of a body 100 mm above it, with three legs."""
    places = [("base", "B1", 0, 0, 0), ("base", "B2", 50, 0, 0), ("base", "B3", 0, 50, 0)]
    places += [(body, "P1", 10, 0, 0), (body, "P2", 0, 10, 0)]
    motion = {"pose": 1, "body": body, "parent": "base", "px_mm": 0.0, "py_mm": 0.0, "pz_mm": 100.0}
    turn = {f"r{i}{j}": float(i == j) for i in range(3) for j in range(3)}
    at_instrument = motion | turn | {"body": "base", "parent": "measurement"}
    frames = [
        (name, axis, 0, 0, height, *np.eye(3)[k])
        for name, height in (("base", 0), (body, 100))
        for k, axis in enumerate("xyz")
    ]
    for k, (x, y) in enumerate(((50, 0), (-25, 43), (-25, -43)), 1):
        frames += [(f"joints of leg {k}", end, x, y, z, 0, 0, 1) for end, z in (("u", 0), ("b", 100))]
    columns = ["frame", "axis_name", "x_mm", "y_mm", "z_mm", "along_x", "along_y", "along_z"]
    return {
        "shape": pd.DataFrame(places, columns=["body", "target", "x_mm", "y_mm", "z_mm"]),
        "motions": pd.DataFrame([at_instrument, motion | turn]),
        "frames": pd.DataFrame(frames, columns=columns),
    }


def test_the_drawing_has_a_dot_per_target_a_line_per_leg_and_an_axis_letter_per_frame() -> None:
    svg = machine_drawing(placed("platform"))
    assert svg.count('<circle class="fixed"') == 3
    assert svg.count('<circle class="target"') == 2
    assert svg.count('<polyline class="leg"') == 3
    assert svg.count('<line class="axis"') == 6
    assert "z base" in svg
    assert "z platform" in svg


def test_the_drawing_is_upright_and_inside_its_box() -> None:
    svg = machine_drawing(placed("platform"))
    dots = [
        (kind, float(x), float(y)) for kind, x, y in re.findall(r'class="(\w+)" cx="([\d.-]+)" cy="([\d.-]+)"', svg)
    ]
    assert all(0 < x < 300 and 0 < y < 240 for _, x, y in dots)
    assert max(y for kind, _, y in dots if kind == "target") < min(y for kind, _, y in dots if kind == "fixed")


def failed(check: str, subject: str, *slip: str) -> dict[str, pd.DataFrame]:
    """A failed check on a subject, and the slip that explains it."""
    slips = json.dumps([{"subjects": list(slip)}])
    relation = {"relation": [check], "state": ["fails"], "slips": [slips]}
    return {
        "qa": pd.DataFrame({"check": [check], "subject": [subject], "verdict": ["fail"]}),
        "belonging": pd.DataFrame(relation),
    }


def test_the_drawing_marks_what_failed_checks_name() -> None:
    tables = placed("platform")
    assert "failing" not in machine_drawing(tables)
    whole = machine_drawing({**tables, **failed("points-against-survey", "platform")})
    assert whole.count('<circle class="target failing"') == 2
    one = machine_drawing({**tables, **failed("exchanged-labels", "targets B1 P2")})
    assert one.count('<circle class="fixed failing"') == one.count('<circle class="target failing"') == 1
    assert one.count('<circle class="fixed"') == 2
    legs = machine_drawing({**tables, **failed("readings-against-poses", "", "rho1_mm", "rho3_mm")})
    assert legs.count('<polyline class="leg failing"') == 2
    assert legs.count('<polyline class="leg"') == 1
    accepted = failed("points-against-survey", "platform")
    accepted["qa"]["accepted"] = "B. Maier"
    assert "failing" not in machine_drawing({**tables, **accepted})


def test_without_poses_bodies_are_as_designed_or_side_by_side() -> None:
    tables = {name: table for name, table in placed("platform").items() if name != "motions"}
    assert machine_drawing(tables) == machine_drawing(placed("platform"))
    alone = machine_drawing({"shape": tables["shape"]})
    dots = re.findall(r'class="(fixed|target)" cx="([\d.-]+)"', alone)
    assert max(float(x) for kind, x in dots if kind == "fixed") < min(float(x) for kind, x in dots if kind == "target")


def test_numbers_and_letters_in_the_drawing_do_not_cover_each_other() -> None:
    """Six feet in three pairs, as near as those of a hexapod, and axes between them."""
    tables = placed("platform")
    angles = np.radians([0, 8, 120, 128, 240, 248])
    rows = [
        (f"joints of leg {k}", end, 50 * np.cos(a), 50 * np.sin(a), z, 0, 0, 1)
        for k, a in enumerate(angles, 1)
        for end, z in (("u", 0), ("b", 100))
    ]
    frames = tables["frames"]
    own = frames[~frames["frame"].str.startswith("joints")]
    tables["frames"] = pd.concat([own, pd.DataFrame(rows, columns=frames.columns)])
    svg = machine_drawing(tables)
    texts = re.findall(r'<text x="([\d.-]+)" y="([\d.-]+)">([^<]+)<', svg)
    assert len(texts) == 6 + 6
    for k, (x, y, words) in enumerate(texts):
        for u, v, others in texts[:k]:
            wide = 2.6 * (len(words) + len(others)) * 0.9
            assert abs(float(x) - float(u)) > wide or abs(float(y) - float(v)) > 8.0, (words, others)


def test_a_letter_is_next_to_lines_where_there_is_space() -> None:
    """A line leads to the right of the point, on the side away from its middle: the letter goes elsewhere."""
    drawn = np.stack([np.linspace(100.0, 200.0, 200), np.full(200, 100.0)], axis=1)
    text = ("z base", np.array([100.0, 100.0]), np.array([50.0, 100.0]))
    ((_, x, y),) = _placed_labels([text], np.empty((0, 2)))
    ((_, u, v),) = _placed_labels([text], drawn)
    assert (x > 100.0, abs(y - 100.0) < 5.0) == (True, True)
    box = np.array([[u - 15.0, v - 9.0], [u + 15.0, v + 1.0]])
    assert not ((drawn > box[0]) & (drawn < box[1])).all(axis=1).any()


def test_names_in_the_drawing_are_text() -> None:
    tables = placed(ATTACKS[0])
    svg = machine_drawing({name: tables[name] for name in ("shape", "motions")})
    assert "<img" not in svg
    assert "&lt;img" in svg


def test_a_page_without_geometry_has_no_drawing() -> None:
    assert machine_drawing({}) == ""


def test_essential_sections_show_no_table_and_few_figures() -> None:
    sections = sections_of(campaign_tables())
    assert sections["qa"].depth == Depth.ESSENTIAL
    assert sections["deformation"].depth == Depth.APPENDIX
    shown = sum(min(s.front, len(s.figures)) for s in sections.values() if s.depth == Depth.ESSENTIAL)
    assert shown <= 2


def test_an_axis_names_the_encoders_that_recorded_it_and_no_others() -> None:
    tables = {
        "axis_errors": pd.DataFrame({"encoder": ["load", "motor"], "pose": [1, 1], "command_unit": ["deg", "deg"]}),
        "configurations": pd.DataFrame({"pose": [1, 2], "role": ["calibration"] * 2, "time_s": [0.0, 60.0]}),
    }
    facts = dict(first_screen(tables, ABOUT).facts)
    assert facts["instrument"] == "camera no. 4; encoder at the motor, encoder at the load"
    assert facts["data"] == "2 rows (2 calibration)"


def test_cameras_are_counted_and_not_their_parameters() -> None:
    tables = {
        "image_orientations": pd.DataFrame({"pose": [1, 1, 1], "image": ["a", "b", "c"]}),
        "cameras": pd.DataFrame({"camera": ["front"] * 10, "parameter": [f"p{number}" for number in range(10)]}),
    }
    facts = dict(first_screen(tables, ABOUT).facts)
    assert facts["instrument"] == "camera no. 4; 3 photographs by 1 camera, bundle adjustment"


def test_numbers_of_equal_name_are_distinguished_by_their_subject() -> None:
    section = alike(campaign_tables())
    assert section is not None
    keys = [(row[1], row[2], row[3].split()[-1]) for row in section.listings[0].rows]
    assert len(set(keys)) == len(keys)


def test_every_position_error_of_the_diagnosis_is_among_the_similar_quantities() -> None:
    tables = campaign_tables() | calibration_tables()
    errors = compared_calibrations(tables)
    section = alike(tables)
    assert errors is not None
    assert section is not None
    held_out = errors[errors["role"] == "verification"]
    expected = [
        quantity(root_mean_square(own["position_error_um"]), "um") for _, own in held_out.groupby("called", sort=False)
    ]
    assert expected
    assert [row[3] for row in section.listings[0].rows if "rms distance" in row[1]] == expected


def test_rigid_fits_of_bodies_are_among_the_similar_quantities() -> None:
    sizes = {"none": 9.68, "linear": 6.99}
    rows = [("rms_error", None, model, size, "um", "receiver") for model, size in sizes.items()]
    errors = pd.DataFrame(rows, columns=["figure", "leg", "model", "value", "unit", "subject"])
    section = alike({"deformation_errors": errors})
    assert section is not None
    assert [(row[1].split(", ")[0], row[3]) for row in section.listings[0].rows] == [
        ("residuals of rigid fits of receiver", "9.68 µm"),
        ("residuals of rigid fits of receiver", "6.99 µm"),
    ]


def test_the_error_of_the_nominal_geometry_is_among_the_similar_quantities() -> None:
    prediction = pd.DataFrame(
        {"role": ["calibration", "verification"], "rms_nominal": [40.0, 502.0], "rms_after": [2.0, 3.0], "unit": "um"}
    )
    none = pd.DataFrame({"figure": "rms_error", "leg": [None], "model": "none", "value": [7.0], "unit": "um"})
    section = alike({"prediction": prediction, "deformation_errors": none.assign(subject=None)})
    assert section is not None
    (row,) = (row for row in section.listings[0].rows if "nominal" in row[1])
    assert row[2:] == ("held-out poses", "502 µm")


def test_all_noise_floors_in_figures_are_that_of_the_first_screen() -> None:
    tables = campaign_tables() | calibration_tables()
    tables["accuracy"]["position_noise_um"] = 12.0
    change = first_screen(tables, ABOUT).change
    page = render(tables).replace("\u00a0", " ")
    assert change is not None
    assert "by noise alone, 12 µm" in page
    assert set(re.findall(r"Dotted: noise floor(?: \(rms\))?, ([\d.]+ [µ\w]+)", page)) == {change.floor}


def test_figures_of_a_positioned_axis_have_their_uncertainty() -> None:
    figures = {"figure": ["A", "B"], "subject": [None, None], "value": [21.97, 4.49], "unit": ["um", "um"]}
    positioning = pd.DataFrame({"run": ["x", "x"], **figures, "sigma": [2.9, 1.3]})
    tiles = dict(_positioning_tiles({"positioning": positioning}))
    assert tiles == {"accuracy A, x": "22.0 ± 2.9 µm", "reversal B, x": "4.5 ± 1.3 µm"}


@pytest.mark.parametrize("unit", ["deg", "µm", "px", "mV", "K", "arcsec"])
def test_no_line_ends_between_a_number_and_its_unit(unit: str) -> None:
    assert " " not in _with_fixed_spaces(f"0.12 ± 0.03 {unit}")


def test_measuring_stops_only_when_nothing_is_open() -> None:
    tables = campaign_tables()
    section = stop(tables)
    assert section is not None
    assert bool(section.statements) == section.lead.startswith("Not yet")
    untested = sum(step.need == Need.TESTABLE for step in next_steps(assessed_causes(tables), tables))
    assert ("could not be tested" in section.lead) == (untested > 0)


def test_a_bench_is_not_asked_for_a_requirement_that_does_not_apply_to_it() -> None:
    tables = bench_tables()
    section = stop(tables)
    assert section is not None
    assert not section.statements
    assert verdict_rows(with_verdict(tables))["requirements"].explanation in section.lead


def test_settings_software_files_and_persons_are_in_the_provenance() -> None:
    declared, software, persons = (("noise.point_mm", "0.005"),), (("numpy", "2.4"),), (("A. Berg", "operator"),)
    day = "2026-11-21 09:30"
    files = (RawFileFacts("points.csv", 12345, 1201, "ab" * 32, day), RawFileFacts("a.jpg", 7, None, "cd" * 32))
    costs = (StageCost("pose", 0.456, 200_400_000, 2), StageCost("diagnose", 10.0))
    about = replace(ABOUT, declared=declared, software=software, persons=persons, files=files, costs=costs)
    section = {one.id: one for one in build_sections(campaign_tables(), {}, about)}["provenance"]
    shown = [listing.rows for listing in section.listings]
    rows = (("points.csv", "12,345", day, "1,201", "ab" * 32), ("a.jpg", "7", "", "", "cd" * 32))
    took = (("pose", "0.46", "200", "2"), ("diagnose", "10.00", "–", "1"))
    assert shown == [declared, software, took, rows, persons]


def test_comments_are_in_their_section_and_are_escaped() -> None:
    sections = list(sections_of(campaign_tables(poses=3)).values())
    given = (("qa", f"Seen by B. {ATTACKS[0]}"), ("next", "Ordered."))
    reported = with_comments(sections, given)
    page = Reader(render_page(build_head("c", campaign_tables(poses=3)), reported))
    assert "Ordered." in page.text
    assert ATTACKS[0] in page.text
    assert sum(tag == "aside" for tag, _ in page.elements) == 2


def test_a_comment_on_a_section_that_the_run_lacks_is_not_lost() -> None:
    sections = [one for one in sections_of(campaign_tables(poses=3)).values() if one.id != "chain"]
    reported = with_comments(sections, [("chain", "No arm here.")])
    assert [text for section in reported for text in section.comments] == ["chain: No arm here."]


def test_a_comment_on_a_folded_section_or_its_part_is_outside_the_fold() -> None:
    """Paper shows no folded section, and a reader does not open each one to look for a person's words."""
    part = ReportSection("inner", "Inner part", "Lead.", depth=Depth.APPENDIX)
    folded = ReportSection("outer", "Outer", "Lead.", parts=(part,), depth=Depth.APPENDIX)
    sections = [folded, ReportSection("open", "Open", "Lead.", parts=(replace(part, id="other"),))]
    given = (("outer", "Crane at work."), ("inner", "By laboratory 3."), ("open", "Seen."), ("other", "Agreed."))
    page = render_page(build_head("c", campaign_tables(poses=3)), with_comments(sections, given))
    for _, text in given:
        before = page[: page.index(text)]
        assert before.count("<details") == before.count("</details>")
    assert page.count("<aside") == len(given)
    assert "<b>Inner part</b>" in page


def test_a_comment_on_the_verdict_is_on_the_first_screen() -> None:
    tables = campaign_tables(poses=3)
    about = replace(ABOUT, comments=(("verdict", "Accepted <by> M. K."),))
    head = replace(build_head("c", tables, about), about=about)
    page = render_page(head, with_comments(list(sections_of(tables).values()), about.comments))
    assert page.count("<aside") == 1
    assert "Accepted &lt;by&gt; M. K." in page[: page.index("</header>")]
    assert "verdict" in section_names()


def test_every_section_of_a_page_can_have_a_comment() -> None:
    for tables in (campaign_tables(), bench_tables()):
        assert {section.id for section in all_of(list(sections_of(tables).values()))} <= set(section_names())


def test_title_laboratory_and_logo_are_at_the_top() -> None:
    tables = campaign_tables(poses=3)
    head = replace(build_head("c", tables, ABOUT), about=replace(ABOUT, logo="data:image/png;base64,AAAA"))
    page = Reader(render_page(head, []))
    assert "Wing 7, second campaign" in page.text
    assert "Laboratory of Lengths" in page.text
    assert [a["src"] for tag, a in page.elements if tag == "img"] == ["data:image/png;base64,AAAA"]


def test_a_page_of_positions_alone_says_axis_counts_and_no_number_twice() -> None:
    positions = pd.DataFrame(
        {"run": ["x"] * 4, "target_mm": [0.0, 10.0, 0.0, 10.0], "position_mm": [0.0, 10.0, 0.1, 10.1]}
    )
    figures = {"figure": ["A", "B"], "subject": [None, None], "value": [11.47, 5.15], "unit": ["um", "um"]}
    tables = {
        "positions": positions,
        "positioning": pd.DataFrame({"run": ["x", "x"], **figures, "sigma": [0.7, 0.35]}),
        "diagnosis": pd.DataFrame({"cause": []}),
    }
    screen = first_screen(tables, replace(ABOUT, machine="", instrument=""))
    facts = dict(screen.facts)
    assert (facts["machine"], facts["instrument"]) == ("axis x", "positions of an axis")
    assert facts["data"] == "4 positions at 2 targets"
    assert [section for section, _ in screen.links] == ["positioning", "diagnosis", "uncertainty"]


def test_the_duration_is_that_of_one_clock() -> None:
    """Times that begin from zero again in each run or file do not give the duration of the whole."""
    tables = bench_tables(signals=0)
    readings = tables["readings"]
    whole = campaign_span(tables)
    assert whole.startswith("over ")
    anew = readings.assign(time_s=readings["time_s"] - readings.groupby("run")["time_s"].transform("min"))
    assert campaign_span({**tables, "readings": anew.assign(time_s=0.1 * anew["time_s"])}) == ""
    poses = pd.DataFrame({"time_s": [0.0, 0.5, 1.5, 0.0, 0.5, 1.5]})
    assert campaign_span({"configurations": poses}) == ""
    assert campaign_span({"configurations": poses.assign(time_s=poses["time_s"].cumsum())}) != ""
    in_another_order = poses.assign(time_s=[0.0, 7.5, 1.5, 9.0, 3.5, 5.5])
    assert campaign_span({"configurations": in_another_order}) != ""
