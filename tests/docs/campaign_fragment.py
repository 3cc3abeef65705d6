"""Check of TOML on a page: part of a valid campaign.toml or pyproject.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import ValidationError

from truing.schemas import mapping, mechanism
from truing.schemas.campaign import Campaign
from truing.schemas.quality_checks import limit_faults

_KINDS = ("photogrammetry", "interferometer")
_TYPES = ("6-pus", "ups", "6-upur")


def fault_of_toml(text: str, page: str, patch: pytest.MonkeyPatch) -> str | None:
    """Return the fault of a block on a page whose packages count as installed, or None."""
    document = tomllib.loads(text)
    if "project" in document:
        return None if {"name", "version"} <= set(document["project"]) else "a project without name or version"
    if not document or not set(document) <= set(Campaign.model_fields):
        return f"neither a part of campaign.toml nor a pyproject: {', '.join(document)}"
    for module in (mapping, mechanism):
        patch.setattr(module, "entry_points", lambda group: _Declared(group, page))
    reported = [_fault_of_campaign(whole) for kind in _KINDS for whole in _completed(document, kind)]
    return None if None in reported else reported[0]


class _Declared:
    """The entry points that a page's pyproject declares."""

    def __init__(self, group: str, page: str) -> None:
        blocks = page.split("```toml\n")[1:]
        parsed = [tomllib.loads(block.split("```")[0]) for block in blocks]
        self.names = {name for block in parsed for name in _points(block).get(group, {})}


def _points(document: dict[str, Any]) -> dict[str, dict[str, str]]:
    return document.get("project", {}).get("entry-points", {})


def _completed(document: dict[str, Any], kind: str) -> Iterator[dict[str, Any]]:
    """Yield documents that complete a fragment with the sections that it leaves out."""
    whole = {**document, "campaign": {"name": "page", "kind": kind, **document.get("campaign", {})}}
    section = document.get("mechanism", {"type": "none"})
    for name in [section["type"]] if "type" in section else _TYPES:
        yield {**whole, "mechanism": {**section, "type": name}}


def _fault_of_campaign(whole: dict[str, Any]) -> str | None:
    """Return the first fault of a document, or None; missing keys are no fault of a fragment."""
    try:
        campaign = Campaign.model_validate(whole)
    except ValidationError as error:
        reported = [f"{detail['loc']}: {detail['msg']}" for detail in error.errors() if detail["type"] != "missing"]
        return reported[0] if reported else None
    faults = tuple(limit_faults("campaign.toml", campaign.campaign.kind, campaign.qa.limits))
    return str(faults[0]) if faults else None
