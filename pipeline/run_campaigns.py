"""`truing run` on one campaign or many: each in its own folder, one after the other or several at a time."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from truing.pipeline.campaign_folder import CampaignFolder, run_folder_of
from truing.pipeline.endings import KEPT, end, end_all
from truing.pipeline.executor import results
from truing.pipeline.problems import ExitCode, gravest
from truing.pipeline.run_campaign import Wish, run_campaign, usable_campaign
from truing.pipeline.run_owner import refuse_raw_files
from truing.pipeline.voice import Recorder, Voice
from truing.pipeline.workforce import Workforce, processors
from truing.schemas.faults import CampaignFaults, Fault


@dataclass(frozen=True)
class Job:
    """One campaign to run, where, and the line that its messages stand under."""

    campaign: CampaignFolder
    folder: Path
    wish: Wish
    heading: str | None = None


@dataclass(frozen=True)
class Told:
    """How a campaign ended, and what was said meanwhile: each line with whether it warns."""

    code: ExitCode
    lines: tuple[tuple[bool, str], ...]

    def repeat(self, voice: Voice) -> None:
        """Say it to whoever watches."""
        for warns, line in self.lines:
            (voice.warn if warns else voice.say)(line)


@dataclass
class Plan:
    """From the places of a call to jobs; no two campaigns of a call may share a run folder."""

    out: Path | None
    wish: Wish
    several: bool
    taken: set[Path] = field(default_factory=set)

    def job(self, place: Path) -> Job:
        """The job for one place; raises CampaignFaults where there can be none."""
        campaign = usable_campaign(place)
        folder = run_folder_of(campaign, self.out, several=self.several)
        # Not everywhere do capitals, or how an accent is composed, tell folders apart.
        taken = Path(unicodedata.normalize("NFC", str(folder)).casefold())
        if taken in self.taken:
            expected = "a name that no other campaign of this call has: it names the run's folder"
            raise CampaignFaults([Fault(str(campaign.file), expected, column="campaign.name", value=campaign.name)])
        self.taken.add(taken)
        refuse_raw_files(campaign, folder)
        return Job(campaign, folder, self.wish, f"{campaign.name} ({place})" if self.several else None)


def run_campaigns(
    places: Sequence[Path], out: Path | None, wish: Wish, *, quiet: bool, workforce: Workforce | None = None
) -> ExitCode:
    """Run campaigns; the gravest ending is the call's. Nothing but an interruption of one ends the others."""
    voice, plan = Voice(quiet=quiet), Plan(out, wish, several=len(places) > 1)
    if workforce is None or workforce.is_alone or (len(places) == 1 and workforce.scheduler is None):
        plan.wish = replace(wish, workers=(workforce and workforce.workers) or processors())
        return end_all([partial(_run_here, place, plan, voice) for place in places], voice)
    return end_all([partial(_run_at_a_time, places, plan, workforce, voice)], voice)


def _run_here(place: Path, plan: Plan, voice: Voice) -> ExitCode:
    return _run(plan.job(place), voice)


def _run(job: Job, voice: Voice) -> ExitCode:
    if job.heading is not None:
        voice.say(job.heading)
    return run_campaign(job.campaign, job.folder, job.wish, voice)


def _run_at_a_time(places: Sequence[Path], plan: Plan, workforce: Workforce, voice: Voice) -> ExitCode:
    """Several campaigns at a time, their messages in the order of the call, each whole."""
    planned = [_planned(place, plan, workforce) for place in places]
    jobs = [job for job in planned if isinstance(job, Job)]
    codes = []
    with voice.during("run") as watched:
        told = results(_told, jobs, workforce, _lost, lambda done: watched(done, len(jobs), "campaigns"))
        with closing(told):
            for entry in planned:
                ending = next(told) if isinstance(entry, Job) else entry
                ending.repeat(voice)
                codes.append(ending.code)
    return gravest(codes)


def _planned(place: Path, plan: Plan, workforce: Workforce) -> Job | Told:
    """The job for one place, or why there is none."""
    found: list[Job] = []
    recorder = Recorder()

    def prepare() -> ExitCode:
        job = plan.job(place)
        found.append(job if workforce.scheduler is None else _for_other_machines(job))
        return ExitCode.DONE

    code = end(prepare, recorder)
    return found[0] if found else Told(code, tuple(recorder.lines))


def _for_other_machines(job: Job) -> Job:
    """The same job by paths that hold wherever the worker stands, its folders shared."""
    campaign = replace(job.campaign, file=job.campaign.file.resolve())
    return replace(job, campaign=campaign, folder=job.folder.resolve())


def _told(job: Job) -> Told:
    """What a worker does: run the campaign, and keep what it says."""
    recorder = Recorder()
    code = end(lambda: _run(job, recorder), recorder)
    return Told(code, tuple(recorder.lines))


def _lost(job: Job) -> Told:
    why = f"{job.campaign.name}: whatever worker ran it vanished (killed, or out of memory); {KEPT}"
    return Told(ExitCode.ENVIRONMENT, ((True, why),))
