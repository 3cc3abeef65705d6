"""`truing power` of a campaign with photographs: limits of its simulation, and results from its run."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from truing.pipeline.artifacts import Stamp, write_table
from truing.pipeline.campaign_folder import CampaignFolder
from truing.pipeline.power_command import of_photographs
from truing.report.column_heads import meaning_of
from truing.report.power_page import section_of_photographs
from truing.schemas.artifacts import ARTIFACTS

DETECTABLE = ARTIFACTS["detectable"]


@pytest.fixture
def photographed(tmp_path: Path) -> CampaignFolder:
    (tmp_path / "image_points.csv").write_text("pose,image,camera,body,target,x_px,y_px\n")
    document = {"campaign": {"name": "lab", "kind": "photogrammetry"}}
    return CampaignFolder(tmp_path / "campaign.toml", document)


def left_by_a_run(folder: Path) -> Path:
    row = {"subject": "", "parameter": "gain", "size": 0.1, "unit": "1", "power": 0.8}
    jump = {"subject": "camera left", "parameter": "c", "size": 0.35, "unit": "px", "power": 0.8}
    rows = [
        {**row, "cause": "actuator-gain"},
        {**jump, "cause": "camera-instability"},
        {**row, "cause": "refraction", "parameter": "gradient", "size": None, "unit": "ppm/m"},
    ]
    table = pa.Table.from_pylist(rows, schema=DETECTABLE.arrow_schema())
    folder.mkdir()
    write_table(folder / DETECTABLE.file, DETECTABLE, table, Stamp("diagnose", "", "lab", "0", ()))
    return folder


def test_without_a_run_it_says_which_causes_are_not_assessed(photographed: CampaignFolder, tmp_path: Path) -> None:
    reported = of_photographs(photographed, tmp_path / "none")
    assert reported is not None
    assert not reported.rows
    for words in ("photographs are not simulated", "Camera instability", "refraction are not tested here"):
        assert words in reported.sentence


def test_power_of_photographs_lists_the_detectable_sizes(photographed: CampaignFolder, tmp_path: Path) -> None:
    reported = of_photographs(photographed, left_by_a_run(tmp_path / "run"))
    assert reported is not None
    assert reported.rows == (
        ("camera instability", "camera left", "c 0.35 px"),
        ("refraction", "the whole", "gradient not at any plausible size"),
    )
    (listing,) = section_of_photographs(reported.sentence, reported.rows).listings
    assert listing.rows == reported.rows
    assert all(map(meaning_of, listing.heads))


def test_a_campaign_without_rays_has_no_power_of_photographs(photographed: CampaignFolder, tmp_path: Path) -> None:
    (photographed.folder / "image_points.csv").unlink()
    assert of_photographs(photographed, tmp_path / "none") is None
