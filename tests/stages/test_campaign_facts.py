"""Facts of a campaign for its page, which no table holds."""

from __future__ import annotations

import tomllib

import pytest

from tests.conftest import PROJECT
from truing.schemas.campaign import read_campaign
from truing.stages.common.campaign_facts import campaign_facts


@pytest.mark.parametrize(("sample", "expected"), [("telescope", False), ("telescope-images", True)])
def test_the_library_that_measures_photographs_is_named_where_there_are_any(sample: str, expected: bool) -> None:
    text = (PROJECT / "sample_data" / sample / "campaign.toml").read_text(encoding="utf-8")
    software = dict(campaign_facts(read_campaign(tomllib.loads(text))).software)
    assert any(name.startswith("opencv") for name in software) is expected
    assert {"truing", "Python", "numpy", "scipy", "pandas", "pyarrow"} <= set(software)
