"""What `truing power` does not draw where points come from photographs, and what the campaign's run tells of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.artifacts import Unreadable, read_artifact
from truing.pipeline.campaign_folder import CampaignFolder

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from truing.simulation.cause import Cause

HEADS = ("cause that photographs show", "concerns", "theory, in the run")
_DRAWN = (
    "Points come from photographs, and photographs are not drawn: points scatter by noise.point_mm each, every "
    "surveyed target counts as seen in every pose, and no error of a camera or of a scale bar is shared among points. "
)
_ASKED = " With their names after --causes, rays are drawn from the run's network, and these looked for."


@dataclass(frozen=True)
class OfPhotographs:
    """The sentence that says what is not judged, and what the run tells of that: cause, subject, size in words."""

    said: str
    rows: tuple[tuple[str, ...], ...] = ()


def of_photographs(campaign: CampaignFolder, run: Path) -> OfPhotographs | None:
    """What the run in a folder tells of causes that are not drawn; None where no point comes from photographs."""
    if not campaign.has_photographs:
        return None
    from truing.report.wordings.catalogue import cause_words
    from truing.simulation.catalogue import catalogue_of_rays, of_photographed_points

    catalogues: tuple[Mapping[str, Cause], ...] = (catalogue_of_rays(), of_photographed_points())
    names = list(dict.fromkeys(name for own in catalogues for name, kind in own.items() if kind.catalogued))
    listed = f"{', '.join(map(cause_words, names[:-1]))} and {cause_words(names[-1])}"
    table = _detectable(run)
    own = None if table is None else table[table["cause"].isin(names)]
    if own is None or not len(own):
        why = f"{listed.capitalize()} are not judged here: `truing run` tells from which size on they would be found."
        return OfPhotographs(_DRAWN + why)
    what = f"{listed.capitalize()} are not drawn either: what the run in {run.as_posix()} would have shown of them, "
    return OfPhotographs(_DRAWN + what + "with a probability of 80 %, is told by theory alone." + _ASKED, _rows(own))


def _detectable(run: Path) -> pd.DataFrame | None:
    from truing.schemas.artifacts import ARTIFACTS

    try:
        table = read_artifact(run, ARTIFACTS["detectable"])
    except Unreadable:
        return None
    return None if isinstance(table, str) else table.to_pandas()


def _rows(own: pd.DataFrame) -> tuple[tuple[str, ...], ...]:
    from truing.report.diagnosis.findings import subject_words
    from truing.report.diagnosis.hidden import size_words
    from truing.report.tables import cell
    from truing.report.wordings.catalogue import cause_words

    return tuple(
        (cause_words(str(row.cause)), subject_words(cell(row.subject)) or "the whole", f"{row.parameter} {size}")
        for row, size in zip(own.itertuples(), size_words(own), strict=True)
    )
