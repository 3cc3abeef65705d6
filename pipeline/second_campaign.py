"""The second campaign that a campaign's models predict: its folder, files and tables up to the poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.campaign_folder import CampaignFolder, identity_faults, open_campaign
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.stages.second_campaign.compared import SecondCampaign

_KEY = "diagnosis.judge_on"


def second_folder(campaign: CampaignFolder) -> CampaignFolder:
    """Campaign named by [diagnosis] judge_on; raises CampaignFaults if it is no second campaign of the same kind and
    type of mechanism."""
    named = str(campaign.section(_KEY))
    path = campaign.folder / named
    try:
        folder = open_campaign(path)
    except (CampaignFaults, ValueError) as error:  # the text may be no valid path
        text = "; ".join(fault.expected for fault in getattr(error, "faults", ())) or "a path"
        raise _fault(campaign, f"the folder of a second campaign, relative to campaign.toml: {text}", named) from None
    if folder.file.resolve() == campaign.file.resolve():
        raise _fault(
            campaign,
            "another campaign than this one, because models must predict data that they were not fitted to",
            named,
        )
    if faults := identity_faults(folder):
        raise CampaignFaults(faults)
    for key, default in (("campaign.kind", None), ("mechanism.type", "none")):
        first, second = (one.section(key) or default for one in (campaign, folder))
        if first != second:
            expected = (
                f"a second campaign of the same machine; {folder.file} has {key} = {second!r}, this one {first!r}"
            )
            raise _fault(campaign, expected, named)
    return folder


def _fault(campaign: CampaignFolder, expected: str, value: str) -> CampaignFaults:
    return CampaignFaults([Fault(str(campaign.file), expected, column=_KEY, value=value)])


def files_of_second(campaign: CampaignFolder) -> tuple[Path, ...]:
    """Files of the second campaign; raises CampaignFaults like `second_folder`."""
    from truing.formats.source import raw_files

    campaign_folder = second_folder(campaign)
    return (campaign_folder.file, *raw_files(campaign_folder.folder, campaign_folder.document))


def second_campaign(campaign: CampaignFolder, stages: Sequence[str], scratch: Path | None = None) -> SecondCampaign:
    """The second campaign with the tables of its stages; raises CampaignFaults like these stages."""
    return campaign_of(second_folder(campaign), stages, scratch)


def campaign_of(campaign_folder: CampaignFolder, stages: Sequence[str], scratch: Path | None = None) -> SecondCampaign:
    """A campaign with the tables of some of its stages, after those of photographs."""
    from truing.pipeline.in_memory import stage_line
    from truing.pipeline.stage_order import OF_PHOTOGRAPHS
    from truing.stages.second_campaign.compared import SecondCampaign

    before = OF_PHOTOGRAPHS if campaign_folder.has_photographs else ()
    line = stage_line(campaign_folder.file, scratch).call(*before, *stages)
    tables = {name: table for name, table in line.tables.items() if not isinstance(table, str)}
    return SecondCampaign(str(campaign_folder.file), line.settings, tables)
