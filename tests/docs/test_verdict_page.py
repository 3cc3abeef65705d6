"""The page of the verdict names every section and every reason code with its meaning."""

from __future__ import annotations

from pathlib import Path

import pytest

from truing.schemas.verdict import CAMPAIGN, SECTIONS, ReasonCode

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "verdict.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("code", ReasonCode)
def test_every_reason_code_is_on_its_page(code: ReasonCode) -> None:
    assert f"| `{code.value}` | {code.meaning} |" in PAGE


def test_every_section_is_on_its_page_in_its_order() -> None:
    places = [PAGE.index(f"| `{name}` |") for name in (CAMPAIGN, *SECTIONS)]
    assert places == sorted(places)
