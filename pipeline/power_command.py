"""`truing power`: detectable effects of a campaign's layout, and their smallest sizes; for photographs by theory."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

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
from truing.pipeline.in_memory import axis_tables, bench_tables, call_stage, chain_tables
from truing.pipeline.problems import EnvironmentProblem, ExitCode, Interrupted
from truing.pipeline.run_campaign import usable_campaign
from truing.pipeline.run_owner import folder_next_to_run, note_owner
from truing.report.chain_study_page import chain_requirement_words
from truing.report.diagnosis.detectable_sizes import size_words
from truing.report.diagnosis.findings import subject_words
from truing.report.glossary_section import with_reference
from truing.report.numbers import count_text
from truing.report.power_page import (
    PHOTOGRAPH_HEADS,
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
from truing.schemas.near_names import did_you_mean
from truing.simulation.catalogue import catalogue_of_photographed_points, catalogue_of_rays
from truing.simulation.cause import Cause, Effect
from truing.simulation.detection_trials import (
    Answer,
    DetectionQuestion,
    Trial,
    curve,
    false_alarms,
    questions,
    trial_answer,
    trials,
)
from truing.stages import power
from truing.stages.diagnosis.ray_points import assemble_rays
from truing.stages.diagnosis.rows import DetectionAdvice, diagnosis_table
from truing.stages.diagnosis.search import (
    assembled_data,
    decided_of_rays,
    kinds_of,
    rule_of,
    rule_of_rays,
    search_causes,
    searched_for,
)
from truing.stages.ingestion.tables import read_configurations, read_survey
from truing.stages.power import (
    axis_plan_of,
    chain_plan_of,
    complete_plan,
    diagnosis_data_of,
    expected_sights,
    reading_plan_of,
    searched_causes,
)
from truing.stages.simulated_campaigns.plan import NEEDS, RayPlan, bare_plan
from truing.stages.simulated_campaigns.tables import rates_table, sizes_table

if TYPE_CHECKING:
    from truing.stages.power import Plan

# Campaigns without an effect, per campaign of each size with one.
_NOTHING_PER_DRAW = 5
_DEFAULT_FILE = "power.parquet"
_SURVEY = "the survey of the targets, or their planned places"

_DRAWN = (
    "Points come from photographs, but photographs are not simulated: each point has the noise noise.point_mm, every "
    "surveyed target is seen in every pose, and points share no error of a camera or of a scale bar. "
)
_ASKED = " With their names after --causes, rays of the run's network are simulated and searched for these causes."


@dataclass(frozen=True)
class PowerOptions:
    """Options of the call: causes (all if none is named), draws per size, share of gross errors, seed."""

    causes: tuple[str, ...] = ()
    draws: int = 4
    gross: float = 0.0
    seed: int = 0


def power_campaign(
    path: Path, options: PowerOptions, workforce: Workforce, out: Path | None, console: RunConsole
) -> ExitCode:
    """Report the detectable effects of a campaign's layout, and write tables and a page. Raises CampaignFaults."""
    campaign = usable_campaign(path)
    settings = campaign.validated()
    of_rays = asks_for_ray_causes(options.causes, campaign)
    check_file(out, campaign=campaign)
    if not of_rays:
        check_causes(options.causes, settings)
    reads_run = out is None or campaign.has_photographs
    run = folder_next_to_run(campaign) if reads_run else run_folder_of(campaign, None, several=False)
    photographs = ray_power_sentence(run) if of_rays else of_photographs(campaign, run)
    file = run / _DEFAULT_FILE if out is None else out
    with console.during("power") as progress:
        progress(0, 2, "steps: the campaign's layout")
        plan = _plan(campaign, settings, options, run if of_rays else None)
        progress(1, 2, "steps: what theory expects")
        asked = _questions(campaign, plan, settings, options)
    pieces = trials(asked, plan, options.draws, _NOTHING_PER_DRAW * options.draws, options.seed)
    if pieces:
        _show_theory(asked, len(pieces), console)
        if not file.exists():  # results of an earlier call are worth more until a round is complete
            console.line(f"first page: {_write_results(campaign, asked, (), file, photographs)[-1]}")
    answers: list[Answer] = []
    try:
        for given in _trial_answers(plan, settings, pieces, workforce, console):
            answers.append(given)
            if (done := _rounds(len(answers), len(pieces), options.draws)) and len(answers) < len(pieces):
                written = _write_results(campaign, asked, answers, file, photographs)
                console.line(f"after {done} of {count_text(options.draws, 'draw')}: {written[-1]}")
    except Interrupted:
        if answers:
            _report(campaign, asked, answers, file, photographs, console)  # computed over hours, perhaps
        raise
    _report(campaign, asked, answers, file, photographs, console)
    return ExitCode.DONE


def _show_theory(asked: Sequence[DetectionQuestion], simulated: int, console: RunConsole) -> None:
    """Print what theory expects, which is known within seconds, before campaigns are simulated."""
    sizes = sizes_table([curve(question, index, []) for index, question in enumerate(asked)])
    console.show(SIZE_HEADS, size_rows(sizes.to_pandas()))
    console.line(f"By theory alone; {count_text(simulated, 'simulated campaign')} follow.")


def _rounds(answers: int, pieces: int, draws: int) -> int:
    """Number of complete rounds, each with one draw of every size; 0 within a round."""
    done, within = divmod(answers * draws, pieces)
    return done if within == 0 else 0


def check_causes(names: Sequence[str], settings: Campaign) -> None:
    """Raise CampaignFaults for unknown causes of this kind of campaign."""
    known = [kind.id for kind in searched_for(settings, kinds_of(settings).values()) if kind.catalogued]
    unknown = [name for name in names if name not in known]
    if unknown:
        known_text = ", ".join(known)
        raise CampaignFaults(
            Fault("--causes", f"one of {known_text}{did_you_mean(name, known)}", value=name) for name in unknown
        )


def _plan(campaign: CampaignFolder, settings: Campaign, options: PowerOptions, run: Path | None = None) -> Plan:
    """The campaign as a plan, from measurements or from survey and configurations; for rays, from the artifacts of a
    run.

    Raises CampaignFaults.
    """
    if run is not None:
        with _to_be_drawn(campaign):
            return plan_of_rays(run, settings).with_gross(options.gross)
    tables = _tables(campaign, settings)
    with _to_be_drawn(campaign):
        if settings.campaign.kind == "interferometer":
            return reading_plan_of(tables, settings).with_gross(options.gross)
        if settings.mechanism.type == "chain":
            return chain_plan_of(tables, settings).with_gross(options.gross)
        if settings.mechanism.type == "axis":
            return axis_plan_of(tables, settings).with_gross(options.gross)
        bare = bare_plan(tables, settings)
        drawn = (
            {**tables} if bare.was_measured else _posed(bare.drawn((), np.random.default_rng(options.seed)), settings)
        )
        plan = complete_plan(bare, assembled_data(drawn, settings), drawn["poses"])
    return plan.with_gross(options.gross)


@contextmanager
def _to_be_drawn(campaign: CampaignFolder) -> Iterator[None]:
    """Report any error of simulating or diagnosing this layout as a fault of the campaign."""
    try:
        yield
    except ValueError as why:
        raise CampaignFaults([Fault(str(campaign.file), f"a campaign that can be simulated: {why}")]) from None


def _tables(campaign: CampaignFolder, settings: Campaign) -> dict[str, pa.Table]:
    """Survey and configurations and, if there are points, observations and poses; raises CampaignFaults."""
    if settings.campaign.kind == "interferometer":
        return bench_tables(campaign, settings)[0]
    if settings.mechanism.type == "axis":
        return axis_tables(campaign, settings)
    if settings.mechanism.type == "chain":
        tables = chain_tables(campaign, settings)
        if "configurations" not in tables:
            raise CampaignFaults([Fault("configurations.csv", "planned poses; `truing design` chooses some")])
        return tables
    if not settings.mechanism.is_legged:
        expected = (
            "a mechanism of legs, whose points can be simulated (bodies without a mechanism are not supported yet)"
        )
        fault = Fault(str(campaign.file), expected, column="mechanism.type", value=settings.mechanism.type)
        raise CampaignFaults([fault])
    source = CampaignFiles(campaign.folder, settings)
    if not source.entries("points"):
        return _planning_tables(source, settings)
    made = dict(call_stage("ingest", {}, settings, source).artifacts)
    if "survey" not in made:
        raise CampaignFaults([Fault("targets.csv", _SURVEY)])
    return made if "observations" not in made else _posed(made, settings)


def _planning_tables(source: CampaignFiles, settings: Campaign) -> dict[str, pa.Table]:
    log = FaultLog()
    survey, configurations = read_survey(source, settings, log), read_configurations(source, settings, log)
    log.raise_faults()
    if survey is None:
        raise CampaignFaults([Fault("targets.csv", _SURVEY)])
    return {"survey": survey.table, "configurations": configurations.table}


def _posed(tables: Mapping[str, pa.Table], settings: Campaign) -> dict[str, pa.Table]:
    return {**tables, **call_stage("pose", tables, settings).artifacts}


def _drawn(
    plan: Plan, effects: Sequence[Effect], seed: int | tuple[int, ...], settings: Campaign
) -> dict[str, pa.Table]:
    """Tables of a simulated campaign, after the stages before the diagnosis."""
    tables = plan.drawn(effects, np.random.default_rng(seed))
    for name in plan.through:
        tables = {**tables, **call_stage(name, tables, settings).artifacts}
    return tables


def _questions(
    campaign: CampaignFolder, plan: Plan, settings: Campaign, options: PowerOptions
) -> list[DetectionQuestion]:
    """Questions with their theoretical expectations, from a campaign simulated without any effect.

    Raises CampaignFaults if such a campaign cannot be diagnosed.
    """
    drawn = _drawn(plan, (), options.seed, settings)
    with _to_be_drawn(campaign):
        data = diagnosis_data_of(plan, drawn, settings)
    seen = expected_sights(plan, data, settings)
    return questions(plan, seen, options.causes, searched_causes(plan, settings)[0].values())


def _trial_answers(
    plan: Plan,
    settings: Campaign,
    pieces: Sequence[Trial],
    workforce: Workforce,
    console: RunConsole,
) -> Generator[Answer]:
    """Simulate and diagnose all campaigns; the answers do not depend on the workers."""
    work = partial(diagnosed_trial, plan, settings)
    with console.during("power") as progress:
        reported = results(
            work, pieces, workforce, _raise_lost_worker, lambda done: progress(done, len(pieces), "campaigns")
        )
        with closing(reported):
            yield from reported


def diagnosed_trial(plan: Plan, settings: Campaign, trial: Trial) -> Answer:
    """Simulate one campaign, run the stages up to the diagnosis, and read its result."""
    judge = _diagnosed_rays if isinstance(plan, RayPlan) else diagnosed
    return judge(_drawn(plan, trial.effects, trial.seed, settings), settings, trial)


def diagnosed(tables: Mapping[str, pa.Table], settings: Campaign, trial: Trial) -> Answer:
    """Diagnosis of a simulated campaign's tables, compared with the hidden effect."""
    try:
        data = assembled_data(tables, settings)
        diagnosis = search_causes(data, settings, lambda *_: None)
    except (ValueError, np.linalg.LinAlgError):  # the stage then reports that it was not evaluated
        return trial_answer(trial, ())
    table = diagnosis_table(diagnosis, DetectionAdvice(shown=data.shown), settings.diagnosis.false_alarm)
    return trial_answer(trial, table.to_pylist())


def _diagnosed_rays(tables: Mapping[str, pa.Table], settings: Campaign, trial: Trial) -> Answer:
    """Diagnosis of a simulated campaign's rays, compared with the hidden effect."""
    rule = rule_of(settings)
    data, _ = assemble_rays(tables, settings)
    diagnosis = decided_of_rays(data, settings, lambda *_: None)
    table = diagnosis_table(diagnosis, DetectionAdvice(shown=data.shown), rule_of_rays(rule).noise_level)
    return trial_answer(trial, table.to_pylist())


def _raise_lost_worker(trial: Trial) -> Answer:
    raise EnvironmentProblem(f"every worker ended on the campaign of seed {trial.seed}: not enough memory?")


def _report(
    campaign: CampaignFolder,
    asked: Sequence[DetectionQuestion],
    answers: Sequence[Answer],
    file: Path,
    photographs: PhotographNote | None,
    console: RunConsole,
) -> None:
    """Print and write the results, with a note on photographs."""
    sizes, rates = _as_tables(asked, answers)
    console.show(SIZE_HEADS, size_rows(sizes.to_pandas()))
    for name, table in (("sizes", sizes), ("rates", rates)):
        for row in table.to_pylist():
            console.add_fact(name, row)
    if alarms := alarm_words(rates.to_pandas()):
        console.sentence(alarms)
    if photographs is not None:
        if photographs.rows:
            console.show(PHOTOGRAPH_HEADS, photographs.rows)
        console.sentence(photographs.sentence)
    for sentence in _requirements(campaign):
        console.sentence(sentence)
    written = _write_results(campaign, asked, answers, file, photographs)
    console.written(f"tables and page: {', '.join(map(str, written))}", written)


def _requirements(campaign: CampaignFolder) -> list[str]:
    """Sentences on the requirements of a chain, by the layout's own poses; none for other machines."""
    settings = campaign.validated()
    if settings.mechanism.type != "chain":
        return []
    from truing.stages.chain_studies import chain_requirement_table

    return chain_requirement_words(chain_requirement_table(settings, chain_tables(campaign, settings)).to_pandas())


def _as_tables(asked: Sequence[DetectionQuestion], answers: Sequence[Answer]) -> tuple[pa.Table, pa.Table]:
    """Detectable sizes and detection rates."""
    curves = [curve(question, index, answers) for index, question in enumerate(asked)]
    return sizes_table(curves), rates_table(curves, false_alarms(answers))


def _write_results(
    campaign: CampaignFolder,
    asked: Sequence[DetectionQuestion],
    answers: Sequence[Answer],
    file: Path,
    photographs: PhotographNote | None,
) -> list[Path]:
    """Write tables and page; returns their files."""
    if file == run_folder_of(campaign, None, several=False) / _DEFAULT_FILE:
        note_owner(campaign, file.parent)
    sizes, rates = _as_tables(asked, answers)
    text, drawn = sizes.to_pandas(), rates.to_pandas()
    further = [] if photographs is None else [section_of_photographs(photographs.sentence, photographs.rows)]
    sections = with_reference([*power_sections(text, drawn), *further])
    page = render_page(power_head(campaign.name, text, drawn), sections)
    return leave_tables(file, {"": sizes, "-rates": rates}, page)


@dataclass(frozen=True)
class PhotographNote:
    """A sentence on causes that are not simulated, and rows on them from the run: cause, subject, size in words."""

    sentence: str
    rows: tuple[tuple[str, ...], ...] = ()


def of_photographs(campaign: CampaignFolder, run: Path) -> PhotographNote | None:
    """Note on causes of photographs that are not simulated; None if no point comes from photographs."""
    if not campaign.has_photographs:
        return None
    catalogues: tuple[Mapping[str, Cause], ...] = (catalogue_of_rays(), catalogue_of_photographed_points())
    names = list(dict.fromkeys(name for catalogue in catalogues for name, kind in catalogue.items() if kind.catalogued))
    cause_text = f"{', '.join(map(cause_words, names[:-1]))} and {cause_words(names[-1])}"
    table = table_of(run, "detectable")
    sizes = None if table is None else table.to_pandas().query("cause in @names")
    if sizes is None or not len(sizes):
        why = f"{cause_text.capitalize()} are not tested here: `truing run` gives their detectable sizes."
        return PhotographNote(_DRAWN + why)
    reason = (
        f"{cause_text.capitalize()} are not simulated either: the sizes that the run in {run.as_posix()} would show "
    )
    return PhotographNote(
        _DRAWN + reason + "with a probability of 80 % follow from theory alone." + _ASKED, _rows(sizes)
    )


def _rows(table: pd.DataFrame) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (cause_words(str(row.cause)), subject_words(cell(row.subject)) or "the whole", f"{row.parameter} {size}")
        for row, size in zip(table.itertuples(), size_words(table), strict=True)
    )


def asks_for_ray_causes(causes: Sequence[str], campaign: CampaignFolder) -> bool:
    """True if the causes are those that rays show; raises CampaignFaults for a mixture with others."""
    if not campaign.has_photographs:
        return False
    known = _names_of_rays()
    known_causes = [name for name in causes if name in known]
    ray_causes = [name for name in causes if name not in known]
    if known_causes and ray_causes:
        expected = f"causes that rays show ({', '.join(known)}) in a call of their own"
        raise CampaignFaults([Fault("--causes", expected, value=", ".join(ray_causes))])
    return bool(known_causes)


def _names_of_rays() -> list[str]:
    """Ids of the causes that rays show."""
    return [name for name, kind in catalogue_of_rays().items() if kind.catalogued]


def plan_of_rays(run: Path, settings: Campaign) -> RayPlan:
    """Network of the run in a folder; raises CampaignFaults if it has none."""
    tables = {name: table for name in NEEDS if (table := table_of(run, name)) is not None}
    try:
        return power.ray_plan_of(tables, settings)
    except ValueError as why:
        expected = f"a run of the campaign with a network of rays ({why}): truing run"
        raise CampaignFaults([Fault(run.as_posix(), expected)]) from None


def ray_power_sentence(run: Path) -> PhotographNote:
    """Note on the simulation of rays."""
    return PhotographNote(
        f"Rays are simulated, not photographs, with the network, noise and cameras of the run in {run.as_posix()}, "
        "linearised about it. Effects on the machine's points are not included."
    )
