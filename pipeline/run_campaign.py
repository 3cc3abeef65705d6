"""`truing run` on one campaign: what is fresh stays, what is stale runs, the report's place is said."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from truing.pipeline.campaign_check import check_before_photographs, check_campaign
from truing.pipeline.campaign_folder import CampaignFolder, identity_faults, open_campaign
from truing.pipeline.campaign_run import CampaignRun, detached_run, open_run
from truing.pipeline.endings import defects_logged
from truing.pipeline.freshness import State
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_folder import occupied
from truing.pipeline.run_owner import claim
from truing.pipeline.selection import Selection
from truing.pipeline.stage_order import OF_PHOTOGRAPHS
from truing.pipeline.voice import Voice
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults
from truing.stages.declaration import Stage

_LOG = "defect.log"


@dataclass(frozen=True)
class Wish:
    """What the caller of `truing run` asked for besides the campaign."""

    selection: Selection = field(default_factory=Selection)
    distrust: bool = False
    accept_failed_checks: bool = False
    workers: int = 1  # processes for what one stage can do in independent pieces


def usable_campaign(place: Path) -> CampaignFolder:
    """The campaign at a place, its name and kind known to be good; raises CampaignFaults with all that is wrong."""
    campaign = open_campaign(place)
    if identity_faults(campaign):
        check_campaign(campaign)
    return campaign


def run_campaign(campaign: CampaignFolder, folder: Path, wish: Wish, voice: Voice) -> ExitCode:
    """Bring the wished stages of a campaign up to date in its run folder."""
    with occupied(folder), defects_logged(folder / _LOG, "preparing the run"):
        run = open_run(campaign, folder, distrust=wish.distrust, workers=wish.workers)
        claim(run)
        stages = wish.selection.stages(run.order)
        _validate(run)
        _check_before_photographs(run, stages, wish)
        ran = [stage.name for stage in stages if _bring_up_to_date(run, stage, wish, voice)]
        run.save()
        if not ran:
            voice.say(f"{campaign.name}: everything is up to date")
        _say_where(run, voice)
        return _verdict(run.failed_checks(stages), wish, voice)


def _validate(run: CampaignRun) -> None:
    try:
        run.validate()
    except CampaignFaults:
        check_campaign(run.campaign)  # tells what is wrong with the raw files in the same breath
        raise


def _check_before_photographs(run: CampaignRun, stages: tuple[Stage, ...], wish: Wish) -> None:
    """Tell what is wrong with other files before photographs are measured, which takes long."""
    slow = [stage for stage in stages if stage.name in OF_PHOTOGRAPHS]
    if any(
        wish.selection.forces(stage, run.order) or run.standing(stage, run.made_from(stage)).state is not State.FRESH
        for stage in slow
    ):
        check_before_photographs(detached_run(run.campaign))


def _bring_up_to_date(run: CampaignRun, stage: Stage, wish: Wish, voice: Voice) -> bool:
    """Run a stage unless it is fresh; returns whether it ran."""
    log = run.folder / _LOG
    with defects_logged(log, f"stage {stage.name}"):
        now = run.made_from(stage)
        standing = run.standing(stage, now)
        if standing.state is State.FRESH and not wish.selection.forces(stage, run.order):
            return False
        log.unlink(missing_ok=True)
        with voice.during(stage.name) as progress:
            closing = run.execute(stage, now, progress)
        voice.say(f"{stage.name:<12} {closing}")
        return True


def _say_where(run: CampaignRun, voice: Voice) -> None:
    made = any("report" in entry.artifacts for entry in run.ledger.entries.values())
    voice.say(f"report: {run.folder / ARTIFACTS['report'].file}" if made else f"results: {run.folder}")


def _verdict(failed: tuple[str, ...], wish: Wish, voice: Voice) -> ExitCode:
    if not failed:
        return ExitCode.DONE
    voice.warn(f"QA: {len(failed)} failed ({', '.join(failed)}); the report says why")
    return ExitCode.DONE if wish.accept_failed_checks else ExitCode.FAILED_CHECK
