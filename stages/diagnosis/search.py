"""The search for causes in a campaign: data, candidate causes, and significance rule."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow as pa

from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean
from truing.simulation.catalogue import (
    OF_TYPES,
    catalogue,
    catalogue_of_bodies,
    catalogue_of_photographed_points,
    catalogue_of_rays,
    catalogue_of_readings,
)
from truing.simulation.cause import Cause, CauseT
from truing.simulation.mechanisms.recording import RecordedModel
from truing.stages.common.missing_data import NO_POINTS_TO_DIAGNOSE
from truing.stages.declaration import registered

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.stages.declaration import Progress
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

# What assembles the data of a mechanism that is neither of legs nor a sensor on its bench, by its type.
_OF_TYPES = {"axis": "truing.stages.diagnosis.axis_points", "chain": "truing.stages.diagnosis.chain_points"}
# Number of simulated residual vectors, and of sign-flipped ones, for the null distribution.
DRAWS = 400
# Of the probability of any false finding in a campaign, what rays may take of it; the rest is left to points.
SHARE_OF_RAYS = 1.0 / 3.0


def assembled_data(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    """Data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    data = _assembled_data(tables, settings)
    return replace(data, given=tuple(searched_for(settings, data.given)))


def _assembled_data(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    if settings.mechanism.type != "chain" and "observations" in tables and not tables["observations"].num_rows:
        raise ValueError(NO_POINTS_TO_DIAGNOSE)
    if (of_type := registered(_OF_TYPES, settings)) is not None:
        data: DiagnosisData = of_type.assemble(tables, settings)
        return data
    if settings.mechanism.is_legged:
        from truing.stages.diagnosis.mechanism_points import assemble

        return _started(assemble(tables, settings), tables, settings)
    if settings.campaign.kind == "interferometer":
        from truing.stages.diagnosis.reading_points import assemble_readings

        return _started(assemble_readings(tables, settings), tables, settings)
    from truing.stages.diagnosis.body_points import assemble_bodies

    return assemble_bodies(tables, settings)


def _started(data: DiagnosisData, tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    """Data of the diagnosis, with the prior of the model that the campaign starts from."""
    if "start" not in tables:
        return data
    from truing.stages.diagnosis.prior_campaign import started

    return started(data, str(tables["start"]), settings.diagnosis.seed)


def kinds_of(settings: Campaign, *, photographed: bool = False) -> Mapping[str, Cause]:
    """Causes for a campaign's instrument and mechanism, by id."""
    if settings.mechanism.type in OF_TYPES:
        return OF_TYPES[settings.mechanism.type]()
    if settings.campaign.kind == "interferometer":
        return catalogue_of_readings()
    kinds = catalogue() if settings.mechanism.is_legged else catalogue_of_bodies()
    return kinds | catalogue_of_photographed_points() if photographed else kinds


def searched_for(settings: Campaign, causes: Iterable[CauseT]) -> list[CauseT]:
    """Causes without those that [diagnosis] ignore names."""
    return [cause for cause in causes if cause.id not in settings.diagnosis.ignore]


def cause_faults(settings: Campaign, file: str) -> Iterator[Fault]:
    """Faults of [diagnosis] apply and ignore: unknown causes, or causes that cannot be named there."""
    kinds: dict[str, Cause] = {**kinds_of(settings, photographed=True)}
    if settings.campaign.kind == "photogrammetry" and settings.mechanism.type not in OF_TYPES:
        kinds |= catalogue_of_rays()
    if settings.campaign.kind == "interferometer" and settings.mechanism.type == "none":
        kinds |= OF_TYPES["axis"]()  # of positions alone
    known = [name for name, cause in kinds.items() if cause.catalogued]
    for key in ("apply", "ignore"):
        for number, name in enumerate(getattr(settings.diagnosis, key), 1):
            if name not in known:
                hint = did_you_mean(name, known) or f"; one of: {', '.join(known)}"
                expected = f"a cause that this kind of campaign knows by name{hint}"
                yield Fault(file, expected, column=f"diagnosis.{key}.{number}", value=name)


def rule_of(settings: Campaign) -> Settings:
    """Significance rule of a campaign."""
    return Settings(settings.diagnosis.false_alarm, DRAWS, settings.diagnosis.seed)


def rule_of_rays(rule: Settings) -> Settings:
    """Significance rule of rays, by the rule of the whole campaign."""
    return replace(rule, false_alarm=SHARE_OF_RAYS * rule.false_alarm)


def rule_with_rays(rule: Settings) -> Settings:
    """Significance rule of points if their rays are also diagnosed."""
    return replace(rule, false_alarm=(1.0 - SHARE_OF_RAYS) * rule.false_alarm)


def search_causes(data: DiagnosisData, settings: Campaign, progress: Progress) -> CauseDiagnosis:
    """Decisions of the search over the catalogue."""
    rule = rule_of(settings)
    photographed = isinstance(data.model, RecordedModel) and data.model.photographed is not None
    kinds = searched_for(settings, kinds_of(settings, photographed=photographed).values())
    return _searched(data, rule_with_rays(rule) if photographed else rule, kinds, progress)


def decided_of_rays(data: DiagnosisData, settings: Campaign, progress: Progress) -> CauseDiagnosis:
    """Decisions of the search for causes of rays."""
    kinds = searched_for(settings, catalogue_of_rays().values())
    return _searched(data, rule_of_rays(rule_of(settings)), kinds, progress, "rays: ")


def _searched(
    data: DiagnosisData, rule: Settings, kinds: Sequence[Cause], progress: Progress, of: str = ""
) -> CauseDiagnosis:
    search = CauseSelection(
        data.model,
        data.calibration,
        data.held_out,
        rule,
        lambda action: progress(0, 1, f"{of}{action}"),
        data.given,
    )
    return search.run(kinds)
