"""The manifest of a run folder is indented JSON of its entries, and reads back as it was."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from truing.pipeline.manifest import Entry, Manifest, Owner, StageInputs, read_manifest

MADE_FROM = StageInputs("c", {"a.py": "1\n2"}, {"noise": {"point_mm": 0.005}}, {"survey": None}, {"points.csv": "ä"})
OWNER = Owner('a "name"', "campaign.toml", "3", "runs")


@pytest.mark.parametrize(
    "manifest",
    [
        Manifest(),
        Manifest({"ingest": Entry("1", {"observations": "2"}, (), MADE_FROM)}, "4", OWNER),
        Manifest({"ingest": Entry("1", {}), "qa": Entry("5", {"qa": "6"}, ("scale", "noise"), MADE_FROM)}, "4"),
    ],
    ids=["empty", "one stage", "two stages"],
)
def test_a_manifest_is_saved_as_indented_json_and_read_again(manifest: Manifest, tmp_path: Path) -> None:
    store = tmp_path / "ledger.json"
    for _ in range(2):  # entries keep their text
        manifest.save(store)
        assert store.read_text(encoding="utf-8") == json.dumps(asdict(manifest), indent=1)
    assert read_manifest(store) == manifest
