"""`truing run` and `truing stages`: runs stale stages of one or many campaigns."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from truing.pipeline.all_campaigns import check_shared_folder, write_all_campaigns
from truing.pipeline.campaign_check import check_before_photographs, check_campaign
from truing.pipeline.campaign_folder import RUNS, CampaignFolder, identity_faults, open_campaign, run_folder_of
from truing.pipeline.campaign_outcome import CampaignOutcome, outcome_of
from truing.pipeline.campaign_run import CampaignRun, detached_run, open_run, verdict_line
from truing.pipeline.console import Recorder, RunConsole, Witness
from truing.pipeline.executor import Workforce, processors, results
from truing.pipeline.exit_status import KEPT, defects_logged, end_all
from truing.pipeline.freshness import Freshness
from truing.pipeline.problems import ExitCode, gravest
from truing.pipeline.run_folder import locked_folder
from truing.pipeline.run_owner import check_owner, claim, refuse_raw_files
from truing.pipeline.second_campaign import second_folder
from truing.pipeline.stage_order import (
    OF_PHOTOGRAPHS,
    OF_SECOND_CAMPAIGNS,
    ORDER,
    RAW_READERS,
    needed_for,
    stage_module,
)
from truing.report.numbers import approximate_duration, count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean
from truing.stages.declaration import Stage

_LOG = "defect.log"
_WORTH_SAYING_S = 5.0
_HINT = " (--workers N runs N at a time)"


@dataclass(frozen=True)
class StageSelection:
    """``first``: run again from this stage on; ``only``: this stage and those it needs; ``force``: run also fresh
    stages."""

    first: str | None = None
    only: str | None = None
    force: bool = False

    def stages(self, order: tuple[Stage, ...]) -> tuple[Stage, ...]:
        """Selected stages in order; raises CampaignFaults for a stage that this campaign lacks."""
        names = [stage.name for stage in order]
        for option, name in (("--from", self.first), ("--only", self.only)):
            if name is not None and name not in names:
                raise CampaignFaults([Fault(option, _expected(name, names), value=name)])
        return order if self.only is None else needed_for(self.only, order)

    def forces(self, stage: Stage, order: tuple[Stage, ...]) -> bool:
        """True if a stage runs although it is fresh."""
        if self.only is not None:
            return self.force and stage.name == self.only
        names = [each.name for each in order]
        return self.force or (self.first is not None and names.index(stage.name) >= names.index(self.first))


def _expected(name: str, names: list[str]) -> str:
    return f"a stage of this kind of campaign ({', '.join(names)}){did_you_mean(name, names)}"


@dataclass(frozen=True)
class RunOptions:
    """Options of `truing run` besides the campaign."""

    selection: StageSelection = field(default_factory=StageSelection)
    distrust: bool = False
    accept_failed_checks: bool = False
    workers: int = 1  # processes for the independent pieces of one stage
    verbose: bool = False


def usable_campaign(path: Path) -> CampaignFolder:
    """Campaign at a path, with valid name and kind; raises CampaignFaults with all faults."""
    campaign = open_campaign(path)
    if identity_faults(campaign):
        check_campaign(campaign)
    return campaign


def run_campaign(campaign: CampaignFolder, folder: Path, settings: RunOptions, console: RunConsole) -> ExitCode:
    """Bring the selected stages of a campaign up to date in its run folder."""
    with locked_folder(folder), defects_logged(folder / _LOG, "preparing the run"):
        run = open_run(campaign, folder, distrust=settings.distrust, workers=settings.workers)
        claim(run)
        stages = settings.selection.stages(run.order)
        _validate(run)
        _check_before_photographs(run, stages, settings)
        ran = list[str]()
        for k, stage in enumerate(stages, 1):
            if _bring_up_to_date(run, stages, settings, console, k, is_first=not ran):
                ran.append(stage.name)
        verdict = run.verdict(stages)
        run.save()
        if not ran:
            console.line(f"{campaign.name}: everything is up to date")
        _print_location(run, console)
        if verdict:
            console.line(verdict_line(verdict))
        code = _exit_code(run, stages, settings, console)
        console.add_fact("campaigns", _run_facts(run, stages, ran, verdict, code))
        return code


def _run_facts(
    run: CampaignRun, stages: tuple[Stage, ...], ran: list[str], verdict: Mapping[str, str], code: ExitCode
) -> dict[str, object]:
    """Facts of a run for JSON."""
    return {
        "campaign": run.campaign.name,
        "folder": str(run.folder),
        "stages": [{"stage": stage.name, "ran": stage.name in ran} for stage in stages],
        "verdict": dict(verdict) or None,
        "failed_checks": run.failed_checks(stages),
        "exit_code": int(code),
    }


def _validate(run: CampaignRun) -> None:
    try:
        run.validate()
    except CampaignFaults:
        check_campaign(run.campaign)  # reports faults of the raw files, too
        raise
    if run.campaign.has_second:
        second_folder(run.campaign).validated()


def _check_before_photographs(run: CampaignRun, stages: tuple[Stage, ...], settings: RunOptions) -> None:
    """Report faults of other files before photographs are measured, which takes long."""
    slow = [stage for stage in stages if stage.name in OF_PHOTOGRAPHS]
    if any(
        settings.selection.forces(stage, run.order)
        or run.status(stage, run.made_from(stage)).state is not Freshness.FRESH
        for stage in slow
    ):
        check_before_photographs(detached_run(run.campaign))


def _bring_up_to_date(
    run: CampaignRun,
    stages: tuple[Stage, ...],
    settings: RunOptions,
    console: RunConsole,
    k: int,
    *,
    is_first: bool,
) -> bool:
    """Run stage ``k`` of the stages, counted from 1, unless it is fresh; returns True if it ran.

    ``is_first``: no stage before it ran, so that its time predicts that of all.
    """
    stage, number = stages[k - 1], f"{k}/{len(stages)}"
    log = run.folder / _LOG
    with defects_logged(log, f"stage {stage.name}"):
        now = run.made_from(stage)
        status = run.status(stage, now)
        console.detail(f"{stage.name:<12} {number}: {status.state} {status.why}".rstrip())
        if status.state is Freshness.FRESH and not settings.selection.forces(stage, run.order):
            return False
        log.unlink(missing_ok=True)
        if is_first and (words := _expected_time(run, stages, settings, k)):
            console.line(words)
        seconds = run.durations.expected([stage.name])
        expected = "" if seconds is None else f" ({approximate_duration(seconds)})"
        with console.during(f"{number} {stage.name}{expected}") as progress:
            closing = run.execute(stage, now, progress)
        console.line(f"{stage.name:<12} {number}: {closing}")
        return True


def _expected_time(run: CampaignRun, stages: tuple[Stage, ...], settings: RunOptions, k: int) -> str:
    """Time of stage ``k`` and of all later ones that have to run, in words; empty without a like run, or if short."""
    later = stages[k - 1 :]
    behind = {stage.name for stage, status in run.statuses() if status.state is not Freshness.FRESH}
    names = [one.name for one in later if one.name in behind or settings.selection.forces(one, run.order)]
    seconds = run.durations.expected(names)
    if seconds is None or seconds < _WORTH_SAYING_S:
        return ""
    return (
        f"{count_text(len(names), 'stage')} to run: {approximate_duration(seconds)}, as long as they took here before"
    )


def _print_location(run: CampaignRun, console: RunConsole) -> None:
    made = any("report" in entry.artifacts for entry in run.manifest.entries.values())
    console.line(f"report: {run.folder / ARTIFACTS['report'].file}" if made else f"results: {run.folder}")


def _exit_code(run: CampaignRun, stages: tuple[Stage, ...], settings: RunOptions, console: RunConsole) -> ExitCode:
    if not run.is_refused(stages):
        return ExitCode.DONE
    failed = run.failed_checks(stages)
    console.warn(f"QA: {len(failed)} failed ({', '.join(failed)}); the report says why")
    return ExitCode.DONE if settings.accept_failed_checks else ExitCode.FAILED_CHECK


def show_status(path: Path, out: Path | None, console: RunConsole, *, distrust: bool) -> ExitCode:
    """Print one line per stage: fresh, stale and why, or never run. Writes nothing."""
    campaign = usable_campaign(path)
    run = open_run(campaign, run_folder_of(campaign, out, several=False), distrust=distrust)
    check_owner(run)
    for stage, status in run.statuses():
        fact = {"campaign": campaign.name, "stage": stage.name, "state": str(status.state), "why": status.why}
        console.add_fact("stages", fact)
        console.line(f"{stage.name:<12} {status.state:<10} {status.why}".rstrip())
    return ExitCode.DONE


def show_all_stages(console: RunConsole) -> ExitCode:
    """Print the stages of every kind of campaign, with their inputs and artifacts."""
    for kind, names in ORDER.items():
        console.line(f"{kind}:")
        for name in names:
            stage = stage_module(name).DECLARATION
            only = " (only with photographs)" if name in OF_PHOTOGRAPHS else ""
            only = " (only if [diagnosis] judge_on names a second campaign)" if name in OF_SECOND_CAMPAIGNS else only
            read = (*(("raw files",) if name in RAW_READERS else ()), *stage.reads)
            facts = {"kind": kind, "stage": name, "summary": stage.summary, "reads": read, "writes": stage.leaves}
            console.add_fact("stages", facts)
            console.line(f"  {name:<12} {stage.summary}{only}")
            console.line(f"  {'':<12} reads {', '.join(read)}; writes {', '.join(stage.leaves)}")
    return ExitCode.DONE


@dataclass(frozen=True)
class CampaignJob:
    """One campaign to run, its run folder, and the heading of its messages."""

    campaign: CampaignFolder
    folder: Path
    options: RunOptions
    heading: str | None = None


@dataclass
class JobPlan:
    """Jobs for the paths of a call; no two campaigns of a call may share a run folder."""

    out: Path | None
    options: RunOptions
    several: bool
    taken: set[Path] = field(default_factory=set)

    @property
    def shared_folder(self) -> Path:
        """Folder of all run folders of the call."""
        return RUNS if self.out is None else self.out

    def job(self, path: Path) -> CampaignJob:
        """The job for one path; raises CampaignFaults."""
        campaign = usable_campaign(path)
        folder = run_folder_of(campaign, self.out, several=self.several)
        # Some systems ignore capitals and the composition of accents in folder names.
        taken = Path(unicodedata.normalize("NFC", str(folder)).casefold())
        if taken in self.taken:
            expected = "a name that no other campaign of this call has, because it names the run's folder"
            raise CampaignFaults([Fault(str(campaign.file), expected, column="campaign.name", value=campaign.name)])
        self.taken.add(taken)
        refuse_raw_files(campaign, folder)
        return CampaignJob(campaign, folder, self.options, f"{campaign.name} ({path})" if self.several else None)


def run_campaigns(
    paths: Sequence[Path],
    out: Path | None,
    settings: RunOptions,
    console: RunConsole,
    *,
    workforce: Workforce | None = None,
) -> ExitCode:
    """Run campaigns and return the worst exit code; only an interruption of one ends the others.

    Several campaigns leave one table and one page of all.
    """
    plan = JobPlan(out, settings, several=len(paths) > 1)
    code = end_all([partial(_run_paths, paths, plan, workforce or Workforce(), console)], console)
    console.line(f"exit code {code:d}: {code.meaning}")
    console.close(code)
    return code


def _run_paths(paths: Sequence[Path], plan: JobPlan, workforce: Workforce, console: RunConsole) -> ExitCode:
    """Run campaigns in turn or in parallel, then write table and page of all if there are several."""
    if plan.several:
        check_shared_folder(plan.shared_folder)
        console.line(f"{len(paths)} campaigns: {workforce}{_HINT if workforce.is_alone else ''}")
    if workforce.is_alone or (not plan.several and workforce.scheduler is None):
        plan.options = replace(plan.options, workers=workforce.workers or processors())
        ends = [(path, _run_in_process(path, plan, console)) for path in paths]
    else:
        ends = list(zip(paths, _run_at_a_time(paths, plan, workforce, console), strict=True))
    if plan.several:
        table, page = write_all_campaigns(plan.shared_folder, ends)
        console.add_fact("all_campaigns", {"table": str(table), "page": str(page)})
        console.line(f"all campaigns: {page}, {table}")
    return gravest([outcome.code for _, outcome in ends])


def _run_in_process(path: Path, plan: JobPlan, console: RunConsole) -> CampaignOutcome:
    return outcome_of(lambda witness: _run(plan.job(path), witness), Witness(console))


def _run(job: CampaignJob, console: RunConsole) -> ExitCode:
    if job.heading is not None:
        console.line(job.heading)
    return run_campaign(job.campaign, job.folder, job.options, console)


def _run_at_a_time(
    paths: Sequence[Path], plan: JobPlan, workforce: Workforce, console: RunConsole
) -> Iterator[CampaignOutcome]:
    """Run several campaigns in parallel, with messages grouped in the order of the call."""
    planned = [_planned(path, plan, workforce) for path in paths]
    jobs = [job for job in planned if isinstance(job, CampaignJob)]
    with console.during("run") as watched:
        outcomes = results(run_job, jobs, workforce, _lost_outcome, lambda done: watched(done, len(jobs), "campaigns"))
        with closing(outcomes):
            for entry in planned:
                ending = next(outcomes) if isinstance(entry, CampaignJob) else entry
                ending.repeat(console)
                yield ending


def _planned(path: Path, plan: JobPlan, workforce: Workforce) -> CampaignJob | CampaignOutcome:
    """The job for one path, or the reason why there is none."""
    jobs: list[CampaignJob] = []

    def prepare(recorder: Recorder) -> ExitCode:
        job = plan.job(path)
        jobs.append(job if workforce.scheduler is None else _for_other_machines(job))
        return ExitCode.DONE

    outcome = outcome_of(prepare, Recorder())
    return jobs[0] if jobs else outcome


def _for_other_machines(job: CampaignJob) -> CampaignJob:
    """The same job with paths that are valid on other machines with shared folders."""
    campaign = replace(job.campaign, file=job.campaign.file.resolve())
    return replace(job, campaign=campaign, folder=job.folder.resolve())


def run_job(job: CampaignJob) -> CampaignOutcome:
    """Run the campaign in a worker, and collect its messages."""
    return outcome_of(lambda recorder: _run(job, recorder), Recorder(verbose=job.options.verbose))


def _lost_outcome(job: CampaignJob) -> CampaignOutcome:
    why = f"{job.campaign.name}: its worker was lost (killed, or out of memory); {KEPT}"
    return CampaignOutcome(ExitCode.ENVIRONMENT, ((True, why),))
