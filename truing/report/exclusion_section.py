"""The section of what was left out, by which rule or person, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.numbers import count, plain, quantity
from truing.report.page import Listing, Section
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

_SHIFT = ["dx_mm", "dy_mm", "dz_mm"]
# Longer listings are folded away.
_OPEN = 40


def excluded(tables: Tables) -> Section:
    """Rows of raw files, points, attachments and scans that were left out; and what persons decided."""
    listings = [
        listing
        for listing in (
            _decisions(tables),
            _effects(tables),
            _rows_of_files(tables),
            _points_by_target(tables),
            _points(tables),
            _readings(tables),
            _no_part(tables),
            _attachments(tables),
            _of_models(tables),
            _scans(tables),
        )
        if listing is not None
    ]
    lead = "The tables of this run record nothing that was left out."
    return Section("excluded", "Left out", _lead(tables) if listings else lead, listings=tuple(listings))


def _lead(tables: Tables) -> str:
    files, residuals = filled(tables, "exclusions"), filled(tables, "residuals")
    words, readings = [], filled(tables, "reading_residuals")
    if files is not None:
        words.append(f"{count(int(files['rows'].sum()), 'row')} of the raw files")
    for table, noun in ((residuals, "object point"), (readings, "reading")):
        if table is not None and table["rejected"].any():
            number, by_person = int(table["rejected"].sum()), int((table["rejected"] & _by_person(table)).sum())
            words.append(f"{count(number, noun)} of {len(table):,} ({by_person:,} by a person)")
    if not words:
        return "All of it:"
    names = ("diagnosis_left_out", "calibration_left_out")
    further = sum(len(table) for name in names if (table := filled(tables, name)) is not None)
    besides = f" Diagnosis and calibration left out {count(further, 'further gross error')}." if further else ""
    return f"Left out of files and poses: {' and '.join(words)}, each with its reason.{besides}"


def _by_person(table: pd.DataFrame) -> pd.Series:
    """Which rows a person decided on; the others a rule of the software left out, and nobody has confirmed that."""
    return table["decision"].notna() if "decision" in table else table["rejected"] & False


def _effects(tables: Tables) -> Listing | None:
    """What persons left out, and what the result would be without that."""
    effects = filled(tables, "exclusion_effects")
    if effects is None:
        return None
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
        for r in effects.itertuples()
    )
    heads = ("entry", "by", "reason", "of", "left out", "gross errors anyway", "would change by up to", "over sigma")
    caption = "Without what persons excluded: the result with all of it taken back"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "exclusion_effects.parquet")


def _decisions(tables: Tables) -> Listing | None:
    """What a person overruled, by name: points excluded or kept, verdicts accepted."""
    rows: list[tuple[str, ...]] = []
    residuals, qa = filled(tables, "residuals"), filled(tables, "qa")
    if residuals is not None:
        decided = residuals[_by_person(residuals)]
        for (reason, body, target), part in decided.groupby(["reason", "body", "target"], sort=False):
            rows.append((reason, f"{body} {target}", f"{count(len(part), 'pose')}: {_named(part['pose'])}"))
    readings = filled(tables, "reading_residuals")
    if readings is not None:
        decided = readings[_by_person(readings)]
        for (reason, run, channel), part in decided.groupby(["reason", "run", "channel"], sort=False):
            steps = f"{count(len(part), 'step')}: {_named(part['step'])}"
            rows.append((reason, f"run {run} {channel}", steps))
    if qa is not None and "accepted" in qa:
        for r in qa[qa["accepted"].notna()].itertuples():
            rows.append(
                (f"accepted by {r.accepted}", f"{r.check} {cell(r.subject)}".strip(), f"{r.verdict}: {r.message}")
            )
    if not rows:
        return None
    heads = ("decision, by whom, and why", "of what", "where")
    return Listing(heads, tuple(rows), caption="Decided by a person", folded=len(rows) > _OPEN)


def _named(poses: pd.Series) -> str:
    return ", ".join(str(p) for p in poses.iloc[:8]) + (" …" if len(poses) > 8 else "")


def _rows_of_files(tables: Tables) -> Listing | None:
    files = filled(tables, "exclusions")
    if files is None:
        return None
    rows = tuple((r.stage, cell(r.subject), cell(r.reason), f"{r.rows:,}", cell(r.by)) for r in files.itertuples())
    heads = ("stage", "subject", "reason", "rows", "by")
    return Listing(heads, rows, (), "Rows of raw files", len(rows) > _OPEN, "exclusions.parquet")


def _rejected(tables: Tables) -> pd.DataFrame | None:
    residuals = filled(tables, "residuals")
    if residuals is None or not residuals["rejected"].any():
        return None
    out = residuals[residuals["rejected"] & ~_by_person(residuals)]
    return out if len(out) else None


def _points_by_target(tables: Tables) -> Listing | None:
    """Where many points are out: which targets they belong to, the most frequent first."""
    out = _rejected(tables)
    if out is None or len(out) <= _OPEN:
        return None
    seen = tables["residuals"].groupby(["body", "target"]).size()
    number = out.groupby(["body", "target"], sort=False).size().sort_values(ascending=False, kind="stable")
    rows = tuple((*key, f"{n} of {seen[key]}") for key, n in number.items())
    heads = ("body", "target", "left out in poses")
    return Listing(heads, rows, caption=f"Points kept out of the poses, by {count(len(rows), 'target')}", folded=True)


def _points(tables: Tables) -> Listing | None:
    out = _rejected(tables)
    if out is None:
        return None
    distance = np.linalg.norm(out[_SHIFT].to_numpy(dtype=float), axis=1)
    rows = tuple(
        (str(r.pose), r.body, r.target, quantity(d, "mm"), _off(r), cell(r.reason))
        for r, d in zip(out.itertuples(), distance, strict=True)
    )
    heads = ("pose", "body", "target", "off by", "x, y, z (mm)", "reason")
    caption = f"{count(len(rows), 'object point')} kept out of the poses by a rule, confirmed by nobody"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "residuals.parquet")


def _off(r: object) -> str:
    shift = [getattr(r, c) for c in _SHIFT]
    return "no pose to compare with" if any(s != s for s in shift) else ", ".join(f"{s:+.3f}" for s in shift)


def _readings(tables: Tables) -> Listing | None:
    """Readings of a loaded platform that were kept out, as gross errors or by a person."""
    readings = filled(tables, "reading_residuals")
    if readings is None or not readings["rejected"].any():
        return None
    out = readings[readings["rejected"] & ~_by_person(readings)]
    if not len(out):
        return None
    rows = tuple(
        (str(r.run), str(r.step), r.channel, _far(r.residual, r.unit), cell(r.reason)) for r in out.itertuples()
    )
    heads = ("run", "step", "channel", "off by", "reason")
    caption = f"{count(len(rows), 'reading')} kept out of the displacement by a rule, confirmed by nobody"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "reading_residuals.parquet")


def _far(residual: float, unit: str) -> str:
    """How far a reading is off; nothing is held against one that a person left out."""
    return quantity(residual, unit) if residual == residual else "–"


def _no_part(tables: Tables) -> Listing | None:
    """Points that are no gross errors and take no part in a pose all the same, counted by body and reason."""
    residuals = filled(tables, "residuals")
    if residuals is None:
        return None
    idle = residuals[~residuals["rejected"] & residuals["reason"].notna() & ~_by_person(residuals)]
    if not len(idle):
        return None
    number = idle.groupby(["body", "reason"], sort=False).size()
    rows = tuple((body, why, f"{n:,}") for (body, why), n in number.items())
    return Listing(("body", "why", "points"), rows, caption="Points that take no part in a pose for another reason")


def _scans(tables: Tables) -> Listing | None:
    """Dense scans that gave no pose, with what the registration says of them."""
    scans = filled(tables, "scans")
    if scans is None or (scans["status"] == "ok").all():
        return None
    out = scans[scans["status"] != "ok"]
    rows = tuple((str(r.pose), r.body, r.status, cell(r.message)) for r in out.itertuples())
    caption = f"{count(len(rows), 'dense scan')} that gave no pose"
    return Listing(("pose", "body", "status", "why"), rows, (), caption, len(rows) > _OPEN, "scans.parquet")


def _of_models(tables: Tables) -> Listing | None:
    """What diagnosis and calibration took out beyond that, one by one."""
    rows: list[tuple[str, ...]] = []
    for stage in ("diagnosis", "calibration"):
        left_out = filled(tables, f"{stage}_left_out")
        if left_out is None:
            continue
        rows += [
            (stage, r.subject, _where(r), cell(r.reason), quantity(r.value, r.unit), quantity(r.limit, r.unit))
            for r in left_out.itertuples()
        ]
    if not rows:
        return None
    heads = ("stage", "subject", "where", "reason", "value", "limit")
    caption = f"{count(len(rows), 'further gross error')} that diagnosis and calibration left out, confirmed by nobody"
    held_by = "diagnosis_left_out.parquet, calibration_left_out.parquet"
    return Listing(heads, tuple(rows), (), caption, len(rows) > _OPEN, held_by)


def _where(r: Any) -> str:
    """The pose, or the run and step."""
    return f"pose {r.pose}" if hasattr(r, "pose") else f"run {r.run}, step {r.step}"


def _attachments(tables: Tables) -> Listing | None:
    shifts = filled(tables, "deformation")
    if shifts is None or "rejected" not in shifts or not shifts["rejected"].any():
        return None
    out = shifts[shifts["rejected"]]
    rows = tuple((str(r.pose), f"leg {r.leg}", quantity(r.delta_bz_um, "um"), cell(r.reason)) for r in out.itertuples())
    heads = ("pose", "attachment", "shift along z", "reason")
    caption = f"{count(len(rows), 'shift')} of attachments kept out of the deformation models"
    return Listing(heads, rows, (), caption, len(rows) > _OPEN, "deformation.parquet")
