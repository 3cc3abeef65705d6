"""Studies of a machine as designed, by `truing design`: tables and a page, and nothing is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa

from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.console import RunConsole
from truing.pipeline.design_command import DesignFiles, design_tables
from truing.pipeline.given_files import check_file, leave_tables
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_owner import folder_next_to_run, note_owner
from truing.report.accuracy_page import accuracy_head, accuracy_sections, accuracy_words
from truing.report.glossary_section import with_reference
from truing.report.page import PageHead, ReportSection
from truing.report.rendering.render import render_page
from truing.report.sensor.tolerances import chain_section, tolerance_head, tolerance_sections, tolerance_words
from truing.report.uniqueness_page import uniqueness_head, uniqueness_sections, uniqueness_words
from truing.schemas.campaign import Campaign
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.configurations.accuracy import accuracy_tables
from truing.stages.configurations.chosen import DesignOptions, DesignTables
from truing.stages.configurations.uniqueness import uniqueness_tables
from truing.stages.responses.tolerances import chain_tables, tolerance_tables

Frames = Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class DesignStudy:
    """A study: its tables by the ending of their file, the name of the first of them, its words and its page."""

    tables: Callable[[Campaign, DesignOptions, DesignTables], dict[str, pa.Table]]
    first: str
    words: Callable[[Frames], list[str]]
    head: Callable[[str, Frames], PageHead]
    sections: Callable[[Frames], list[ReportSection]]


def _tolerance_tables(settings: Campaign, options: DesignOptions, _: DesignTables) -> dict[str, pa.Table]:
    drawn = dict(zip(("", "-samples"), tolerance_tables(settings, options.seed).values(), strict=True))
    return drawn | {f"-{name}": table for name, table in chain_tables(settings).items()}


def _as_artifacts(frames: Frames) -> Frames:
    return {f"tolerance_{name}": frame for name, frame in frames.items()}


STUDIES = {
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


def study_campaign(
    path: Path, studies: Sequence[str], options: DesignOptions, files: DesignFiles, console: RunConsole
) -> ExitCode:
    """Study a machine, print the results, and leave tables and a page. Raises CampaignFaults, also for two studies."""
    name, *further = studies
    if further:
        raise CampaignFaults([Fault(f"--{further[0]}", f"one study at a time, not with --{name}")])
    campaign, study = open_campaign(path), STUDIES[name]
    check_file(files.out, reads=(files.avoid,), campaign=campaign)
    given: dict[str, object] = {"--extend": files.extend, "--avoid": None if name == "accuracy" else files.avoid}
    given |= {"--parameters": ",".join(options.parameters), "--causes": ",".join(options.causes)}
    if unused := [Fault(key, f"no such option with --{name}", value=str(one)) for key, one in given.items() if one]:
        raise CampaignFaults(unused)
    settings, folder = campaign.validated(), folder_next_to_run(campaign)
    tables = DesignTables() if name == "tolerances" else design_tables(campaign, files)
    found = study.tables(settings, options, tables)
    frames = {ending.lstrip("-") or study.first: table.to_pandas() for ending, table in found.items()}
    for line in study.words(frames):
        console.sentence(line)
    page = render_page(study.head(campaign.name, frames), with_reference(study.sections(frames)))
    if files.out is None:
        note_owner(campaign, folder)
    written = leave_tables(folder / f"{name}.csv" if files.out is None else files.out, found, page)
    for ending, table in found.items():
        for row in table.to_pylist():
            console.tell(ending.lstrip("-") or study.first, row)
    console.written(f"tables and page: {', '.join(map(str, written))}", written)
    return ExitCode.DONE
