"""Facts of a campaign for its page, which no table holds."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path

import pytest

from tests.conftest import PROJECT
from truing.schemas.campaign import read_campaign
from truing.stages.common.campaign_facts import campaign_facts, processor_model


@pytest.mark.parametrize(("sample", "expected"), [("telescope", False), ("telescope-images", True)])
def test_the_library_that_measures_photographs_is_named_where_there_are_any(sample: str, expected: bool) -> None:
    text = (PROJECT / "sample_data" / sample / "campaign.toml").read_text(encoding="utf-8")
    software = dict(campaign_facts(read_campaign(tomllib.loads(text))).software)
    assert any(name.startswith("opencv") for name in software) is expected
    assert {"truing", "Python", "numpy", "scipy", "pandas", "pyarrow"} <= set(software)


def test_the_model_of_the_processor_is_the_first_that_the_system_lists(tmp_path: Path) -> None:
    listed = tmp_path / "cpuinfo"
    listed.write_text("processor\t: 0\nmodel name\t: A  Processor @ 2.40GHz\nmodel name\t: another\n", encoding="utf-8")
    assert processor_model(listed) == "A Processor @ 2.40GHz"


def test_a_system_without_a_list_gives_no_architecture_in_place_of_a_model(tmp_path: Path) -> None:
    assert processor_model(tmp_path / "none") != platform.machine()
