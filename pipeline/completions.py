"""Values that the shell completes: folders, stages, causes, forms of export, and answers of `truing init`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truing.pipeline.campaign_folder import CampaignFolder

FORMS = ("csv", "xlsx", "json", "controller")
CERTIFICATE = "dcc"  # not by default, because it needs more than a run
ROBOT = "urdf"  # not by default, because only a chain has one
ALL_FORMS = (*FORMS, CERTIFICATE, ROBOT)
ANSWERS = (
    *("unit=mm", "unit=m", "unit=um", "unit=in", "decimal=,", "decimal=.", "table=targets", "table=points"),
    *(
        "rotation=vector",
        "rotation=euler",
        "euler=XYZ",
        "euler=ZYX",
        "approach=+",
        "coverage=1",
        "coverage=2",
        "numbers=poses",
        "numbers=bodies",
    ),
    *(
        "numbers=targets",
        "words=bodies",
        "words=names",
        "groups=bodies",
        "groups=one",
        "loads=applied",
        "loads=shown",
        "axis=deg",
        "axis=mm",
        "convention=standard",
        "convention=modified",
        "join=rows",
        "join=step",
        "join=time",
        "sign=place-command",
        "sign=command-place",
        "unit_of_angle=deg",
        "unit_of_angle=gon",
    ),
    *("body=base", "body=platform", "run=1", "pose=1", "channel=dz", "load_axis=fz", "load=0"),
)


def stages(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Stages of the campaigns on the line, or all where none is named yet, with what they do."""
    from truing.pipeline.stage_order import ORDER, order_of, stage_module

    known = [
        order_of(campaign.kind, photographs=campaign.has_photographs, second=campaign.has_second)
        for campaign in _campaigns(context)
    ] or list(ORDER.values())
    names = dict.fromkeys(name for order in known for name in order)
    return [(name, stage_module(name).DECLARATION.summary) for name in names if name.startswith(incomplete)]


def causes(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Causes of the campaign on the command line, or all causes if no campaign is named yet; after a comma, the
    remaining ones."""
    from truing.report.wordings.catalogue import WORDINGS, cause_meaning

    known = dict.fromkeys(name for campaign in _campaigns(context) for name in _causes_of(campaign)) or WORDINGS
    return _listed(incomplete, {name: cause_meaning(name) for name in known if name != "unexplained"})


def campaigns(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Folders with a campaign.toml, two levels deep."""
    return _folders(incomplete, "campaign.toml")


def runs(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Folders that `truing run` has filled, two levels deep."""
    from truing.pipeline.run_folder import PRIVATE

    return _folders(incomplete, PRIVATE)


def _folders(incomplete: str, mark: str) -> list[tuple[str, str]]:
    """Folders that hold a mark and begin as typed, or lie in folders that do."""
    above = incomplete.rpartition("/")[0] or ("/" if incomplete.startswith("/") else ".")
    found = []
    for folder in _within(Path(above)):
        if str(folder).startswith(incomplete):
            found += [str(one) for one in (folder, *_within(folder)) if (one / mark).exists()]
    return [(folder, "") for folder in found]


def _within(folder: Path) -> list[Path]:
    """Folders in a folder, without hidden ones; none where it cannot be read."""
    with suppress(OSError):
        return sorted(one for one in folder.iterdir() if one.is_dir() and not one.name.startswith("."))
    return []


def forms(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Forms of an export; after a comma others."""
    return _listed(incomplete, dict.fromkeys(ALL_FORMS, ""))


def answers(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Answers to what a file may leave open."""
    return [(answer, "") for answer in ANSWERS if answer.startswith(incomplete)]


def _listed(incomplete: str, known: dict[str, str]) -> list[tuple[str, str]]:
    """Names that complete the last of several, separated by commas; those before it are not offered again.

    Meanings have typographic apostrophes: zsh would drop the others.
    """
    before, comma, last = incomplete.rpartition(",")
    given = before.split(",")
    return [
        (f"{before}{comma}{name}", meaning.replace("'", "\u2019"))
        for name, meaning in known.items()
        if name.startswith(last) and name not in given
    ]


def _campaigns(context: typer.Context) -> Iterator[CampaignFolder]:
    """Campaigns that the line names so far and that can be used."""
    from truing.pipeline.run_campaign import usable_campaign
    from truing.schemas.faults import CampaignFaults

    named = context.params.get("campaigns") or [context.params.get("campaign")]
    for path in filter(None, [*named, *context.args]):  # click leaves words unread before an option without its value
        try:
            yield usable_campaign(Path(path))
        except (CampaignFaults, OSError):
            continue


def _causes_of(campaign: CampaignFolder) -> list[str]:
    from truing.stages.diagnosis.search import kinds_of, searched_for

    settings = campaign.validated()
    return [cause.id for cause in searched_for(settings, kinds_of(settings).values()) if cause.catalogued]
