"""`truing init`: a template that explains every key, a short starter file, and no file overwritten."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from tests.pipeline.init_calls import PLACED, init, rows, starter, written
from tests.sentences import assert_says
from truing.pipeline.campaign_run import PROJECT
from truing.schemas import campaign as sections
from truing.schemas import interferometer
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.mapping import FileMapping

TEMPLATE = (PROJECT / "pipeline" / "campaign_template.toml").read_text(encoding="utf-8")
SAMPLE = PROJECT / "sample_data" / "telescope"


def all_keys() -> set[str]:
    defined = [*vars(sections).values(), *vars(interferometer).values()]
    models = [value for value in defined if isinstance(value, type) and issubclass(value, BaseModel)]
    return {key for model in models if model is not FileMapping for key in model.model_fields}


@pytest.mark.parametrize("key", sorted(all_keys()))
def test_every_key_of_the_schema_is_in_the_template(key: str) -> None:
    pattern = rf"(^|[ {{,#])({key} =|\[\[?([a-z]+\.)?{key}[\].])" if key != "files" else r"\[files\.<table>\]"
    assert re.search(pattern, TEMPLATE, re.MULTILINE)


def test_every_key_of_a_mapping_is_explained(tmp_path: Path) -> None:
    init(tmp_path, "--all")
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert all(re.search(rf"^#   {key} +\S", text, re.MULTILINE) for key in FileMapping.model_fields)


def test_every_example_in_the_template_is_what_the_schema_allows() -> None:
    """A block behind # signs, uncovered, has no fault but that an example has too few legs."""
    blocks = [block for block in TEMPLATE.split("\n\n") if re.match(r"# \[\[?[a-z]", block)]
    assert len(blocks) >= 12
    for block in blocks:
        uncovered = "\n".join(line.removeprefix("# ") for line in block.splitlines())
        kind = "interferometer" if "# channel =" in block else "photogrammetry"
        document = {"campaign": {"name": "x", "kind": kind}, **tomllib.loads(uncovered)}
        assert all("legs" in fault or "6 items" in fault for fault in faults_of(document))


def faults_of(document: dict[str, Any]) -> list[str]:
    try:
        read_campaign(document)
    except CampaignFaults as error:
        return [str(fault) for fault in error.faults]
    return []


def test_the_sample_campaigns_files_need_no_mapping(tmp_path: Path) -> None:
    folder = tmp_path / "my campaign"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("*.toml"))
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert init(folder).exit_code == 0
    document = written(folder)
    assert document["campaign"] == {"name": "my campaign", "kind": "photogrammetry"}
    assert "files" not in document
    assert {path: path.read_bytes() for path in before} == before


def test_an_existing_campaign_toml_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text("mine")
    done = init(tmp_path)
    assert done.exit_code == 2
    assert "never overwritten" in done.stderr
    assert (tmp_path / "campaign.toml").read_text() == "mine"


def test_no_folder_there(tmp_path: Path) -> None:
    done = init(tmp_path / "nowhere")
    assert done.exit_code == 2
    assert_says(done.stderr, "folder", "exists")


def test_the_starter_holds_what_the_campaign_needs_in_few_lines(tmp_path: Path) -> None:
    shutil.copytree(SAMPLE, tmp_path / "raw", ignore=shutil.ignore_patterns("*.toml"))
    text, _ = starter(tmp_path / "raw", {})
    assert len(text.splitlines()) < 60
    assert {line.split(" =")[0] for line in text.splitlines() if "needed" in line} >= {"# point_mm"}
    assert "# [mechanism]" in text  # actuators are read
    assert "wavelength" not in text
    assert "photographs" not in text


def test_every_line_of_a_starter_that_is_switched_off_can_be_switched_on(tmp_path: Path) -> None:
    text, _ = starter(tmp_path, {"a.csv": "pose,x,y,z,roll,pitch,yaw\n" + rows(range(8), *PLACED.T, *PLACED.T)})
    lines = [re.sub(r"^# (?=[a-z_]+ = |\[)", "", line) for line in text.splitlines()]
    document = tomllib.loads("\n".join(lines))
    assert {"measurement", "poses", "noise"} <= set(document)
    assert faults_of(document) == []


def test_a_starter_file_stays_short_for_any_folder(tmp_path: Path) -> None:
    files = {f"{name}.csv": f"pose,body,target,x_mm,y_mm,z_mm\n1,{name},A,1,2,3\n" for name in "abcdefghijklmnop"}
    for number, name in enumerate(files):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / name).write_text(files[name].replace(",", ";" if number % 2 else ","))
    text, document = starter(tmp_path, {})
    assert len(text.splitlines()) < 60
    reported = re.findall(r"^#   (\d+)/", text, re.MULTILINE)
    assert len(document["files"]["points"]) + len(reported) + int(re.search(r"and (\d+) others", text)[1]) == len(files)  # type: ignore[index]
    assert init(tmp_path, "--all").exit_code == 2  # never overwritten
