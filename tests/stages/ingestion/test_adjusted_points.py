"""Assignment of network points to bodies: by name, by the survey, or to none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.sentences import assert_says
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import call_stage
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults
from truing.stages.ingestion.adjusted_points import OF_NO_BODY, ONE_BODY, AdjustedPoints

SURVEY: dict[str, dict[str, object]] = {"base": {"ring12-1": 0, "both": 0}, "platform": {"P1": 0, "both": 0}}


def rows_of(*points: tuple[str, str, str]) -> pa.Table:
    """The artifact with points of (name, body, target)."""
    schema = ARTIFACTS["object_points"].arrow_schema()
    blank: dict[str, Any] = {field.name: 0.0 for field in schema} | {"pose": 1, "rays": 3}
    blank |= dict.fromkeys(("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"), 0.01)
    rows = [{**blank, "point": point, "body": body, "target": target} for point, body, target in points]
    return pa.Table.from_pylist(rows, schema=schema)


def taken(table: pa.Table, survey: Any, log: FaultLog, *ends: str) -> tuple[list[tuple[str, str]], dict[str, int]]:
    ((_, batch),) = AdjustedPoints(table, frozenset(ends), Path()).batches(survey, (), log)
    names = (batch.columns[name].cast(pa.string()).to_pylist() for name in ("body", "target"))
    return list(zip(*names, strict=True)), dict(batch.left_out)


def test_a_code_without_a_body_is_on_the_one_whose_survey_knows_it() -> None:
    table = rows_of(("ring12-1", "", "ring12-1"), ("platform/P1", "platform", "P1"), ("ring12-9", "", "ring12-9"))
    found, left = taken(table, SURVEY, FaultLog())
    assert found == [("base", "ring12-1"), ("platform", "P1")]
    assert left == {OF_NO_BODY: 1}


def test_circles_without_a_name_wait_for_the_survey() -> None:
    assert taken(rows_of(("circle-1", "", "")), SURVEY, FaultLog())[0] == [("", "")]


def test_ends_of_bars_are_left_out_unless_they_are_surveyed_targets() -> None:
    table = rows_of(("bars/S1", "bars", "S1"), ("base/ring12-1", "base", "ring12-1"))
    found, left = taken(table, SURVEY, FaultLog(), "bars/S1", "base/ring12-1")
    assert found == [("base", "ring12-1")]
    assert left == {OF_NO_BODY: 1}


def test_without_a_survey_all_codes_are_on_one_body() -> None:
    assert taken(rows_of(("ring12-1", "", "ring12-1")), {}, FaultLog())[0] == [(ONE_BODY, "ring12-1")]


def test_without_a_survey_a_board_is_a_body() -> None:
    table = rows_of(("floor-17", "", "floor-17"), ("door-3", "", "door-3"), ("a/floor-1", "a", "floor-1"))
    ((_, batch),) = AdjustedPoints(table, frozenset(), Path(), ("floor",)).batches({}, (), FaultLog())
    assert batch.columns["body"].cast(pa.string()).to_pylist() == ["floor", ONE_BODY, "a"]


@pytest.mark.parametrize("named", [True, False])
def test_circles_that_nothing_names_are_left_out_next_to_named_points_and_a_fault_alone(
    named: bool, tmp_path: Path
) -> None:
    (tmp_path / "campaign.toml").write_text('[campaign]\nname = "x"\nkind = "photogrammetry"\n', encoding="utf-8")
    (tmp_path / "image_points.csv").write_text("pose,image,x_px,y_px\n1,a,1,1\n", encoding="utf-8")
    campaign = open_campaign(tmp_path)
    settings = campaign.validated()
    codes = [("ring12-1", "", "ring12-1"), ("ring12-2", "", "ring12-2")] if named else []
    tables = {"object_points": rows_of(*codes, ("circle-1", "", ""), ("circle-2", "", ""))}
    files = CampaignFiles(campaign.folder, settings)
    if not named:
        with pytest.raises(CampaignFaults, match="named by the survey's geometry"):
            call_stage("ingest", tables, settings, files)
        return
    outcome = call_stage("ingest", tables, settings, files)
    assert_says(str(outcome.left_out), "2 rows", "circles", "no survey")


def test_a_name_on_two_bodies_is_a_fault_that_names_it() -> None:
    log = FaultLog()
    found, _ = taken(rows_of(("both", "", "both")), SURVEY, log)
    (fault,) = log.faults()
    assert found == []
    assert (fault.value, fault.column) == ("both", "target")


@pytest.mark.parametrize("named", [True, False])
def test_circles_of_screws_and_holes_are_left_out_next_to_targets_with_codes_and_a_fault_alone(
    named: bool, tmp_path: Path
) -> None:
    reported = '[campaign]\nname = "x"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.01\n'
    (tmp_path / "campaign.toml").write_text(reported, encoding="utf-8")
    (tmp_path / "image_points.csv").write_text("pose,image,x_px,y_px\n1,a,1,1\n", encoding="utf-8")
    places = np.random.default_rng(1).uniform(-300, 300, (14, 3)).round(3)
    survey = [f"base,B{k},{x},{y},{z}" for k, (x, y, z) in enumerate(places[:7])]
    (tmp_path / "targets.csv").write_text("\n".join(["body,target,x_mm,y_mm,z_mm", *survey]), encoding="utf-8")
    codes = [(f"base/B{k}", "base", f"B{k}") for k in range(7)] if named else []
    table = rows_of(*codes, *((f"circle-{k}", "", "") for k in range(7)))
    for axis, name in enumerate(("x_mm", "y_mm", "z_mm")):
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), pa.array(places[-table.num_rows :, axis]))
    campaign = open_campaign(tmp_path)
    settings = campaign.validated()
    files = CampaignFiles(campaign.folder, settings)
    if not named:
        with pytest.raises(CampaignFaults, match="named as targets of body base"):
            call_stage("ingest", {"object_points": table}, settings, files)
        return
    outcome = call_stage("ingest", {"object_points": table}, settings, files)
    assert_says(str(outcome.left_out), "7 rows", "without a name", "no target")
