"""Everything that is wrong with a campaign, in campaign.toml and in the raw files, found in one go."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.campaign_folder import CampaignFolder, identity_faults, open_campaign
from pipeline.campaign_run import CampaignRun, detached_run
from pipeline.problems import ExitCode
from pipeline.settings_view import SettingsView
from pipeline.stage_order import RAW_READERS, is_optional, stage_module
from pipeline.voice import Voice
from schemas.faults import CampaignFaults, Fault

_ROUNDS = 3  # taking out a faulty key may uncover what stood behind it


def check_campaign(campaign: CampaignFolder) -> str:
    """Read and check everything, write nothing; returns what ingest read. Raises CampaignFaults with every fault."""
    faults = settings_faults(campaign)
    if faults:
        raise CampaignFaults([*faults, *_raw_faults_despite(campaign)])
    return _read_raw(detached_run(campaign))


def settings_faults(campaign: CampaignFolder) -> list[Fault]:
    """Every fault of campaign.toml itself."""
    known = {fault.column: fault for fault in identity_faults(campaign)}
    try:
        campaign.validated()
    except CampaignFaults as error:
        return [*known.values(), *(fault for fault in error.faults if fault.column not in known)]
    return list(known.values())


def _read_raw(run: CampaignRun) -> str:
    from pipeline.artifacts import drain
    from truing.formats.source import CampaignFiles

    said: list[str] = []
    faults: list[Fault] = []
    for stage in run.order:
        if stage.name not in RAW_READERS or not all(map(is_optional, stage.reads)):
            continue  # what needs the work of others is no look at the files
        try:
            source = CampaignFiles(run.campaign.folder, run.settings)
            if stage.name == "images" and source.entries("images"):
                settings = SettingsView(run.settings, stage.settings)
                said.append(f"opened {stage_module(stage.name).look(settings, source)}")
                continue
            outcome = run.outcome(stage, lambda done, total, what: None)
            drain(outcome.artifacts)
            said.append(f"read {outcome.read}; left out {outcome.left_out}")
        except CampaignFaults as error:
            faults += error.faults
    if faults:
        raise CampaignFaults(dict.fromkeys(faults))
    return "; ".join(said)


def _raw_faults_despite(campaign: CampaignFolder) -> tuple[Fault, ...]:
    """Faults of the raw files of a campaign whose campaign.toml has faults too, as far as they can be judged."""
    mended = _without_faulty_keys(campaign)
    if mended is None:
        return ()
    try:
        _read_raw(detached_run(mended))
    except CampaignFaults as error:
        return error.faults
    except Exception:  # a campaign with keys taken out is none that ingest must be able to read
        return ()
    return ()


def _without_faulty_keys(campaign: CampaignFolder) -> CampaignFolder | None:
    """The campaign without the keys at fault; None where it cannot do without them."""
    document = copy.deepcopy(dict(campaign.document))
    if isinstance(document.get("campaign"), dict):
        document["campaign"]["name"] = "campaign"  # no data hang on the name
    mended = replace(campaign, document=document)
    for _ in range(_ROUNDS):
        faults = settings_faults(mended)
        if not faults:
            return mended
        if not all(_remove(mended.document, fault.column or "") for fault in faults):
            return None
    return None


def _remove(document: Mapping[str, Any], dotted: str) -> bool:
    """Take out the value at a fault's dotted path (list indices count from 1); False where it is not there."""
    place: Any = document
    *way, last = dotted.split(".")
    try:
        for part in way:
            place = place[int(part) - 1] if isinstance(place, list) else place[part]
        del place[int(last) - 1 if isinstance(place, list) else last]
    except (KeyError, IndexError, ValueError, TypeError):
        return False
    return True


def report_check(place: Path) -> ExitCode:
    """`truing check` on one campaign: says that it can be used, or raises CampaignFaults."""
    campaign = open_campaign(place)
    Voice(quiet=False).say(f"{campaign.file}: no fault; {check_campaign(campaign)}")
    return ExitCode.DONE
