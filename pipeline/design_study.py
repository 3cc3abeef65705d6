"""Studies of a machine as designed, by `truing design`: tables and a page, and nothing is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import pandas as pd
import pyarrow as pa

from truing.pipeline.campaign_folder import CampaignFolder, open_campaign
from truing.pipeline.console import RunConsole
from truing.pipeline.design_command import DesignFiles, design_tables, tables_of_chain
from truing.pipeline.given_files import check_file, leave_tables
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_owner import folder_next_to_run, note_owner
from truing.report.accuracy_page import accuracy_head, accuracy_sections, accuracy_words
from truing.report.chain_study_page import (
    chain_accuracy_head,
    chain_accuracy_sections,
    chain_accuracy_words,
    chain_tolerance_head,
    chain_tolerance_sections,
    chain_tolerance_words,
    chain_uniqueness_head,
    chain_uniqueness_sections,
    chain_uniqueness_words,
)
from truing.report.glossary_section import with_reference
from truing.report.page import PageHead, ReportSection
from truing.report.rendering.render import render_page
from truing.report.sensor.tolerances import chain_section, tolerance_head, tolerance_sections, tolerance_words
from truing.report.uniqueness_page import uniqueness_head, uniqueness_sections, uniqueness_words
from truing.schemas.campaign import Campaign
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.chain_studies import (
    chain_accuracy_tables,
    chain_tolerance_tables,
    chain_uniqueness_tables,
)
from truing.stages.configurations.accuracy import accuracy_tables
from truing.stages.configurations.chain_poses import ChainDesignTables
from truing.stages.configurations.chosen import DesignOptions, DesignTables
from truing.stages.configurations.uniqueness import uniqueness_tables
from truing.stages.responses.tolerances import chain_tables, tolerance_tables

Frames = Mapping[str, pd.DataFrame]


TablesT = TypeVar("TablesT")


@dataclass(frozen=True)
class DesignStudy(Generic[TablesT]):
    """A study: its tables by the ending of their file, the name of the first of them, its words and its page."""

    tables: Callable[[Campaign, DesignOptions, TablesT], dict[str, pa.Table]]
    first: str
    words: Callable[[Frames], list[str]]
    head: Callable[[str, Frames], PageHead]
    sections: Callable[[Frames], list[ReportSection]]


def _tolerance_tables(settings: Campaign, options: DesignOptions, _: DesignTables) -> dict[str, pa.Table]:
    drawn = dict(zip(("", "-samples"), tolerance_tables(settings, options.seed).values(), strict=True))
    return drawn | {f"-{name}": table for name, table in chain_tables(settings).items()}


def _as_artifacts(frames: Frames) -> Frames:
    return {f"tolerance_{name}": frame for name, frame in frames.items()}


LEG_STUDIES: Mapping[str, DesignStudy[DesignTables]] = {
    "accuracy": DesignStudy(accuracy_tables, "worst", accuracy_words, accuracy_head, accuracy_sections),
    "uniqueness": DesignStudy(uniqueness_tables, "statements", uniqueness_words, uniqueness_head, uniqueness_sections),
    "tolerances": DesignStudy(
        _tolerance_tables,
        "errors",
        lambda frames: tolerance_words(frames["errors"]),
        lambda name, frames: tolerance_head(name, frames["errors"]),
        lambda frames: [*tolerance_sections(_as_artifacts(frames)), chain_section(frames)],
    ),
}


CHAIN_STUDIES: Mapping[str, DesignStudy[ChainDesignTables]] = {
    "accuracy": DesignStudy(
        chain_accuracy_tables, "errors", chain_accuracy_words, chain_accuracy_head, chain_accuracy_sections
    ),
    "uniqueness": DesignStudy(
        chain_uniqueness_tables, "numbers", chain_uniqueness_words, chain_uniqueness_head, chain_uniqueness_sections
    ),
    "tolerances": DesignStudy(
        chain_tolerance_tables, "errors", chain_tolerance_words, chain_tolerance_head, chain_tolerance_sections
    ),
}
# What an axis has in place of each study.
_OF_AXIS = {
    "accuracy": "a chain or legs: `truing run` measures the accuracy of an axis (section Positioning), and `truing "
    "design` without this option says which errors a plan of targets shows",
    "uniqueness": "a chain or legs: each command of an axis has one position, and one number per effect; `truing "
    "design` without this option says which effects the targets show",
    "tolerances": "a chain or a force sensor: an axis has no links; `truing power` says which of its errors are found",
}
# Tables of the call that a study of a chain takes, next to those of the campaign.
_TAKEN = {"accuracy": ("--extend", "--avoid", "--causes"), "uniqueness": ("--avoid",), "tolerances": ("--avoid",)}


def study_campaign(
    path: Path, studies: Sequence[str], options: DesignOptions, files: DesignFiles, console: RunConsole
) -> ExitCode:
    """Study a machine, print the results, and leave tables and a page. Raises CampaignFaults, also for two studies."""
    name, *further = studies
    if further:
        raise CampaignFaults([Fault(f"--{further[0]}", f"one study at a time, not with --{name}")])
    campaign = open_campaign(path)
    settings = campaign.validated()
    kind = settings.mechanism.type
    check_file(files.out, reads=(files.extend, files.avoid), campaign=campaign)
    if kind == "axis":
        raise CampaignFaults([Fault("campaign.toml", _OF_AXIS[name], column="mechanism.type", value=kind)])
    taken = _TAKEN[name] if kind == "chain" else ("--avoid",) if name == "accuracy" else ()
    given: dict[str, object] = {"--extend": files.extend, "--avoid": files.avoid}
    given |= {"--parameters": ",".join(options.parameters), "--causes": ",".join(options.causes)}
    unused = [
        Fault(key, f"no such option with --{name}", value=str(one))
        for key, one in given.items()
        if one and key not in taken
    ]
    if unused:
        raise CampaignFaults(unused)
    if kind == "chain":
        return _left(campaign, name, CHAIN_STUDIES[name], tables_of_chain(campaign, files), options, files, console)
    tables = DesignTables() if name == "tolerances" else design_tables(campaign, files)
    return _left(campaign, name, LEG_STUDIES[name], tables, options, files, console)


def _left(
    campaign: CampaignFolder,
    name: str,
    study: DesignStudy[TablesT],
    tables: TablesT,
    options: DesignOptions,
    files: DesignFiles,
    console: RunConsole,
) -> ExitCode:
    """Print the results of a study, and leave its tables and page."""
    folder = folder_next_to_run(campaign)
    found = study.tables(campaign.validated(), options, tables)
    frames = {ending.lstrip("-") or study.first: table.to_pandas() for ending, table in found.items()}
    for line in study.words(frames):
        console.sentence(line)
    page = render_page(study.head(campaign.name, frames), with_reference(study.sections(frames)))
    if files.out is None:
        note_owner(campaign, folder)
    written = leave_tables(folder / f"{name}.csv" if files.out is None else files.out, found, page)
    for ending, table in found.items():
        for row in table.to_pylist():
            console.add_fact(ending.lstrip("-") or study.first, row)
    console.written(f"tables and page: {', '.join(map(str, written))}", written)
    return ExitCode.DONE
