"""Studies of a machine as designed, by `truing design`: tables and a page, and nothing is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from truing.report.page import PageHead, ReportSection
from truing.report.rendering.render import render_page
from truing.schemas.campaign import Campaign
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.configurations.accuracy import accuracy_tables
from truing.stages.configurations.chosen import DesignOptions, DesignTables

Frames = Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class DesignStudy:
    """A study: its tables by the ending of their file, the name of the first of them, its words and its page."""

    tables: Callable[[Campaign, DesignOptions, DesignTables], dict[str, pa.Table]]
    first: str
    words: Callable[[Frames], list[str]]
    head: Callable[[str, Frames], PageHead]
    sections: Callable[[Frames], list[ReportSection]]


STUDIES = {
    "accuracy": DesignStudy(accuracy_tables, "worst", accuracy_words, accuracy_head, accuracy_sections),
}


def study_campaign(place: Path, name: str, options: DesignOptions, files: DesignFiles) -> ExitCode:
    """Study a machine, print the results, and leave tables and a page. Raises CampaignFaults."""
    campaign, console, study = open_campaign(place), RunConsole(quiet=False), STUDIES[name]
    check_file(files.out, reads=(files.avoid,), campaign=campaign)
    if files.extend is not None:
        raise CampaignFaults([Fault("--extend", f"no poses to keep with --{name}", value=str(files.extend))])
    settings, folder = campaign.validated(), folder_next_to_run(campaign)
    found = study.tables(settings, options, design_tables(campaign, files))
    frames = {ending.lstrip("-") or study.first: table.to_pandas() for ending, table in found.items()}
    for line in study.words(frames):
        console.line(line)
    page = render_page(study.head(campaign.name, frames), study.sections(frames))
    if files.out is None:
        note_owner(campaign, folder)
    written = leave_tables(folder / f"{name}.csv" if files.out is None else files.out, found, page)
    console.line(f"tables and page: {', '.join(map(str, written))}")
    return ExitCode.DONE
