"""Section of excluded data, with the rule or person that excluded them, and the reason."""

from __future__ import annotations

import math

import pandas as pd

from truing.report.column_heads import BODY, CHANNEL, POSE, RUN, TARGET, Head
from truing.report.numbers import count_text, p_value, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.tables import SHIFT, Row, Tables, cell, each_row, table_or_none

# Longer listings are folded.
_OPEN = 40


def excluded(tables: Tables) -> ReportSection:
    """Return the section of excluded rows, points, attachments and scans, and of the decisions of persons."""
    reported = (_decisions, _effects, _rows_of_files, _points_by_target, _points, _readings, _no_part, _attachments)
    listings = [listing for section in (*reported, _of_models, _kept, _scans) if (listing := section(tables)).rows]
    lead = "Nothing was left out in this run."
    return ReportSection(
        "excluded", "Left out", _opening_sentences(tables) if listings else lead, listings=tuple(listings)
    )


def _opening_sentences(tables: Tables) -> str:
    files, residuals = table_or_none(tables, "exclusions"), table_or_none(tables, "residuals")
    words, readings = [], table_or_none(tables, "reading_residuals")
    if files is not None:
        words.append(f"{count_text(int(files['rows'].sum()), 'row')} of the raw files")
    for table, noun in ((residuals, "object point"), (readings, "reading")):
        if table is not None and table["rejected"].any():
            number, by_person = int(table["rejected"].sum()), int((table["rejected"] & _by_person(table)).sum())
            words.append(f"{count_text(number, noun)} of {len(table):,} ({by_person:,} by a person)")
    names = ("diagnosis_left_out", "calibration_left_out")
    further = sum(len(table) for name in names if (table := table_or_none(tables, name)) is not None)
    kept_signals = table_or_none(tables, "calibration_kept")
    used = ""
    if kept_signals is not None:
        signals = count_text(len(kept_signals), "signal")
        used = f" Used despite large deviations: {signals} with an effect of loads or runs."
    if not words:
        left_out = f"Left out by diagnosis and calibration: {count_text(further, 'gross error')}." if further else ""
        return f"{left_out}{used}".strip() or "All of it:"
    besides = f" Diagnosis and calibration left out {count_text(further, 'further gross error')}." if further else ""
    return f"Left out of files and poses: {' and '.join(words)}.{besides}{used}"


def _by_person(table: pd.DataFrame) -> pd.Series:
    """Return True for rows that a person decided on; a rule of the software excluded the others, unconfirmed."""
    return table["decision"].notna() if "decision" in table else table["rejected"] & False


def _effects(tables: Tables) -> Listing:
    """Return the exclusions by persons, and the results without them."""
    rows = tuple(
        (
            r.entry,
            f"{r.by}{f', {r.decided_on}' if cell(r.decided_on) else ''}",
            cell(r.reason),
            r.subject,
            f"{r.rows:,}",
            f"{r.gross_anyway:,}",
            quantity(r.largest_change, r.unit),
            plain(r.over_sigma),
        )
        for r in each_row(tables, "exclusion_effects")
    )
    heads = (
        Head("entry", "Number of the entry in campaign.toml, from 1."),
        Head("by", "Person who decided, and the day if it is recorded."),
        Head("reason", "Reason that the person gave."),
        Head("of", "Points, readings or poses that the entry names."),
        Head("left out", "Number of rows that the entry leaves out."),
        Head("would be gross errors", "Number of the rows left out that are gross errors even without the entry."),
        Head("largest change of a result", "Largest change of a result if no row is left out by a person."),
        Head("change / sigma", "Largest change of a result divided by the standard deviation of the result."),
    )
    caption = "Effect of exclusions by persons: results without any of them"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "exclusion_effects.parquet")


_STAGE = Head("stage", "Stage of the run that left it out.")
_REASON = Head("reason", "Reason for leaving it out.")
_WHY = Head("why", "Reason why no pose was determined, or why the point was not used.")
_KEPT = {"predicted": "follows {}", "shared input": "shared by several: {}"}
_OFF_BY = Head("off by", "Distance between the measured value and the value fitted to the others.")


def _decisions(tables: Tables) -> Listing:
    """Return the decisions of persons by name: points excluded or kept, verdicts accepted."""
    rows: list[tuple[str, ...]] = []
    points, readings = (
        ("residuals", "", "body", "target", "pose"),
        ("reading_residuals", "run ", "run", "channel", "step"),
    )
    for name, start, *keys, noun in (points, readings):
        if (table := table_or_none(tables, name)) is not None:
            for (reason, *key_values), part in table[_by_person(table)].groupby(["reason", *keys], sort=False):
                rows_text = f"{count_text(len(part), noun)}: {_pose_names(part[noun])}"
                rows.append((reason, f"{start}{' '.join(map(str, key_values))}", rows_text))
    for r in each_row(tables, "qa"):
        if person := cell(getattr(r, "accepted", None)):
            rows.append((f"accepted by {person}", f"{r.check} {cell(r.subject)}".strip(), f"{r.verdict}: {r.message}"))
    heads = (
        Head("decision, by whom, and why", "Decision of a person in campaign.toml, with name and reason."),
        Head("of what", "Target, channel or check that the decision concerns."),
        Head("where", "Poses or runs in which it applies, or the verdict that was accepted."),
    )
    return Listing(heads, tuple(rows), caption="Decided by a person", folded=len(rows) > _OPEN)


def _pose_names(poses: pd.Series) -> str:
    return ", ".join(str(p) for p in poses.iloc[:8]) + (" …" if len(poses) > 8 else "")


def _rows_of_files(tables: Tables) -> Listing:
    files = each_row(tables, "exclusions")
    rows = tuple((r.stage, cell(r.subject), cell(r.reason), f"{r.rows:,}", cell(r.by)) for r in files)
    heads = (
        _STAGE,
        Head("subject", "File, table or body that the rows belong to."),
        _REASON,
        Head("rows", "Number of rows of the file."),
        Head("by", "Rule or person that left them out."),
    )
    return Listing(heads, rows, (), "Rows of raw files", len(rows) > _OPEN, "exclusions.parquet")


def _by_rule(tables: Tables, name: str) -> pd.DataFrame:
    """Return the rejected residuals that no person decided on; without columns where the run has none."""
    table = table_or_none(tables, name)
    return pd.DataFrame() if table is None else table[table["rejected"] & ~_by_person(table)]


def _points_by_target(tables: Tables) -> Listing:
    """Return the targets with excluded points, the most frequent first, where there are many."""
    excluded = _by_rule(tables, "residuals")
    heads = (
        BODY,
        TARGET,
        Head("left out in poses", "Number of poses in which it was left out, of those that show it."),
    )
    if len(excluded) <= _OPEN:
        return Listing(heads, ())
    seen = tables["residuals"].groupby(["body", "target"]).size()
    number = excluded.groupby(["body", "target"], sort=False).size().sort_values(ascending=False, kind="stable")
    rows = tuple((*key, f"{n} of {seen[key]}") for key, n in number.items())
    return Listing(
        heads, rows, caption=f"Points left out of the poses, for {count_text(len(rows), 'target')}", folded=True
    )


def _points(tables: Tables) -> Listing:
    rows = tuple(
        (str(r.pose), r.body, r.target, quantity(math.hypot(*_shift(r)), "mm"), _pose_shift_words(r), cell(r.reason))
        for r in _by_rule(tables, "residuals").itertuples()
    )
    heads = (
        POSE,
        BODY,
        TARGET,
        _OFF_BY,
        Head("x, y, z (mm)", "Measured minus fitted coordinates of the point."),
        _REASON,
    )
    caption = f"{count_text(len(rows), 'object point')} left out of the poses by a rule, not confirmed by a person"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "residuals.parquet")


def _shift(r: object) -> list[float]:
    return [getattr(r, column) for column in SHIFT]


def _pose_shift_words(r: object) -> str:
    shift = _shift(r)
    return "no pose to compare with" if any(s != s for s in shift) else ", ".join(f"{s:+.3f}" for s in shift)


def _readings(tables: Tables) -> Listing:
    """Return the readings of a loaded platform that were excluded as gross errors."""
    rows = tuple(
        (str(r.run), str(r.step), r.channel, _reading_deviation(r.residual, r.unit), cell(r.reason))
        for r in _by_rule(tables, "reading_residuals").itertuples()
    )
    heads = (RUN, Head("step", "Load step within its run, in the order taken."), CHANNEL, _OFF_BY, _REASON)
    caption = f"{count_text(len(rows), 'reading')} left out of the displacement by a rule, not confirmed by a person"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "reading_residuals.parquet")


def _reading_deviation(residual: float, unit: str) -> str:
    """Return the deviation of a reading; a dash for exclusions by a person."""
    return quantity(residual, unit) if residual == residual else "–"


def _no_part(tables: Tables) -> Listing:
    """Return points without gross error that take no part in a pose, counted by body and reason."""
    rows: list[tuple[str, ...]] = []
    if (residuals := table_or_none(tables, "residuals")) is not None:
        idle = residuals[~residuals["rejected"] & residuals["reason"].notna() & ~_by_person(residuals)]
        rows = [(body, why, f"{n:,}") for (body, why), n in idle.groupby(["body", "reason"], sort=False).size().items()]
    return Listing(
        (BODY, _WHY, Head("points", "Number of points that were not used.")),
        tuple(rows),
        caption="Points not used in a pose for another reason",
    )


def _scans(tables: Tables) -> Listing:
    """Return dense scans that gave no pose, with the remarks of the registration."""
    failed = [r for r in each_row(tables, "scans") if r.status != "ok"]
    rows = tuple((str(r.pose), r.body, r.status, cell(r.message)) for r in failed)
    caption = f"{count_text(len(rows), 'dense scan')} that gave no pose"
    heads = (POSE, BODY, Head("status", "End of the registration of the scan."), _WHY)
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "scans.parquet")


def _of_models(tables: Tables) -> Listing:
    """Return further exclusions by diagnosis and calibration, one by one."""
    rows = tuple(
        (stage, r.subject, _row_subject(r), cell(r.reason), quantity(r.value, r.unit), quantity(r.limit, r.unit))
        for stage in ("diagnosis", "calibration")
        for r in each_row(tables, f"{stage}_left_out")
    )
    heads = (
        _STAGE,
        Head("subject", "Target, leg or channel whose measured value was left out."),
        Head("where", "Pose, or run and load step, in which it was left out."),
        _REASON,
        Head("value", "Deviation of the measured value."),
        Head("limit", "Largest deviation that is still accepted as noise, where it is one number."),
    )
    caption = f"{count_text(len(rows), 'gross error')} left out by diagnosis and calibration, not confirmed by a person"
    held_by = "diagnosis_left_out.parquet, calibration_left_out.parquet"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, held_by)


def _kept(tables: Tables) -> Listing:
    """Return the signals that look like gross errors and were used, because they are an effect."""
    rows = tuple(
        (
            r.subject,
            _row_subject(r),
            quantity(abs(r.value), r.unit),
            _KEPT[r.kept_because].format(r.shared_input),
            p_value(r.p_value),
        )
        for r in each_row(tables, "calibration_kept")
    )
    heads = (
        Head("subject", "Channel that deviates."),
        Head("where", "Run and load step."),
        Head("value", "Deviation from a smooth curve of load and time through the run."),
        Head("effect", "Terms that predict it, or the input that signals with alike deviations share."),
        Head("p", "Probability of such terms, or of such a pattern of independent slips, by chance."),
    )
    caption = f"{count_text(len(rows), 'signal')} used despite large deviations, which are an effect of loads or runs"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "calibration_kept.parquet")


def _row_subject(r: Row) -> str:
    """Return the pose, or the run and step."""
    return f"pose {r.pose}" if hasattr(r, "pose") else f"run {r.run}, step {r.step}"


def _attachments(tables: Tables) -> Listing:
    rejected = [r for r in each_row(tables, "deformation") if getattr(r, "rejected", False)]
    rows = tuple((str(r.pose), f"leg {r.leg}", quantity(r.delta_bz_um, "um"), cell(r.reason)) for r in rejected)
    heads = (
        POSE,
        Head("attachment", "Attachment of a leg on the platform, by the number of the leg."),
        Head("shift along z", "Measured shift of the attachment along z of the platform."),
        _REASON,
    )
    caption = f"{count_text(len(rows), 'shift')} of attachments left out of the deformation models"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "deformation.parquet")
