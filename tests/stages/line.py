"""Runs the stages of a campaign folder one after the other in this process, without files between them."""

from __future__ import annotations

import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import pyarrow as pa

from pipeline.settings_view import SettingsView
from schemas.artifacts import ARTIFACTS
from schemas.campaign import Campaign, read_campaign
from stages.declaration import Outcome
from truing.formats.source import CampaignFiles


def run_line(folder: Path, *stages: str) -> tuple[dict[str, pa.Table], dict[str, Outcome]]:
    """Every table that the named stages leave, held to its schema, and what each stage said."""
    campaign = settings_of(folder)
    tables: dict[str, Any] = {}
    said = {}
    for name in stages:
        module = import_module(f"stages.{name}")
        wanted = {read.rstrip("?") for read in module.DECLARATION.reads}
        given = {key: table for key, table in tables.items() if key in wanted}
        more = (CampaignFiles(folder, campaign),) if name == "ingest" else ()
        view = SettingsView(campaign, module.DECLARATION.settings)
        said[name] = module.run(given, view, lambda *_: None, *more)
        tables |= {key: _whole(key, made) for key, made in said[name].artifacts.items()}
    return tables, said


def settings_of(folder: Path) -> Campaign:
    """What campaign.toml says."""
    return read_campaign(tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8")))


def _whole(name: str, made: Any) -> Any:
    table = made.read_all() if isinstance(made, pa.RecordBatchReader) else made
    if isinstance(table, pa.Table):
        assert not ARTIFACTS[name].faults(table), [str(fault) for fault in ARTIFACTS[name].faults(table)]
        table = table.cast(pa.schema([(f.name, _plain(f.type)) for f in table.schema]))
    return table


def _plain(kind: pa.DataType) -> pa.DataType:
    """The type that a file gives back: text without its dictionary."""
    return kind.value_type if pa.types.is_dictionary(kind) else kind
