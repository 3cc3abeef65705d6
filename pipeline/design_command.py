"""`truing design`: choice of configurations, with or without existing measurements."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import CampaignFolder, open_campaign
from truing.pipeline.console import RunConsole
from truing.pipeline.given_files import check_file, read_given, table_bytes
from truing.pipeline.in_memory import axis_tables, bench_tables, chain_tables
from truing.pipeline.problems import ExitCode
from truing.report.numbers import count_text
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.axis_design import design_axis
from truing.stages.cause_loads import loads_for_causes
from truing.stages.chain_design import design_chain
from truing.stages.common.chain_candidates import Forbids
from truing.stages.configurations.axis_targets import AxisDesignTables, words_of_axis
from truing.stages.configurations.chain_poses import ChainDesignTables, words_of_chain
from truing.stages.configurations.chosen import DesignOptions, DesignTables
from truing.stages.configurations.design_sentences import design_lines, load_lines
from truing.stages.design import design
from truing.stages.ingestion.loading_tables import TABLES, read_loading_tables
from truing.stages.ingestion.tables import read_configurations, read_survey
from truing.stages.load_design import plan_loads

# How --avoid names a function instead of a file.
_FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


@dataclass(frozen=True)
class DesignFiles:
    """Files named in the call, each of which may be absent."""

    extend: Path | None = None
    avoid: Path | None = None
    out: Path | None = None


def design_campaign(path: Path, options: DesignOptions, files: DesignFiles, console: RunConsole) -> ExitCode:
    """Choose configurations, print their quality, and write them to a file or stdout. Raises CampaignFaults."""
    campaign = open_campaign(path)
    check_file(files.out, reads=(files.extend, files.avoid), campaign=campaign)
    if campaign.validated().campaign.kind == "interferometer":
        return (_loads_for_causes if options.causes else _plan_loads)(campaign, options, files, console)
    if campaign.validated().mechanism.type == "chain":
        return _design_chain(campaign, options, files, console)
    if campaign.validated().mechanism.type == "axis":
        return _design_axis(campaign, options, files, console)
    if options.causes:
        raise CampaignFaults([Fault("--causes", "no causes for poses: `truing run` leaves next_poses.parquet")])
    chosen = design(campaign.validated(), options, design_tables(campaign, files))
    _report_plan(design_lines(chosen), chosen.table, files.out, console, noun="pose")
    return ExitCode.DONE


def _design_chain(
    campaign: CampaignFolder, options: DesignOptions, files: DesignFiles, console: RunConsole
) -> ExitCode:
    """Choose poses of a chain; next to the plan, tables of what its poses show. Raises CampaignFaults."""
    tables = tables_of_chain(campaign, files)
    chain_design = design_chain(campaign.validated(), options, tables)
    sentences, then = words_of_chain(chain_design), "; add time_s when measuring"
    _report_plan(sentences, chain_design.table, files.out, console, noun="pose", then=then)
    if files.out is not None:
        shown = {"own": chain_design.own, "plan": chain_design.plan}
        visible_tables = {poses: visible for poses, visible in shown.items() if visible is not None}
        _write_shown(
            {poses: visible.numbers for poses, visible in visible_tables.items()}, files.out, "numbers", console
        )
        _write_shown({poses: visible.causes for poses, visible in visible_tables.items()}, files.out, "causes", console)
    return ExitCode.DONE


def tables_of_chain(campaign: CampaignFolder, files: DesignFiles) -> ChainDesignTables:
    """Tables of a design of a chain: those of the campaign, and files of the call; raises CampaignFaults."""
    settings = campaign.validated()
    extend = None if files.extend is None else read_given(files.extend, "a configurations table")
    functions: tuple[Forbids, ...] = ()
    avoid = None
    if files.avoid is not None and _FUNCTION.fullmatch(str(files.avoid)):
        functions = (_function(str(files.avoid)),)
    elif files.avoid is not None:
        avoid = read_given(files.avoid, "a table of forbidden regions")
    return ChainDesignTables(
        chain_tables(campaign, settings), extend, str(files.extend), avoid, str(files.avoid), functions
    )


def _design_axis(campaign: CampaignFolder, options: DesignOptions, files: DesignFiles, console: RunConsole) -> ExitCode:
    """Choose targets of an axis; next to the plan, a table of the effects that it shows. Raises CampaignFaults."""
    if files.avoid is not None:
        expected = "no regions: [mechanism] travel_mm or travel_deg limits the commands of an axis"
        raise CampaignFaults([Fault("--avoid", expected, value=str(files.avoid))])
    settings = campaign.validated()
    extend = None if files.extend is None else read_given(files.extend, "a configurations table")
    is_planned = CampaignFiles(campaign.folder, settings).entries("configurations")
    planned = axis_tables(campaign, settings)["configurations"] if is_planned else None
    axis_design = design_axis(settings, options, AxisDesignTables(planned, extend, str(files.extend)))
    sentences, then = words_of_axis(axis_design), "; add time_s when measuring, or keep this order"
    _report_plan(sentences, axis_design.table, files.out, console, noun="row", then=then)
    if files.out is not None:
        shown = {"own": axis_design.own_sizes, "plan": axis_design.sizes}
        _write_shown({rows: sizes for rows, sizes in shown.items() if sizes is not None}, files.out, "causes", console)
    return ExitCode.DONE


_SHOWN = {"numbers": "expected sigma of each unknown", "causes": "what the poses show of each cause"}


def _write_shown(tables: Mapping[str, pa.Table], out: Path, ending: str, console: RunConsole) -> None:
    """Write tables one below the other, next to the plan; the first column names the poses."""
    path = out.with_name(f"{out.stem}-{ending}{out.suffix}")
    named = [table.add_column(0, "poses", pa.array([poses] * len(table))) for poses, table in tables.items()]
    write_atomically(path, table_bytes(pa.concat_tables(named), path.suffix, quoting="needed"))
    console.written(f"{_SHOWN[ending]}: {path}", [path])


def _function(name: str) -> Forbids:
    """The function ``module:function`` of an installed module; raises CampaignFaults."""
    module, _, called = name.partition(":")
    try:
        forbids: Forbids = getattr(importlib.import_module(module), called)
    except (ImportError, AttributeError) as why:
        raise CampaignFaults([Fault("--avoid", f"a function of an installed module ({why})", value=name)]) from None
    return forbids


def _plan_loads(campaign: CampaignFolder, options: DesignOptions, files: DesignFiles, console: RunConsole) -> ExitCode:
    """Choose load steps for a sensor; raises CampaignFaults for options of poses."""
    _check_of_loads(options, files)
    load_plan = plan_loads(campaign.validated(), options, _loads_of(campaign))
    how = "in the order in which to apply them"
    _report_plan(load_lines(load_plan), load_plan.table, files.out, console, noun="load step", how=how)
    return ExitCode.DONE


def _loads_for_causes(
    campaign: CampaignFolder, options: DesignOptions, files: DesignFiles, console: RunConsole
) -> ExitCode:
    """Choose runs of loads that show causes, in addition to the campaign's own load steps."""
    from truing.pipeline.power_command import check_causes  # imported here, because it loads the whole diagnosis

    _check_of_loads(options, files)
    settings = campaign.validated()
    check_causes(options.causes, settings)
    tables, measured = bench_tables(campaign, settings)
    try:
        loads = loads_for_causes(tables, settings, options.causes, measured=measured, seed=options.seed)
    except ValueError as why:
        raise CampaignFaults([Fault(str(campaign.file), f"a campaign that can be simulated: {why}")]) from None
    sentences = loads.sentences or ("a campaign in which these causes can act",)
    _report_plan(sentences, loads.table, files.out, console, noun="load step", how="by purpose and run", then="")
    return ExitCode.DONE


def _loads_of(campaign: CampaignFolder) -> dict[str, pa.Table]:
    """The campaign's own readings and signals; nothing if it has none yet, or has faults."""
    settings, log = campaign.validated(), FaultLog()
    source = CampaignFiles(campaign.folder, settings)
    if not any(source.entries(name) for name in TABLES):
        return {}
    outcome = read_loading_tables(source, settings, log)
    return {} if log else outcome.artifacts


def _check_of_loads(options: DesignOptions, files: DesignFiles) -> None:
    """Raise CampaignFaults for options that only poses have."""
    given = {"--extend": files.extend, "--avoid": files.avoid, "--parameters": " ".join(options.parameters) or None}
    if of_poses := [Fault(name, "no such table for loads", value=str(path)) for name, path in given.items() if path]:
        raise CampaignFaults(of_poses)


def _report_plan(
    sentences: Iterable[str],
    table: pa.Table,
    out: Path | None,
    console: RunConsole,
    *,
    noun: str,
    how: str = "in the order in which to measure them",
    then: str = "; fill in time_s when measuring",
) -> None:
    """Print the quality of a plan, and write its table to a file or stdout; nothing for a plan without rows.

    noun, how: what a row is, and in which order rows stand; then: what to do with the file.
    """
    for sentence in sentences:
        console.sentence(sentence)
    if not table.num_rows:
        return
    for row in table.to_pylist():
        console.add_fact("chosen", row)
    if out is None:
        console.line(table_bytes(table, ".csv").decode().rstrip("\n"))
        return
    write_atomically(out, table_bytes(table, out.suffix))
    console.written(f"{count_text(table.num_rows, noun)}, {how}: {out}{then}", [out])


def design_tables(campaign: CampaignFolder, files: DesignFiles) -> DesignTables:
    """Tables of a design: files of the call, and those of the campaign; raises CampaignFaults."""
    extend = None if files.extend is None else read_given(files.extend, "a configurations table")
    avoid = None if files.avoid is None else read_given(files.avoid, "a table of forbidden regions")
    existing, survey = _measured(campaign)
    return DesignTables(extend, str(files.extend), avoid, str(files.avoid), existing, survey)


def _measured(campaign: CampaignFolder) -> tuple[pa.Table | None, pa.Table | None]:
    """Return the campaign's own configurations and survey; None for missing or faulty ones."""
    settings = campaign.validated()
    source = CampaignFiles(campaign.folder, settings)
    tables: list[pa.Table | None] = []
    for name, read in (("configurations", read_configurations), ("targets", read_survey)):
        log = FaultLog()
        outcome = read(source, settings, log) if source.entries(name) else None
        tables.append(None if log or outcome is None else outcome.table)
    return tables[0], tables[1]
