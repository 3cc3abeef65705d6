"""QA: whether the measurements are fit to be used, check by check, before anything is concluded from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import chain
from typing import TYPE_CHECKING, cast

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.axis_mechanism import COLUMNS_OF_AXES, NOISE_OF_COMMANDS
from truing.stages.common.registered import registered
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa
    from numpy.typing import NDArray

    from truing.belonging.relation import Tested
    from truing.quality.bodies import BodyView
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
    from truing.schemas.sections import Acceptance
    from truing.stages.quality.check import Check

DECLARATION = Stage(
    name="qa",
    reads=(
        "observations?",
        "survey?",
        "configurations?",
        "readings?",
        "signals?",
        "given_compliance?",
        "quadrature?",
        "positions?",
        "reading_corrections?",
        "relabelled?",
        "resurveys?",
        *("photographs?", "object_points?", "image_orientations?", "image_residuals?", "scale_bar_lengths?"),
        *("known_point_errors?", "image_cameras?", "bundle_statistics?", "ray_statistics?", "ray_information?"),
    ),
    leaves=("qa", "likely_names?", "belonging?"),
    settings=(
        *(
            "campaign.kind",
            "campaign.drives",
            "measurement.frame",
            "mechanism.type",
            "mechanism.legs",
            "mechanism.height_mm",
        ),
        *(
            "mechanism.tolerance",
            "mechanism.elements",
            *COLUMNS_OF_AXES,
            *NOISE_OF_COMMANDS,
            "loading",
            "interferometer",
            "signals.range_mv",
            "signals.zero_mv",
            "signals.sensitivity_mv_per_n",
            "bodies",
            "noise.actuator_mm",
        ),
        *("noise.signal_mv", "noise.load_n", "noise.load_nm", "qa", "accept", "exclude", "keep"),
        "mechanism.reference_temperature_c",
    ),
    summary="completeness, noise, geometry, outliers, labels, moved targets, drift; of loads: units, signs, exchanges",
)

# What checks the data of a mechanism that is neither of legs nor a sensor on its bench, by its type.
_OF_TYPES = {"axis": "truing.stages.quality.axis_checks"}


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Every check with its value, limit, verdict and sentence; accepted verdicts keep their row and stop to gate."""
    if (own := registered(_OF_TYPES, settings)) is not None:
        found_of_type, read_of_type = own.checks(tables, settings)
        return _judged(found_of_type, read_of_type, settings, progress)
    if settings.campaign.kind == "interferometer":
        return _of_loads(tables, settings, progress)
    if not tables["observations"].num_rows:
        return Outcome.not_evaluated({"qa": _table([], [])}, "no object points")
    from truing.report.numbers import count
    from truing.stages.quality.belonging_of_points import relations_of_points
    from truing.stages.quality.check import CampaignLimits
    from truing.stages.quality.decisions import overruled_points
    from truing.stages.quality.names_and_surveys import (
        later_surveys,
        likely_names,
        likely_table,
        names_known,
        settled_names,
    )
    from truing.stages.quality.of_belonging import belonging_checks
    from truing.stages.quality.photograph_checks import photograph_checks
    from truing.stages.quality.point_checks import all_checks, body_views, surroundings
    from truing.stages.quality.scale_checks import Figures, scale_contradiction, without_consequences

    around = surroundings(tables["observations"], tables.get("configurations"), settings.campaign.drives)
    bodies, reference = _reference_first(body_views(tables, around), settings)
    attachments = _attachments(settings)
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    observations, resurveys, settled = (
        tables["observations"],
        tables.get("resurveys"),
        settled_names(tables.get("relabelled")),
    )
    relations = relations_of_points(bodies, around, tables, settings)
    likely = likely_names(observations, bodies, around, settled)
    found: Iterable[Check] = chain(
        belonging_checks(relations),
        all_checks(bodies, reference, around, attachments, settings, limits, tables),
        names_known(observations, bodies, likely, settled),
        later_surveys(resurveys, settings.exclude, limits),
        overruled_points(observations, settings),
        photograph_checks(tables, limits),
    )
    statistics = tables.get("bundle_statistics")
    if statistics is not None and scale_contradiction(Figures(statistics)) is not None:
        found = without_consequences(found)
    read = (
        f"{count(observations.num_rows, 'point')} of {count(len(bodies), 'body')} in {count(len(around.poses), 'pose')}"
    )
    outcome = _judged(found, read, settings, progress, relations)
    suggested = {"likely_names": likely_table(likely)} if likely else {}
    return replace(outcome, artifacts={**outcome.artifacts, **suggested})


def _of_loads(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    of_axis, approaches = _of_axis(tables, settings)
    if not any(name in tables and tables[name].num_rows for name in ("readings", "signals")):
        if approaches:
            return _judged(of_axis, approaches, settings, progress)
        return Outcome.not_evaluated({"qa": _table([], [])}, "no readings and no signals")
    from truing.report.numbers import count
    from truing.stages.quality.belonging_of_loads import relations_of_loads
    from truing.stages.quality.check import CampaignLimits
    from truing.stages.quality.loading_checks import loading_checks, loading_view
    from truing.stages.quality.of_belonging import belonging_checks, without_contradiction

    view = loading_view(tables, settings)
    read = (
        f"{count(len(view.steps.run), 'load step')} in {count(len(view.steps.runs), 'run')}"
        + f"; {approaches}" * bool(approaches)
    )
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    checks = loading_checks(view, settings, limits)
    if "reading_corrections" in tables:
        from truing.stages.quality.loading_checks import correction_checks

        checks = chain(checks, correction_checks(view, tables["reading_corrections"], limits))
    if "quadrature" in tables:
        from truing.stages.quality.loading_checks import quadrature_checks

        checks = chain(quadrature_checks(tables["quadrature"], limits), checks)
    relations = relations_of_loads(view, tables, settings)
    checks = chain(belonging_checks(relations), without_contradiction(checks, relations), of_axis)
    return _judged(checks, read, settings, progress, relations)


def _of_axis(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Iterable[Check], str]:
    """The checks of an axis' positioning runs, and what was read of them; empty where there are none."""
    if "positions" not in tables or not tables["positions"].num_rows:
        return (), ""
    from truing.report.numbers import count
    from truing.stages.quality.check import CampaignLimits
    from truing.stages.quality.position_checks import position_checks, positioning_runs

    runs = list(positioning_runs(tables["positions"]))
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    read = f"{count(tables['positions'].num_rows, 'approach')} of an axis in {count(len(runs), 'run')}"
    return position_checks(runs, limits), read


def _judged(
    found: Iterable[Check], read: str, settings: Campaign, progress: Progress, relations: Sequence[Tested] = ()
) -> Outcome:
    from truing.report.numbers import count
    from truing.stages.common.belonging import belonging_table
    from truing.stages.quality.check import FAIL, WARN, told
    from truing.stages.quality.decisions import accepted_verdicts

    checks = []
    for check in map(told, found):
        checks.append(check)
        progress(len(checks), 0, check.check)
    accepted = [_acceptance(check, settings.accept) for check in checks]
    checks += (decisions := [*accepted_verdicts(checks, settings.accept)])
    accepted += [None] * len(decisions)
    failed = tuple(
        f"{c.check} {c.subject}".strip() for c, a in zip(checks, accepted, strict=True) if c.verdict == FAIL and not a
    )
    warned = sum(c.verdict == WARN and not a for c, a in zip(checks, accepted, strict=True))
    signed = {(c.check, c.subject): who for c, who in zip(checks, accepted, strict=True)}
    belonging = belonging_table(relations, [signed.get((one.relation, one.subject)) for one in relations])
    return Outcome(
        {"qa": _table(checks, accepted), "belonging": belonging},
        read=read,
        left_out="nothing",
        figure=f"{count(len(checks), 'check')}, {len(failed)} failed, {warned} warn, "
        f"{sum(map(bool, accepted))} accepted",
        failed_checks=failed,
    )


def _attachments(settings: Campaign) -> NDArray[np.float64]:
    """(L, 3) nominal attachments in m; none where no mechanism says where they are."""
    import numpy as np

    if not settings.mechanism.is_legged:
        return np.zeros((0, 3))
    return np.array([leg.b_mm for leg in cast("LeggedMechanism", settings.mechanism).legs]) * 1e-3


def _reference_first(bodies: list[BodyView], settings: Campaign) -> tuple[list[BodyView], BodyView | None]:
    """The bodies, the one that the others are seen from first, and that one where the campaign has it."""
    legged = settings.mechanism.is_legged
    reference = settings.bodies.reference or ("base" if legged else None)
    ordered = sorted(bodies, key=lambda body: body.name != reference)
    return ordered, ordered[0] if ordered and ordered[0].name == reference else None


def _acceptance(check: Check, accept: tuple[Acceptance, ...]) -> str | None:
    """Who accepted a verdict and why."""
    from truing.stages.quality.decisions import covers

    for entry in accept:
        if covers(entry, check):
            return f"{entry.signed}: {entry.reason}"
    return None


def _table(checks: list[Check], accepted: list[str | None]) -> pa.Table:
    import pyarrow as pa

    schema = ARTIFACTS["qa"].arrow_schema(present=("accepted",))
    rows = [{**asdict(check), "accepted": who} for check, who in zip(checks, accepted, strict=True)]
    return pa.Table.from_pylist(rows, schema=schema)
