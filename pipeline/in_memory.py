"""Execution of stages in this process without writing, for notebooks and simulated campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.pipeline.campaign_folder import CampaignFolder, SettingsView, open_campaign
from truing.pipeline.stage_order import RAW_READERS, order_of, stage_module, without_mark
from truing.schemas.artifact import plain_texts
from truing.schemas.campaign import Campaign
from truing.stages.declaration import Outcome


@dataclass
class StageLine:
    """Settings and files of a campaign, tables of its stages so far, and their messages."""

    settings: Campaign
    source: CampaignFiles
    tables: dict[str, pa.Table | str] = field(default_factory=dict)
    outcomes: dict[str, Outcome] = field(default_factory=dict)

    def call(self, *names: str) -> StageLine:
        """Call stages by name, in this order; by default, all stages of this kind of campaign. Returns the line itself.

        A table put into ``tables`` before replaces that of a stage.
        """
        kind = self.settings.campaign.kind
        for name in names or order_of(kind, photographs=self.source.has_photographs):  # without a second campaign
            more = (self.source,) if name in RAW_READERS else ()
            self.outcomes[name] = call_stage(name, self.tables, self.settings, *more)
            self.tables |= self.outcomes[name].artifacts  # type: ignore[arg-type]  # read whole by then
        return self


def stage_line(campaign: str | Path, scratch: Path | None = None) -> StageLine:
    """A line for a campaign's folder before the first stage; raises CampaignFaults with every fault of its toml.

    scratch: folder for temporary files; absent: the system's.
    """
    opened = open_campaign(Path(campaign))
    settings = opened.validated()
    return StageLine(settings, CampaignFiles(opened.folder, settings, scratch))


def call_stage(name: str, tables: Mapping[str, pa.Table | str], settings: Campaign, *more: Any) -> Outcome:
    """Artifacts of a stage for its declared tables, as if read back from file."""
    stage = stage_module(name)
    wanted = {without_mark(read) for read in stage.DECLARATION.reads}
    given = {key: table for key, table in tables.items() if key in wanted}
    outcome: Outcome = stage.run(given, SettingsView(settings, stage.DECLARATION.settings), lambda *_: None, *more)
    return replace(outcome, artifacts={key: as_read(left) for key, left in outcome.artifacts.items()})


def as_read(left: pa.Table | pa.RecordBatchReader | str) -> pa.Table | str:
    """A stream as one table, and text columns without dictionary."""
    if isinstance(left, str):
        return left
    return plain_texts(left.read_all() if isinstance(left, pa.RecordBatchReader) else left)


def bench_tables(campaign: CampaignFolder, settings: Campaign) -> tuple[dict[str, pa.Table], bool]:
    """Load steps with readings, and True; or planned steps with zeros, and False. Raises CampaignFaults."""
    from truing.stages.ingestion.planned_loads import planned_loads

    source = CampaignFiles(campaign.folder, settings)
    planned = planned_loads(source, settings)
    if planned is not None:
        return planned, False
    return dict(call_stage("ingest", {}, settings, source).artifacts), True


def axis_tables(campaign: CampaignFolder, settings: Campaign) -> dict[str, pa.Table]:
    """Rows of an axis; without any reading, those of a plan, read without errors. Raises CampaignFaults."""
    from truing.stages.ingestion.axis_rows import ingest

    outcome = ingest(settings, CampaignFiles(campaign.folder, settings), FaultLog(), may_be_planned=True)
    return {"configurations": plain_texts(outcome.artifacts["configurations"])}


def chain_tables(campaign: CampaignFolder, settings: Campaign) -> dict[str, pa.Table]:
    """Tables of a campaign of a chain; before any measurement, joints and planned rows. Raises CampaignFaults."""
    from truing.stages.ingestion.chain_campaign import planned_chain

    source = CampaignFiles(campaign.folder, settings)
    if any(source.entries(name) for name in ("points", "poses", "distances")) or source.has_photographs:
        return dict(call_stage("ingest", {}, settings, source).artifacts)
    return planned_chain(settings, source)
