"""The report stage makes its page from any tables of a run."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.stages.line import run_line
from tests.tolerance import assert_between
from truing.runs.page_parts import target_positions_of
from truing.schemas.campaign import read_campaign

LAYOUT = Layout(name="a campaign & ours", targets=Targets(per_leg=0))


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    rng = np.random.default_rng(3)
    effect = MatrixDeformation(0.01 * rng.standard_normal((6, 6)))
    campaign = draw_campaign(LAYOUT, random_moves(14, 2, rng), [effect], rng)
    folder = write_campaign(campaign, tmp_path_factory.mktemp("report") / "campaign", 3)
    return run_line(folder, "ingest", "qa", "pose", "deformation", "report")


def test_the_report_is_one_html_document_with_all_sections(line):
    tables, said = line
    page = tables["report"]
    assert page.startswith("<!doctype html>")
    assert "a campaign &amp; ours" in page
    assert "13 sections, 7 figures" in said["report"].figure


def test_without_a_survey_the_shape_is_what_was_measured(line):
    frames = {name: line[0][name].to_pandas() for name in ("observations", "poses", "residuals", "survey")}
    surveyed = frames.pop("survey")
    found = target_positions_of(frames).merge(surveyed, on=["body", "target"], suffixes=("", "_true"))
    assert len(found) == len(surveyed)
    off = found[["x_mm", "y_mm", "z_mm"]].to_numpy() - found[["x_mm_true", "y_mm_true", "z_mm_true"]].to_numpy()
    # Points agree with the survey by construction: measured less residual, so only rounding in the tables is left.
    assert_between(float(np.abs(off).max()), 0.0, 1e-6, what="distance from the survey in mm")


def test_without_tables_there_is_a_page_all_the_same():
    from truing.stages.report import run

    settings = read_campaign({"campaign": {"name": "nothing", "kind": "photogrammetry"}})
    outcome = run({}, settings, lambda *_: None)
    assert "not evaluated" in outcome.artifacts["report"]
