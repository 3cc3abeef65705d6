"""The page is self-contained, deterministic, safe against injected names, and names missing parts."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from tests.report.campaign_tables import campaign_tables
from tests.sentences import assert_says
from truing.report.page import MOST_ROWS, Depth, all_of
from truing.report.page_head import build_head
from truing.report.rendering.render import embedded, file_name, render_page
from truing.report.scene.scenes import pose_scene
from truing.report.sections import build_sections

ATTACKS = (
    "</script><img src=x onerror=alert(1)>",
    "{{ 7 * 7 }}{% raw %}",
    '"><svg onload=alert(1)>',
    "%{y}<a href='javascript:alert(1)'>",
)
PLOTLY = get_plotlyjs()
_VOID = {"meta", "img", "br", "link", "input", "hr"}


class Reader(HTMLParser):
    """Elements with their attributes, the text outside scripts and styles, and the scripts."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.feed(page.replace(PLOTLY, ""))
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data):
        if self.open and self.open[-1] in ("script", "style"):
            self.scripts.append(data)
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def render(tables, name="campaign"):
    provenance = {key: {"stage": "pose", "digest": "0123456789abcdef01", "software_version": "1"} for key in tables}
    return render_page(build_head(name, tables), build_sections(tables, provenance))


def sections_of(tables):
    return {section.id: section for section in build_sections(tables, {})}


@pytest.fixture(scope="module")
def page():
    return render(campaign_tables())


@pytest.fixture(scope="module")
def whole():
    """The sections of all tables."""
    return sections_of(campaign_tables())


@pytest.fixture(scope="module")
def clean():
    """A page of few poses with harmless names."""
    return Reader(render(campaign_tables(poses=4)))


def test_same_tables_give_the_same_bytes(page):
    assert render(campaign_tables()) == page


def test_the_page_is_well_formed_and_loads_nothing(page):
    read = Reader(page)
    assert not read.open
    for tag, attributes in read.elements:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base", "form")
        for name in ("src", "srcset", "data", "action"):
            assert name not in attributes, f"<{tag} {name}>"
        assert (attributes.get("href") or "#").startswith("#")
        assert not [name for name in attributes if name.startswith("on")]
    styles = "".join(re.findall(r"<style>.*?</style>", page[: page.index("<script>")], re.S))
    assert "@import" not in styles
    assert "url(" not in styles


def test_no_figure_offers_to_upload_itself(page):
    page = page.replace(PLOTLY, "")
    assert page.count("library()[how](plot, data, layout, config)") == page.count("showSendToCloud: false") == 1
    assert not re.findall(r"(newPlot|react)\(", page)  # no figure is made elsewhere
    assert page.count('class="figure-data"') == 8


def test_only_the_scripts_of_the_page_may_run(page):
    said = next(
        a["content"]
        for tag, a in Reader(page).elements
        if tag == "meta" and "content" in a and "script-src" in a["content"]
    )
    texts = re.findall(
        r"<script(?: type=\"text/plain\" id=\"plotly\")?>(.*?)</script>", page.replace(PLOTLY, "PLOTLY"), re.S
    )
    assert len(texts) == 7
    for text in texts:
        digest = hashlib.sha256(text.replace("PLOTLY", PLOTLY, 1 if text == "PLOTLY" else 0).encode()).digest()
        assert f"'sha256-{base64.b64encode(digest).decode()}'" in said
    assert "default-src 'none'" in said
    assert "'unsafe-inline'" not in said.split("script-src")[1].split(";")[0]


def test_embedded_data_cannot_end_the_script_element_nor_begin_a_comment():
    hostile = "</script><!-- <script> & \u2028\u2029 \" '"
    text = embedded({"name": [hostile]})
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == {"name": [hostile]}


@pytest.mark.parametrize(
    ("campaign", "file"),
    [
        ("telescope", "telescope-gain-0.csv"),
        ("../../etc/x:y*?", "etc-x-y-gain-0.csv"),
        ("…", "campaign-gain-0.csv"),
        ("Prüfstand 7", "Prüfstand-7-gain-0.csv"),
        (".x\u202egpj", "x-gpj-gain-0.csv"),
    ],
)
def test_a_campaign_gives_its_files_a_harmless_name(campaign, file):
    assert file_name(campaign, "gain-0") == file


def test_figures_tables_and_headings_have_labels_for_screen_readers(page):
    elements = Reader(page).elements
    pictures = [a for tag, a in elements if a.get("role") == "img"]
    assert len(pictures) == 9  # eight figures and the machine
    assert all(len(a["aria-label"] or "") > 40 for a in pictures)
    levels = [int(tag[1]) for tag, _ in elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert max(np.diff(levels)) <= 1
    ids = {a["id"] for _, a in elements if "id" in a}
    assert all((a["href"] or "")[1:] in ids for tag, a in elements if tag == "a")
    assert next(a for tag, a in elements if tag == "a")["class"] == "skip"
    assert all(a.get("aria-label") for tag, a in elements if tag in ("button", "table", "nav"))


def test_every_figure_and_every_table_has_its_file(page):
    elements = Reader(page).elements
    files = [a["data-file"] for tag, a in elements if tag == "button" and a["class"] == "csv"]
    assert len(files) == len(set(files))
    # each but the drawing of the machine
    assert len(files) + 1 == sum(tag in ("figure", "table") for tag, _ in elements)


def test_verdicts_are_reported_in_words_not_by_colour_alone():
    tables = campaign_tables()
    reported = dict(re.findall(r'<li class="(\w+)">(.*?)</li>', render(tables), re.S))
    assert {"found", "fail", "next"} <= set(reported)
    for mark, sign, word in (("found", "◆", "found"), ("fail", "✗", "fails")):
        assert f'<b class="mark"><span aria-hidden="true">{sign}</span> {word}</b>' in reported[mark]
    tables["qa"] = tables["qa"].iloc[:0]
    idle = [text for mark, text in build_head("c", tables).verdicts if mark == "none"]
    assert [text.partition(" not evaluated: ")[0] for text in idle] == ["Quality", "Requirements"]
    assert '<span aria-hidden="true">–</span> not tested</b>' in render(tables)


def test_every_section_that_assesses_has_a_state_and_no_cell_is_blank(page, whole):
    judged = {section.id: section.state for section in whole.values()}
    assert judged["qa"] == "fail"
    assert judged["diagnosis"] == judged["deformation"] == "found"  # a result is neither passed nor failed
    assert judged["poses"] == "pass"
    assert judged["calibration"] == "not evaluated"
    assert judged["requirements"] == "not tested"
    assert not [body for body in re.findall(r"<tbody>.*?</tbody>", page, re.S) if "<td></td>" in body]
    marks = (("pass", "✓", "ok"), ("fail", "✗", "fails"), ("found", "◆", "found"), ("not tested", "–", "not tested"))
    for state, sign, word in marks:
        assert f'<span class="state {state}"><span aria-hidden="true">{sign}</span> {word}</span>' in page


def test_every_section_has_its_figure(whole):
    found = whole
    for name, least in {"measured": 1, "diagnosis": 2, "poses": 2, "deformation": 3}.items():
        assert sum(len(part.figures) for part in all_of([found[name]])) >= least, name
    essential = ["diagnosis", "stop", "qa", "calibration", "requirements"]
    behind = [
        "measured",
        "poses",
        "deformation",
        "alike",
        "uncertainty",
        "during",
        "excluded",
        "provenance",
        "glossary",
    ]
    assert list(found) == [*essential, *behind]
    assert [name for name, section in found.items() if section.depth == Depth.ESSENTIAL] == essential


def test_every_figure_says_what_it_shows_and_has_units(whole):
    for section in all_of(list(whole.values())):
        for figure, caption in section.figures:
            title = figure.layout.title
            assert len(title.text) > 10
            assert len(title.subtitle.text) > 20
            assert caption.endswith(".")


@pytest.mark.parametrize("attack", ATTACKS)
def test_names_cannot_inject_anything(attack, clean):
    tables = campaign_tables(poses=4, name=attack)
    for table in tables.values():
        if "body" in table:
            table["body"] = table["body"].replace("base", attack)
    tables["qa"]["message"] = attack
    tables["qa"]["subject"] = tables["qa"]["subject"].replace("base", attack)
    tables["diagnosis"]["explanation"] = attack
    tables["residuals"].loc[0, "reason"] = attack
    tainted = Reader(render(tables, attack))
    assert [tag for tag, _ in tainted.elements] == [tag for tag, _ in clean.elements]
    assert attack in tainted.text
    for script in tainted.scripts[1:]:  # the first is the style
        assert "<img" not in script
        assert "<svg" not in script
        assert "</" not in script


def test_markup_in_names_stays_text_in_figures():
    tables = campaign_tables(poses=4, name="<b>P</b>")
    for section in all_of(list(sections_of(tables).values())):
        for figure, _ in section.figures:
            assert "<b>" not in json.dumps(figure.to_plotly_json(), default=str)


@pytest.mark.parametrize("name", ["observations", "qa", "poses", "diagnosis", "deformation_errors"])
def test_empty_tables_are_not_evaluated_and_say_why(name, whole):
    tables = campaign_tables()
    before = _idle(whole)
    assert set(before) == {"calibration", "requirements", "uncertainty"}  # of which these tables hold nothing
    for lead in before.values():
        assert_says(lead, "no table", "stage")
    tables[name] = tables[name].iloc[:0]
    sections = sections_of(tables)
    states = _idle(sections)
    assert len(states) == len(before) + 1
    assert all(len(lead) > 20 for lead in states.values())
    Reader(render_page(build_head("campaign", tables), list(sections.values())))


def _idle(sections):
    """The sections that are not evaluated, with what they say."""
    return {s.id: s.lead for s in sections.values() if s.state in ("not evaluated", "not tested", "empty")}


def test_a_run_without_diagnosis_never_claims_agreement():
    tables = campaign_tables()
    tables["diagnosis"] = tables["diagnosis"].iloc[:0]
    idle = [text for mark, text in build_head("c", tables).verdicts if mark == "none"]
    assert any(text.startswith("Diagnosis not evaluated") for text in idle)
    assert "agrees" not in Reader(render(tables)).text


def test_nothing_found_says_agreement():
    tables = campaign_tables()
    nothing = tables["diagnosis"].iloc[1:].assign(rms_before=4.9, heldout_rms_before=5.0)
    tables["diagnosis"] = nothing.assign(relation="readings-poses")
    assert build_head("c", tables).verdicts[0][0] == "fail"  # a check of quality failed
    del tables["qa"]
    mark, text = build_head("c", tables).verdicts[0]
    assert mark == "pass"
    assert "agree " in text
    tables["diagnosis"] = nothing  # which does not say what was tested
    assert "agree" not in build_head("c", tables).verdicts[0][1]


@pytest.mark.parametrize("left", [set(), {"exclusions"}, {"observations"}, {"poses", "residuals", "observations"}])
def test_any_part_of_the_tables_makes_a_page(left):
    whole = campaign_tables()
    Reader(render({key: table for key, table in whole.items() if key in left}))
    Reader(render({key: table for key, table in whole.items() if key not in left}))


def test_the_head_is_short_and_shows_what_to_do(page):
    verdicts = build_head("c", campaign_tables()).verdicts
    assert [mark for mark, _ in verdicts[:3]] == ["fail", "found", "next"]
    assert "K11" not in verdicts[1][1]
    assert_says(verdicts[1][1], "7.8 µm", "4.6 µm")
    assert verdicts[2][1].startswith("Optional: ")
    assert all(len(sentence) < 320 for _, sentence in verdicts)


def test_decisions_of_persons_are_on_the_page(page, whole):
    text = Reader(page).text
    for words in ("A. Kern: mirror image in the window", "B. Roth: checked by hand", "A. Kern: the floor was cut"):
        assert words in text
    assert_says(text, "1 failed check", "accepted", "a person")
    failed = next(x for x in whole["qa"].listings if x.caption == "Failed")
    assert [row[1] for row in failed.rows] == ["completeness"]  # the accepted one gates no more


def test_every_exclusion_is_on_the_page(page):
    text = Reader(page).text
    for words in ("target is not like P", "0.300 mm off", "gross error: 40 sigma", "attachment: not part of the frame"):
        assert words in text


def test_dense_scans_are_measured_and_those_without_a_pose_are_named():
    whole = campaign_tables(poses=3, bodies=("platform",))
    scans = whole["poses"].assign(overlap=0.8, noise_ratio=1.1, message=None)
    scans.loc[1, ["status", "message"]] = ["not-converged", "the surface slides along itself"]
    tables = {"scans": scans, "poses": whole["poses"], "configurations": whole["configurations"]}
    text = Reader(render(tables)).text
    assert "2 of 3" in text
    assert "neither object points" not in text
    assert_says(text, "1 dense scan", "no pose")
    assert_says(text, "surface slides", "itself")


def test_gross_errors_do_not_flatten_the_shifts(whole):
    figure = whole["deformation"].figures[1][0]
    low, high = figure.layout.yaxis.range
    assert high - low < 120.0
    crosses = [trace for trace in figure.data if trace.marker.symbol == "x-thin"]
    assert len(crosses) == 1
    assert low <= crosses[0].y[0] <= high


def test_outlying_poses_turn_an_axis_logarithmic():
    tables = campaign_tables()
    assert sections_of(tables)["poses"].figures[0][0].layout.yaxis.type is None
    tables["poses"].loc[0, "rms_mm"] = 5.0
    axis = sections_of(tables)["poses"].figures[0][0].layout.yaxis
    assert axis.type == "log"
    assert "log" in axis.title.text


def test_every_step_of_the_slider_shows_one_pose_whole(whole):
    figure = whole["deformation"].figures[0][0]
    steps = figure.layout.sliders[0].steps
    assert len(steps) == 12
    assert {len(step.args[0][axis]) for step in steps for axis in "xyz"} == {len(figure.data)}
    for k, trace in enumerate(figure.data):
        assert np.array_equal(trace.x, steps[0].args[0]["x"][k], equal_nan=True)
    tables = campaign_tables()
    scene = pose_scene(tables, kept(tables), "platform")
    places = tables["survey"].query("body == 'platform'").set_index("target")[["x_mm", "y_mm", "z_mm"]]
    assert np.allclose(scene.place[3], places.loc[list(scene.names)])


def kept(tables):
    """Residuals of the platform's targets that are drawn."""
    residuals = tables["residuals"]
    gross = tables["deformation"].loc[tables["deformation"]["rejected"], ["pose", "leg"]].assign(gross=True)
    legs = residuals.merge(tables["shape"][["body", "target", "leg"]], on=["body", "target"], how="left")
    out = legs.merge(gross, on=["pose", "leg"], how="left")["gross"].notna().to_numpy() | residuals["rejected"]
    own = residuals[~out & (residuals["body"] == "platform")]
    return own.dropna(subset=["dx_mm"])


def test_the_slider_holds_where_a_pose_lacks_its_attachments():
    tables = campaign_tables()
    legs = tables["survey"].dropna(subset="leg")["target"]
    out = (tables["residuals"]["pose"] == 3) & tables["residuals"]["target"].isin(legs)
    tables["residuals"].loc[out, "rejected"] = True
    figure = sections_of(tables)["deformation"].figures[0][0]
    steps = figure.layout.sliders[0].steps
    assert all(len(step.args[0]["x"]) == len(figure.data) for step in steps)
    bare = next(step for step in steps if step.label == "3")
    assert len(bare.args[0]["x"][1]) == len(bare.args[0]["x"][4]) == 0  # no attachment, and no ring


def test_bodies_keep_their_pose_where_named_poses_are_missing():
    tables = campaign_tables(poses=6)
    for table in tables.values():
        if "pose" in table:
            table["pose"] = table["pose"].map("set_{}".format)
    tables["poses"] = tables["poses"].drop(index=tables["poses"].index[6])  # the platform's first
    base, platform = sections_of(tables)["poses"].figures[0][0].data[:2]
    places = [dict(zip(trace.text, trace.x, strict=True)) for trace in (base, platform)]
    assert len(places[1]) == 5
    assert all(places[0][name] == place for name, place in places[1].items())


def test_many_poses_of_many_bodies_stay_small():
    bodies = ("base", "platform", *(f"leg{k}" for k in range(1, 7)))
    tables = campaign_tables(poses=1000, bodies=bodies, targets=7)
    page = render(tables)
    assert len(page.encode()) < 8e6
    read = Reader(page)
    assert f"The first {MOST_ROWS:,} of 8,000 rows; all are in poses.parquet." in read.text


def test_the_heat_map_holds_the_coefficients():
    tables = campaign_tables()
    drawn = sections_of(tables)["deformation"].figures[2][0].data[0]
    matrix = tables["deformation_models"].query("model == 'matrix'")
    z = drawn.z if not isinstance(drawn.z, dict) else np.frombuffer(base64.b64decode(drawn.z["bdata"]))
    assert np.array_equal(np.asarray(z, dtype=float).ravel(), 1e3 * matrix["coefficient"].to_numpy())
    bracketed = [cell.startswith("(") for row in drawn.text for cell in row]
    assert bracketed == list(~matrix["significant"])
