"""The tables of a loading campaign as they are before any stage but ingest: measured, or planned."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.pipeline.in_memory import call_stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.pipeline.campaign_folder import CampaignFolder
    from truing.schemas.campaign import Campaign


def bench_tables(campaign: CampaignFolder, settings: Campaign) -> tuple[dict[str, pa.Table], bool]:
    """Load steps with what was read, and True; or as they are planned, with zeros, and False. Raises CampaignFaults."""
    from truing.formats.source import CampaignFiles
    from truing.stages.ingestion.planned_loads import planned_loads

    source = CampaignFiles(campaign.folder, settings)
    planned = planned_loads(source, settings)
    if planned is not None:
        return planned, False
    return dict(call_stage("ingest", {}, settings, source).artifacts), True
