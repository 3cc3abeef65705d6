"""`truing stages`: where each stage of a campaign stands, or which stages there are."""

from __future__ import annotations

from pathlib import Path

from truing.pipeline.campaign_folder import run_folder_of
from truing.pipeline.campaign_run import open_run
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_campaign import usable_campaign
from truing.pipeline.run_owner import check_owner
from truing.pipeline.stage_order import OF_PHOTOGRAPHS, ORDER, RAW_READERS, stage_module
from truing.pipeline.voice import Voice


def show_standings(place: Path, out: Path | None, *, distrust: bool) -> ExitCode:
    """One line per stage: fresh, stale and why, or never run. Writes nothing."""
    campaign = usable_campaign(place)
    run = open_run(campaign, run_folder_of(campaign, out, several=False), distrust=distrust)
    check_owner(run)
    voice = Voice(quiet=False)
    for stage, standing in run.standings():
        voice.say(f"{stage.name:<12} {standing.state:<10} {standing.why}".rstrip())
    return ExitCode.DONE


def show_all_stages() -> ExitCode:
    """The stages of every kind of campaign, with what they read and leave."""
    voice = Voice(quiet=False)
    for kind, names in ORDER.items():
        voice.say(f"{kind}:")
        for name in names:
            stage = stage_module(name).DECLARATION
            only = " (where there are photographs)" if name in OF_PHOTOGRAPHS else ""
            read = (*(("raw files",) if name in RAW_READERS else ()), *stage.reads)
            voice.say(f"  {name:<12} {stage.summary}{only}")
            voice.say(f"  {'':<12} reads {', '.join(read)}; leaves {', '.join(stage.leaves)}")
    return ExitCode.DONE
