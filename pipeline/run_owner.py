"""Owner of a run folder, so that no campaign overwrites the results of another one with the same name.

A campaign is known by the place of its campaign.toml. One that was corrected stays the same campaign; so does one that
has been moved (nothing lies at the old place any more) or copied (campaign.toml and raw files hold the same).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.campaign_folder import FILE, CampaignFolder, run_folder_of
from truing.pipeline.campaign_run import CampaignRun, open_run
from truing.pipeline.manifest import Owner, digest_of
from truing.pipeline.problems import EnvironmentProblem
from truing.pipeline.run_folder import locked_folder
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.schemas.artifact import Artifact


def claim(run: CampaignRun) -> None:
    """Note the owner of a run folder (in memory, until the manifest is saved); raises CampaignFaults."""
    check_owner(run)
    if not run.manifest.entries:
        _refuse_foreign_files(run.folder)
    run.manifest.owner = _owner(run)


def check_owner(run: CampaignRun) -> None:
    """Raise CampaignFaults if a run folder holds results of another campaign."""
    known = run.manifest.owner
    here = _owner(run)
    if known is not None and known.folder == here.folder:
        if known.file == here.file or (known.settings == here.settings and _holds_measurements(run)):
            return
        if not os.path.exists(known.file) and (known.name == here.name or _holds_measurements(run)):
            return
        raise _refusal(run, f"the run of {known.name!r} ({known.file})")
    _check_names(run)


def _owner(run: CampaignRun) -> Owner:
    campaign = run.campaign
    file, folder = os.path.realpath(campaign.file), os.path.realpath(run.folder)
    return Owner(campaign.name, file, digest_of(dict(campaign.document)), folder)


def _check_names(run: CampaignRun) -> None:
    """Check the owner by names if it is not recorded: the folder was copied, or is of an older version."""
    names = {entry.made_from.campaign for entry in run.manifest.entries.values() if entry.made_from is not None}
    if not names and not (names := set(_carried_names(run.folder))):
        return
    if run.campaign.name not in names and not _holds_measurements(run):
        raise _refusal(run, f"the run of {', '.join(map(repr, sorted(names)))}")


def _carried_names(folder: Path) -> Iterator[str]:
    """Campaign names in the artifacts of a folder."""
    from truing.pipeline.artifacts import read_provenance

    for artifact in _present_artifacts(folder):
        origin = read_provenance(folder, artifact)
        if origin is not None and "campaign" in origin:
            yield origin["campaign"]


def _present_artifacts(folder: Path) -> list[Artifact]:
    return [artifact for artifact in ARTIFACTS.values() if os.path.lexists(folder / artifact.file)]


def _refuse_foreign_files(folder: Path) -> None:
    """Raise CampaignFaults if files have names of artifacts but none is one."""
    there = _present_artifacts(folder)
    if there and not any(_carried_names(folder)):
        files = ", ".join(dict.fromkeys(artifact.file for artifact in there))
        expected = f"a separate folder for a run, not one with files of another origin ({files})"
        raise CampaignFaults([Fault("--out", expected, value=str(folder))])


def _holds_measurements(run: CampaignRun) -> bool:
    """True if the folder's tables were made from the campaign's present raw files."""
    made = {name: entry.made_from.raw for name, entry in run.manifest.entries.items() if entry.made_from is not None}
    read = [stage for stage in run.order if made.get(stage.name)]
    return bool(read) and all(run.made_from(stage).raw == made[stage.name] for stage in read)


def _refusal(run: CampaignRun, holds: str) -> CampaignFaults:
    campaign = run.campaign
    expected = (
        f"a separate folder for the run of {campaign.name!r} ({os.path.realpath(campaign.file)}); this one holds "
        f"{holds}. Give the campaigns different names ([campaign] name), choose another folder by --out, or remove "
        "this one"
    )
    return CampaignFaults([Fault(str(run.folder), expected)])


def refuse_raw_files(campaign: CampaignFolder, folder: Path) -> None:
    """Raise CampaignFaults if a run would write among raw files, because an artifact may have a raw file's name."""
    from truing.formats.source import raw_files

    real = os.path.realpath(folder)
    raw = [os.path.realpath(path) for path in raw_files(campaign.folder, campaign.document)]
    among = real in {os.path.realpath(campaign.folder), *map(os.path.dirname, raw)}
    if among or any(path.startswith(real + os.sep) for path in raw):
        raise CampaignFaults([Fault("--out", "a folder that holds no raw files of the campaign", value=str(folder))])
    if os.path.lexists(folder / FILE):
        raise CampaignFaults([Fault("--out", "a separate folder for a run, not a campaign's", value=str(folder))])


def folder_next_to_run(campaign: CampaignFolder) -> Path:
    """Default output folder of other commands next to a run; raises CampaignFaults if another campaign owns it."""
    folder = run_folder_of(campaign, None, several=False)
    check_owner(open_run(campaign, folder))
    return folder


def note_owner(campaign: CampaignFolder, folder: Path) -> None:
    """Note the owner of a folder before its first run; a run in progress has already noted it."""
    with suppress(EnvironmentProblem), locked_folder(folder):
        run = open_run(campaign, folder)
        check_owner(run)
        run.manifest.owner = _owner(run)
        run.save()
