"""`truing power`: which effects a campaign's own layout would show, and from which size; of photographs in theory."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.pipeline.artifacts import table_of
from truing.pipeline.campaign_folder import CampaignFolder, run_folder_of
from truing.pipeline.console import RunConsole
from truing.pipeline.executor import Workforce, results
from truing.pipeline.given_files import check_file, leave_tables
from truing.pipeline.in_memory import bench_tables, call_stage
from truing.pipeline.problems import EnvironmentProblem, ExitCode, Interrupted
from truing.pipeline.run_campaign import usable_campaign
from truing.pipeline.run_owner import folder_next_to_run, note_owner
from truing.report.diagnosis.detectable_sizes import size_words
from truing.report.diagnosis.findings import subject_words
from truing.report.power_page import (
    SIZE_HEADS,
    alarm_words,
    power_head,
    power_sections,
    section_of_photographs,
    size_rows,
)
from truing.report.rendering.render import render_page
from truing.report.tables import cell
from truing.report.wordings.catalogue import cause_words
from truing.schemas.campaign import Campaign
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.catalogue import catalogue_of_photographed_points, catalogue_of_rays
from truing.simulation.cause import Cause, Effect
from truing.simulation.detection_trials import (
    Answer,
    DetectionQuestion,
    Trial,
    answer,
    curve,
    false_alarms,
    questions,
    trials,
)
from truing.stages import power
from truing.stages.common.missing_data import NO_DRAWING
from truing.stages.diagnosis.ray_points import assemble_rays
from truing.stages.diagnosis.rows import DetectionAdvice, diagnosis_table
from truing.stages.diagnosis.search import (
    assembled_data,
    decided,
    decided_of_rays,
    kinds_of,
    rule_of,
    rule_of_rays,
    searched_for,
)
from truing.stages.ingestion.tables import read_configurations, read_survey
from truing.stages.power import compared, completed, expected_sights, reading_plan_of, searched_causes
from truing.stages.simulated_campaigns.plan import NEEDS, RayPlan, bare_plan
from truing.stages.simulated_campaigns.tables import rates_table, sizes_table

if TYPE_CHECKING:
    from truing.stages.power import Plan

# So many campaigns without an effect per campaign of each size with one.
_NOTHING_PER_DRAW = 5
_DEFAULT_FILE = "power.parquet"
_SURVEY = "the survey of the targets, or their planned places"

HEADS = ("cause that photographs show", "concerns", "theory, in the run")
_DRAWN = (
    "Points come from photographs, and photographs are not drawn: points scatter by noise.point_mm each, every "
    "surveyed target counts as seen in every pose, and no error of a camera or of a scale bar is shared among points. "
)
_ASKED = " With their names after --causes, rays are drawn from the run's network, and these looked for."


@dataclass(frozen=True)
class PowerOptions:
    """What the caller asked for: causes (all where none is named), draws per size, share of gross errors, seed."""

    causes: tuple[str, ...] = ()
    draws: int = 4
    gross: float = 0.0
    seed: int = 0


def power_campaign(place: Path, options: PowerOptions, workforce: Workforce, out: Path | None) -> ExitCode:
    """Tell what a campaign's layout would show, and leave tables and a page. Raises CampaignFaults."""
    console, campaign = RunConsole(quiet=False), usable_campaign(place)
    settings = campaign.validated()
    of_rays = asks_for_ray_causes(options.causes, campaign)
    check_file(out, campaign=campaign)
    if not of_rays:
        check_causes(options.causes, settings)
    reads_run = out is None or campaign.has_photographs
    run = folder_next_to_run(campaign) if reads_run else run_folder_of(campaign, None, several=False)
    beside = ray_power_sentence(run) if of_rays else of_photographs(campaign, run)
    file = run / _DEFAULT_FILE if out is None else out
    with console.during("power") as progress:
        progress(0, 2, "steps: the campaign's layout")
        plan = _plan(campaign, settings, options, run if of_rays else None)
        progress(1, 2, "steps: what theory expects")
        asked = _questions(campaign, plan, settings, options)
    answers: list[Answer] = []
    try:
        for given in _answers(plan, settings, asked, options, workforce, console):
            answers.append(given)
    except Interrupted:
        if answers:
            _report(campaign, asked, answers, (file, beside), console)  # hours may lie behind them
        raise
    _report(campaign, asked, answers, (file, beside), console)
    return ExitCode.DONE


def check_causes(names: Sequence[str], settings: Campaign) -> None:
    """Raise CampaignFaults for names that are no causes of this kind of campaign."""
    known = [kind.id for kind in searched_for(settings, kinds_of(settings).values()) if kind.catalogued]
    strange = [name for name in names if name not in known]
    if strange:
        raise CampaignFaults(Fault("--causes", f"of {', '.join(known)}", value=name) for name in strange)


def _plan(campaign: CampaignFolder, settings: Campaign, options: PowerOptions, run: Path | None = None) -> Plan:
    """The campaign as a plan, from what was measured or from survey and configurations alone; of its rays, from what a
    run left of them. Raises CampaignFaults."""
    if run is not None:
        with _to_be_drawn(campaign):
            return plan_of_rays(run, settings).with_gross(options.gross)
    tables = _tables(campaign, settings)
    with _to_be_drawn(campaign):
        if settings.campaign.kind == "interferometer":
            return reading_plan_of(tables, settings).with_gross(options.gross)
        bare = bare_plan(tables, settings)
        drawn = (
            {**tables} if bare.was_measured else _posed(bare.drawn((), np.random.default_rng(options.seed)), settings)
        )
        plan = completed(bare, assembled_data(drawn, settings), drawn["poses"])
    return plan.with_gross(options.gross)


@contextmanager
def _to_be_drawn(campaign: CampaignFolder) -> Iterator[None]:
    """Whatever prevents drawing or diagnosing a campaign of this layout as a fault of the campaign."""
    try:
        yield
    except ValueError as why:
        raise CampaignFaults([Fault(str(campaign.file), f"a campaign that can be drawn again: {why}")]) from None


def _tables(campaign: CampaignFolder, settings: Campaign) -> dict[str, pa.Table]:
    """Survey and configurations and, where there are points, observations and poses; raises CampaignFaults."""
    if settings.campaign.kind == "interferometer":
        return bench_tables(campaign, settings)[0]
    if not settings.mechanism.is_legged:
        expected = "a mechanism of legs, whose points can be simulated (bodies without one cannot be drawn yet)"
        expected += NO_DRAWING.get(settings.mechanism.type, "")
        fault = Fault(str(campaign.file), expected, column="mechanism.type", value=settings.mechanism.type)
        raise CampaignFaults([fault])
    source = CampaignFiles(campaign.folder, settings)
    if not source.entries("points"):
        return _planning_tables(source, settings)
    made = dict(call_stage("ingest", {}, settings, source).artifacts)
    if "survey" not in made:
        raise CampaignFaults([Fault("targets.csv", _SURVEY)])
    return made if "observations" not in made else _posed(made, settings)


def _planning_tables(source: Any, settings: Campaign) -> dict[str, pa.Table]:
    log = FaultLog()
    survey, configurations = read_survey(source, settings, log), read_configurations(source, settings, log)
    log.throw()
    if survey is None:
        raise CampaignFaults([Fault("targets.csv", _SURVEY)])
    return {"survey": survey.table, "configurations": configurations.table}


def _posed(tables: Mapping[str, pa.Table], settings: Campaign) -> dict[str, pa.Table]:
    return {**tables, **call_stage("pose", tables, settings).artifacts}


def _drawn(plan: Plan, effects: Sequence[Effect], seed: Any, settings: Campaign) -> dict[str, pa.Table]:
    """The tables of a drawn campaign, taken through the stages before the diagnosis."""
    tables = plan.drawn(effects, np.random.default_rng(seed))
    for name in plan.through:
        tables = {**tables, **call_stage(name, tables, settings).artifacts}
    return tables


def _questions(
    campaign: CampaignFolder, plan: Plan, settings: Campaign, options: PowerOptions
) -> list[DetectionQuestion]:
    """What is asked, with what theory expects of it, from a campaign that is drawn without any effect.

    Raises CampaignFaults where such a campaign could not be diagnosed.
    """
    drawn = _drawn(plan, (), options.seed, settings)
    with _to_be_drawn(campaign):
        data = compared(plan, drawn, settings)
    seen = expected_sights(plan, data, settings)
    return questions(plan, seen, options.causes, searched_causes(plan, settings)[0].values())


def _answers(
    plan: Plan,
    settings: Campaign,
    asked: Sequence[DetectionQuestion],
    options: PowerOptions,
    workforce: Workforce,
    console: RunConsole,
) -> Generator[Answer]:
    """Draw and diagnose all campaigns, wherever that is done; the same answers everywhere."""
    pieces = trials(asked, plan, options.draws, _NOTHING_PER_DRAW * options.draws, options.seed)
    work = partial(diagnosed_trial, plan, settings)
    with console.during("power") as progress:
        reported = results(work, pieces, workforce, _lost, lambda done: progress(done, len(pieces), "campaigns"))
        with closing(reported):
            yield from reported


def diagnosed_trial(plan: Plan, settings: Campaign, trial: Trial) -> Answer:
    """Draw one campaign, push it through the stages that lead to a diagnosis, and read off what that says."""
    judge = _diagnosed_rays if isinstance(plan, RayPlan) else diagnosed
    return judge(_drawn(plan, trial.effects, trial.seed, settings), settings, trial)


def diagnosed(tables: Mapping[str, pa.Table], settings: Campaign, trial: Trial) -> Answer:
    """What the diagnosis of a drawn campaign's tables, up to the poses, says of what was hidden in it."""
    try:
        data = assembled_data(tables, settings)
        diagnosis = decided(data, settings, lambda *_: None)
    except (ValueError, np.linalg.LinAlgError):  # the stage says then that it was not evaluated
        return answer(trial, ())
    table = diagnosis_table(diagnosis, DetectionAdvice(shown=data.shown), settings.diagnosis.false_alarm)
    return answer(trial, table.to_pylist())


def _diagnosed_rays(tables: Mapping[str, pa.Table], settings: Campaign, trial: Trial) -> Answer:
    """What the diagnosis of a drawn campaign's rays says of what was hidden in them."""
    rule = rule_of(settings)
    data, _ = assemble_rays(tables, settings)
    diagnosis = decided_of_rays(data, settings, lambda *_: None)
    table = diagnosis_table(diagnosis, DetectionAdvice(shown=data.shown), rule_of_rays(rule).noise_level)
    return answer(trial, table.to_pylist())


def _lost(trial: Trial) -> Answer:
    raise EnvironmentProblem(f"no worker survives the campaign drawn from seed {trial.seed}: not enough memory?")


def _report(
    campaign: CampaignFolder,
    asked: Sequence[DetectionQuestion],
    answers: Sequence[Answer],
    out: tuple[Path, PhotographNote | None],
    console: RunConsole,
) -> None:
    """Say and leave what was found, and what an ``out`` beside the file says of photographs."""
    file, photographs = out
    if file == run_folder_of(campaign, None, several=False) / _DEFAULT_FILE:
        note_owner(campaign, file.parent)
    curves = [curve(question, place, answers) for place, question in enumerate(asked)]
    sizes, rates = sizes_table(curves), rates_table(curves, false_alarms(answers))
    text, drawn = sizes.to_pandas(), rates.to_pandas()
    console.show(SIZE_HEADS, size_rows(text))
    if alarm_words(drawn):
        console.line(alarm_words(drawn))
    if photographs is not None:
        if photographs.rows:
            console.show(HEADS, photographs.rows)
        console.line(photographs.sentence)
    further = [] if photographs is None else [section_of_photographs(photographs.sentence, HEADS, photographs.rows)]
    page = render_page(power_head(campaign.name, text, drawn), [*power_sections(text, drawn), *further])
    written = leave_tables(file, {"": sizes, "-rates": rates}, page)
    console.line(f"tables and page: {', '.join(map(str, written))}")


@dataclass(frozen=True)
class PhotographNote:
    """The sentence that says what is not judged, and what the run tells of that: cause, subject, size in words."""

    sentence: str
    rows: tuple[tuple[str, ...], ...] = ()


def of_photographs(campaign: CampaignFolder, run: Path) -> PhotographNote | None:
    """What the run in a folder tells of causes that are not drawn; None where no point comes from photographs."""
    if not campaign.has_photographs:
        return None
    catalogues: tuple[Mapping[str, Cause], ...] = (catalogue_of_rays(), catalogue_of_photographed_points())
    names = list(dict.fromkeys(name for own in catalogues for name, kind in own.items() if kind.catalogued))
    listed = f"{', '.join(map(cause_words, names[:-1]))} and {cause_words(names[-1])}"
    table = table_of(run, "detectable")
    own = None if table is None else table.to_pandas().query("cause in @names")
    if own is None or not len(own):
        why = f"{listed.capitalize()} are not judged here: `truing run` tells from which size on they would be found."
        return PhotographNote(_DRAWN + why)
    what = f"{listed.capitalize()} are not drawn either: what the run in {run.as_posix()} would have shown of them, "
    return PhotographNote(_DRAWN + what + "with a probability of 80 %, is told by theory alone." + _ASKED, _rows(own))


def _rows(own: pd.DataFrame) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (cause_words(str(row.cause)), subject_words(cell(row.subject)) or "the whole", f"{row.parameter} {size}")
        for row, size in zip(own.itertuples(), size_words(own), strict=True)
    )


def asks_for_ray_causes(causes: Sequence[str], campaign: CampaignFolder) -> bool:
    """Whether causes are asked for that rays show; raises CampaignFaults where others are asked for beside them."""
    if not campaign.has_photographs:
        return False
    known = _names_of_rays()
    own = [name for name in causes if name in known]
    others = [name for name in causes if name not in known]
    if own and others:
        expected = f"causes that rays show ({', '.join(known)}) in a call of their own"
        raise CampaignFaults([Fault("--causes", expected, value=", ".join(others))])
    return bool(own)


def _names_of_rays() -> list[str]:
    """The ids of the causes that rays show."""
    return [name for name, kind in catalogue_of_rays().items() if kind.catalogued]


def plan_of_rays(run: Path, settings: Campaign) -> RayPlan:
    """The network of the run in a folder; raises CampaignFaults where it has left none."""
    tables = {name: table for name in NEEDS if (table := table_of(run, name)) is not None}
    try:
        return power.ray_plan_of(tables, settings)
    except ValueError as why:
        expected = f"a run of the campaign, from whose network rays can be drawn ({why}): truing run"
        raise CampaignFaults([Fault(run.as_posix(), expected)]) from None


def ray_power_sentence(run: Path) -> PhotographNote:
    """The sentence that says what is drawn."""
    return PhotographNote(
        f"Rays are drawn, not photographs: with the network, the noise and the cameras of the run in {run.as_posix()}, "
        "as small departures from these. What an effect does to the machine's points is not looked at."
    )
