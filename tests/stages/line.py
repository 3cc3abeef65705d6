"""Run the stages of a campaign folder in this process, with every table checked against its schema."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import stage_line
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Campaign
from truing.stages.declaration import Outcome


def run_line(folder: Path, *stages: str) -> tuple[dict[str, pa.Table], dict[str, Outcome]]:
    """Every table that the named stages leave, held to its schema, and what each stage said."""
    line = stage_line(folder).call(*stages)
    for name, table in line.tables.items():
        if isinstance(table, pa.Table):
            assert not ARTIFACTS[name].faults(table), [str(fault) for fault in ARTIFACTS[name].faults(table)]
    return line.tables, line.outcomes


def settings_of(folder: Path) -> Campaign:
    """Settings of campaign.toml."""
    return open_campaign(folder).validated()
