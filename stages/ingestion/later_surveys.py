"""Later surveys of the targets: targets that moved since the previous survey, and first pose of each new position."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask, TableRow
from truing.estimation.rigid_poses.later_survey import FALSE_ALARM, SurveyComparison, compare_surveys
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import COORDINATE_SIGMAS, COORDINATES, RESURVEYS
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean
from truing.stages.common.table_arrays import SmallTable, check_unique_keys, numbers, sigmas, texts
from truing.stages.ingestion.relabelling import PoseTimes, Relabel, Relabelling, window
from truing.stages.ingestion.tables import check_legs, legs_of

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_FILE = "campaign.toml"
_MM = 1e-3


@dataclass(frozen=True)
class Place:
    """Position of a target on its body, m, with covariance (3, 3) in m^2, leg or 0, and present name."""

    point: Array
    cov: Array
    leg: int
    name: str


@dataclass
class LaterSurveys:
    """Results of later surveys: rows of ``resurveys``, targets to add to the survey, renamed targets, and raw rows left
    out."""

    rows: list[TableRow] = field(default_factory=list)
    added: list[TableRow] = field(default_factory=list)
    rules: list[Relabel] = field(default_factory=list)
    left_out: dict[tuple[str, str], int] = field(default_factory=dict)

    def survey(self, first: pa.Table) -> pa.Table:
        """The first survey with the later positions."""
        return pa.concat_tables([first, pa.Table.from_pylist(self.added, schema=first.schema)]) if self.added else first

    def table(self) -> pa.Table:
        """The artifact resurveys."""
        return pa.Table.from_pylist(self.rows, schema=ARTIFACTS["resurveys"].arrow_schema())


def read_later_surveys(
    source: CampaignFiles, settings: Campaign, first: SmallTable | None, order: PoseTimes, log: FaultLog
) -> LaterSurveys | None:
    """Later surveys, compared in turn; None if there are none."""
    rows = collect_rows(source, RESURVEYS, log)
    if rows is None:
        for number in range(1, len(settings.resurvey) * (not source.entries("resurveys")) + 1):
            text = "the table resurveys.csv, or [files.resurveys]: where the targets were found"
            log.add(Fault(_FILE, text, column=f"resurvey.{number}"))
        return None
    if any(name not in rows.table.column_names for name in RESURVEYS.required):
        return None  # reported when the table was read
    check_unique_keys(rows, log, "survey", "body", "target")
    check_legs(rows, log, len(legs_of(settings)))
    if first is None:
        log.add(Fault(rows.first_file, "targets.csv, or [files.targets]: a later survey is compared with the first"))
        return None
    resurveys = _resurvey_settings(settings, rows, order, log)
    cov = _covariances(rows, settings.noise.point_mm, log)
    if log:
        return None
    known = _first_survey(first.table, settings.noise.point_mm)
    out = LaterSurveys(left_out=dict(rows.left_out))
    surveys, bodies = texts(rows, "survey"), texts(rows, "body")
    pairs = [(name, body) for name in _in_time(resurveys) for body in dict.fromkeys(bodies[surveys == name].tolist())]
    for name, body in pairs:
        is_observed = _visible_targets(rows, cov, (surveys == name) & (bodies == body))
        _compare(out, known.setdefault(body, {}), is_observed, (name, body), resurveys[name], FALSE_ALARM / len(pairs))
    _check_names(out, first.table, rows.first_file, log)
    return out


def _check_names(out: LaterSurveys, first: pa.Table, file: str, log: FaultLog) -> None:
    """Fault if the new name of a moved target is in use."""
    known = Counter(zip(first.column("body").to_pylist(), first.column("target").to_pylist(), strict=True))
    known.update((row["body"], row["target"]) for row in out.added)
    for body, target in (pair for pair, count in known.items() if count > 1):
        text = f"another name for the survey: body {body} has a target {target} already"
        log.add(Fault(file, text, column="survey", value=target.rpartition("@")[2]))


@dataclass(frozen=True)
class _ResurveySettings:
    """Entry of [[resurvey]] for a survey: its poses by index in time (none: only a check), and targets that moved."""

    window: tuple[int, int] | None = None
    from_pose: str | None = None
    moved: tuple[str, ...] = ()
    why: str = ""
    column: str = ""


def _in_time(settings: dict[str, _ResurveySettings]) -> list[str]:
    """Surveys in the order of validity; checks come last, in the order of the file."""
    return sorted(settings, key=lambda name: (1 << 62) if (w := settings[name].window) is None else w[0])


def _resurvey_settings(
    settings: Campaign, collected: CollectedRows, order: PoseTimes, log: FaultLog
) -> dict[str, _ResurveySettings]:
    names = [str(name) for name in dict.fromkeys(texts(collected, "survey"))]
    resurveys = {name: _ResurveySettings() for name in names}
    since: dict[int, str] = {}
    for number, entry in enumerate(settings.resurvey, 1):
        column = f"resurvey.{number}"
        if entry.survey not in resurveys:
            there = f"a survey of {collected.first_file} ({', '.join(names)}){did_you_mean(entry.survey, names)}"
            log.add(Fault(_FILE, there, column=f"{column}.survey", value=entry.survey))
            continue
        if resurveys[entry.survey].column:
            log.add(Fault(_FILE, "each survey once", column=f"{column}.survey", value=entry.survey))
        of_survey = texts(collected, "survey") == entry.survey
        targets = [str(target) for target in texts(collected, "target")[of_survey]]
        for target in (target_name for target_name in entry.moved if target_name not in targets):
            text = f"targets of survey {entry.survey}{did_you_mean(target, targets)}"
            log.add(Fault(_FILE, text, column=f"{column}.moved", value=target))
        where = None if entry.from_pose is None else window(order, entry.from_pose, None, column, log)
        if where is not None and where[0] in since:
            text = f"another first pose; {since[where[0]]} holds from this one on, too"
            log.add(Fault(_FILE, text, column=f"{column}.from_pose", value=str(entry.from_pose)))
        since |= {} if where is None else {where[0]: column}
        why = ": ".join(filter(None, (entry.by, entry.reason)))
        pose = None if entry.from_pose is None else str(entry.from_pose)
        resurveys[entry.survey] = _ResurveySettings(where, pose, entry.moved, why, column)
    return resurveys


def _covariances(collected: CollectedRows, declared: float | None, log: FaultLog) -> Array:
    """(N, 3, 3) in m^2 of the rows, by their sigmas or by the declared noise."""
    sigma = sigmas(collected, COORDINATE_SIGMAS, declared, "noise.point_mm", "the points", log)
    return np.asarray((_MM * sigma[:, None, :]) ** 2 * np.eye(3), float)


def _visible_targets(collected: CollectedRows, cov: Array, rows: Mask) -> dict[str, Place]:
    """The targets of one body in one survey."""
    points = _MM * np.column_stack([numbers(collected, name) for name in COORDINATES])[rows]
    has_legs = "leg" in collected.table.column_names
    leg = np.nan_to_num(numbers(collected, "leg"))[rows].astype(int) if has_legs else np.zeros(len(points), int)
    targets = texts(collected, "target")[rows]
    parts = zip(targets, points, cov[rows], leg.tolist(), strict=True)
    return {str(target): Place(point, sigma, at, str(target)) for target, point, sigma, at in parts}


def _first_survey(survey: pa.Table, declared: float | None) -> dict[str, dict[str, Place]]:
    """The first survey: body to target to place."""
    sigma = np.column_stack([np.asarray(survey.column(name).to_pylist(), float) for name in COORDINATE_SIGMAS])
    sigma = np.where(np.isnan(sigma), np.nan if declared is None else declared, sigma)
    points = _MM * np.column_stack([np.asarray(survey.column(name).to_pylist(), float) for name in COORDINATES])
    names = (survey.column(name).to_pylist() for name in ("body", "target", "leg"))
    out: dict[str, dict[str, Place]] = {}
    for body, target, leg, point, sigma_of_target in zip(*names, points, sigma, strict=True):
        out.setdefault(body, {})[target] = Place(point, np.diag((_MM * sigma_of_target) ** 2), leg or 0, target)
    return out


def _compare(
    out: LaterSurveys,
    surveyed: dict[str, Place],
    seen: dict[str, Place],
    of: tuple[str, str],
    options: _ResurveySettings,
    alarm: float,
) -> None:
    """Compare one body in one survey with the earlier positions, and replace these if the survey holds."""
    common = [target for target in seen if target in surveyed]
    before, after = [surveyed[target] for target in common], [seen[target] for target in common]
    known = np.array([target in options.moved for target in common], dtype=bool)
    compared = _comparison(before, after, known, alarm)
    for at, target in enumerate(common):
        move = _Move(of[1], target, f"{target}@{of[0]}", now=seen[target], then=surveyed[target])
        is_new_place = options.window is not None and bool(compared.moved[at])
        out.rows.append(_row(of, target, compared, at, move.name if is_new_place else None, options))
        if is_new_place:
            surveyed[target] = _renamed_after_move(out, move, compared, options)
    for target in (target_name for target_name in seen if target_name not in surveyed):
        reported = compared.status == "ok" and options.window is not None
        status = "new" if compared.status == "ok" else compared.status
        out.rows.append(_new_row(of, target, status, target if reported else None, options))
        if reported:
            surveyed[target] = _added(out, of[1], seen[target], target, compared)


def _comparison(before: Sequence[Place], after: Sequence[Place], known: Mask, alarm: float) -> SurveyComparison:
    points = [np.array([place.point for place in survey]).reshape(-1, 3) for survey in (before, after)]
    cov = [np.array([place.cov for place in survey]).reshape(-1, 3, 3) for survey in (before, after)]
    return compare_surveys(points[0], cov[0], points[1], cov[1], known, alarm)


@dataclass(frozen=True)
class _Move:
    """A target of a body with its name from this survey on, and its place now and in the survey before."""

    body: str
    target: str
    name: str
    now: Place
    then: Place


def _renamed_after_move(
    out: LaterSurveys, move: _Move, comparison: SurveyComparison, options: _ResurveySettings
) -> Place:
    """A moved target gets a new name; one that was at an attachment and is not declared there again is omitted."""
    assert options.window is not None
    for at, rule in enumerate(out.rules):
        if (rule.body, rule.called) == (move.body, move.target):
            out.rules[at] = replace(rule, last=min(rule.last, options.window[0] - 1))
    named = move.body, move.target, move.name
    out.rules.append(Relabel(*named, *options.window, options.column, options.why, options.from_pose))
    if move.then.leg and not move.now.leg:
        point = comparison.place(move.now.point[None], move.now.cov[None])[0][0]
        return replace(move.now, point=point, leg=move.then.leg, name=move.name)
    return _added(out, move.body, move.now, move.name, comparison)


def _added(out: LaterSurveys, body: str, now: Place, name: str, comparison: SurveyComparison) -> Place:
    point, cov = (part[0] for part in comparison.place(now.point[None], now.cov[None]))
    sigma = np.sqrt(np.diag(cov)) / _MM
    row = {"body": body, "target": name, "leg": now.leg or None}
    row |= dict(zip((*COORDINATES, *COORDINATE_SIGMAS), (*(point / _MM).tolist(), *sigma.tolist()), strict=True))
    out.added.append(row)
    return Place(point, cov, now.leg, name)


def _row(
    of: tuple[str, str],
    target: str,
    comparison: SurveyComparison,
    at: int,
    holds_as: str | None,
    options: _ResurveySettings,
) -> dict[str, object]:
    reported = comparison.status == "ok"
    sigma = np.sqrt(np.diag(comparison.cov[at])) / _MM if reported else (None,) * 3
    shift = comparison.shift[at] / _MM if reported else (None,) * 3
    status = ("moved" if comparison.moved[at] else "same") if reported else comparison.status
    return {
        **_new_row(of, target, status, holds_as, options),
        **{f"shift_{a}_mm": None if v is None else float(v) for a, v in zip("xyz", shift, strict=True)},
        **{f"sigma_{a}_mm": None if v is None else float(v) for a, v in zip("xyz", sigma, strict=True)},
        "p_value": float(comparison.p_value[at]),
        "relocated": bool(comparison.moved[at]),
    }


def _new_row(
    of: tuple[str, str], target: str, status: str, holds_as: str | None, options: _ResurveySettings
) -> dict[str, object]:
    return {
        "later_survey": of[0],
        "body": of[1],
        "target": target,
        "p_value": 1.0,
        "relocated": False,
        "holds_as": holds_as,
        "from_pose": options.from_pose,
        "status": status,
    }


def relabelling_of(surveys: LaterSurveys | None, order: PoseTimes) -> Relabelling:
    """Targets that later surveys rename from a pose on."""
    rules: Iterator[Relabel] = (
        iter(()) if surveys is None else (rule for rule in surveys.rules if rule.first <= rule.last)
    )
    return Relabelling(order, tuple(rules))
