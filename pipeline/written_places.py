"""Places that a call names to write to: never a raw file, a file of a run, or what the call itself reads."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from truing.pipeline.campaign_folder import FILE, CampaignFolder, open_campaign
from truing.pipeline.run_folder import PRIVATE
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault

OPTION = "--out"


def check_file(place: Path, *, reads: Sequence[Path | None] = (), campaign: CampaignFolder | None = None) -> None:
    """Raise CampaignFaults where a file that a call shall write is one that nobody may overwrite."""
    if why := next(_file_objections(place, reads, campaign), None):
        raise CampaignFaults([Fault(OPTION, why, value=str(place))])


def _file_objections(place: Path, reads: Sequence[Path | None], campaign: CampaignFolder | None) -> Iterator[str]:
    if place.is_dir():
        yield "a file to write, not a folder"
    if any(_is_same(place, read) for read in reads if read is not None):
        yield "another file than those that this call reads"
    if (campaign is not None and _is_raw(place, campaign)) or _is_raw_there(place):
        yield "another file than the raw files of a campaign; remove it first if it holds nothing measured"
    if (place.parent / PRIVATE).is_dir() and place.name in {artifact.file for artifact in ARTIFACTS.values()}:
        yield "another file than those of a run"


def check_folder(place: Path) -> None:
    """Raise CampaignFaults where a folder that a call shall fill is a campaign's."""
    if os.path.lexists(place / FILE):
        raise CampaignFaults([Fault(OPTION, "a folder that holds no campaign", value=str(place))])


def _is_same(place: Path, other: Path) -> bool:
    return os.path.realpath(place) == os.path.realpath(other)


def _is_raw_there(place: Path) -> bool:
    """Whether a file is one that the campaign beside it reads; any, where its campaign.toml cannot be read."""
    if not place.exists() or not os.path.lexists(place.parent / FILE):
        return False
    try:
        return _is_raw(place, open_campaign(place.parent))
    except CampaignFaults:
        return True


def _is_raw(place: Path, campaign: CampaignFolder) -> bool:
    from truing.formats.source import raw_files

    return any(_is_same(place, raw) for raw in raw_files(campaign.folder, campaign.document))
