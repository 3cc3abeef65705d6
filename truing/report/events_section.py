"""Section of events during the campaign: targets surveyed again or renamed, and repeated measurements."""

from __future__ import annotations

import math

import pandas as pd

from truing.report.column_heads import BODY, FREEDOM, POSE, TARGET, Head, P
from truing.report.numbers import capitalised, count_text, p_value, plain, quantity, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, cell, table_or_none

_AXES = "xyz"
_OPEN = 24
_UNEQUAL = 1e-3
_SURE = 0.05  # familywise p-value of all subjects of a model


def during(tables: Tables) -> ReportSection | None:
    """Return the section of later surveys, changed names and repeats; None where the campaign has none of them."""
    reported = {
        "resurveys": _surveys,
        "relabelled": _names,
        "likely_names": _suggested,
        "repeats": _repeats,
        "pose_repeatability": _by_pose,
        "lack_of_fit": _fits,
    }
    known = [(show, table) for name, show in reported.items() if (table := table_or_none(tables, name)) is not None]
    if not known:
        return None
    listings = tuple(listing for show, table in known for listing in show(table))
    return ReportSection(
        "during",
        "During the campaign",
        _opening_sentences(tables),
        listings=listings,
        statements=tuple(_statements(tables)),
    )


def _opening_sentences(tables: Tables) -> str:
    words = []
    surveys, names, repeats = (table_or_none(tables, name) for name in ("resurveys", "relabelled", "repeats"))
    if surveys is not None:
        moved = int(surveys["relocated"].sum())
        number = count_text(surveys["later_survey"].nunique(), "later survey")
        words.append(f"{number}: {count_text(moved, 'target')} moved" if moved else f"{number}: no target moved")
    if names is not None:
        words.append(
            f"{count_text(len(names), 'rule')} for names, applied to {count_text(int(names['rows'].sum()), 'point')}"
        )
    if repeats is not None:
        kinds = ", ".join(f"{kind}s" for kind in repeats["repeated"].unique())
        words.append(f"repeated measurements of {kinds}, identified by {repeats['told_by'].iloc[0]}")
    events_text = "; ".join(words)
    return f"{capitalised(events_text)}." if events_text else "Points with names that no survey contains."


def _statements(tables: Tables) -> list[tuple[str, str]]:
    """Return the statements that need attention."""
    texts = []
    names = table_or_none(tables, "likely_names")
    if names is not None:
        names_ = ", ".join(f"{r.called} at {r.target}" for r in names.head(8).itertuples())
        texts.append(("warn", f"Points with unknown names lie at missing targets: {names_}. Nothing was renamed."))
    surveys = table_or_none(tables, "resurveys")
    if surveys is not None:
        lost = surveys[surveys["relocated"] & surveys["holds_as"].isna()]
        if len(lost):
            names_ = ", ".join(f"{r.body} {r.target}" for r in lost.head(8).itertuples())
            texts.append(("warn", f"Targets moved, but campaign.toml does not declare from which pose on: {names_}."))
    differing_repeats = _repeats_that_differ(table_or_none(tables, "repeats"))
    if differing_repeats:
        names_ = ", ".join(list(differing_repeats.values())[:8])
        texts.append(
            (
                "warn",
                f"Groups of repeats scatter differently, so their pooled scatter represents none of them: {names_}.",
            )
        )
    return texts


def _surveys(table: pd.DataFrame) -> list[Listing]:
    heads = (
        Head("verdict", "Whether the target moved between two surveys."),
        Head("survey", "Later survey that is compared with the earlier one."),
        BODY,
        TARGET,
        *(Head(f"shift in {a} (mm)", "New minus earlier coordinate, with one standard deviation.") for a in _AXES),
        P,
        Head("holds as", "Name under which the new position is used, and from which pose on."),
    )
    rows, marks = [], []
    for r in table.itertuples():
        shift = [_shift(r, a) for a in _AXES]
        holds = "" if cell(r.holds_as) == "" else f"{r.holds_as} from pose {cell(r.from_pose)} on"
        rows.append((r.status, r.later_survey, r.body, r.target, *shift, p_value(r.p_value), holds))
        marks.append("none" if not r.relocated else "warn" if cell(r.holds_as) == "" else "pass")
    caption = "new minus earlier position, without the common motion of targets that did not move, ± one sigma"
    moved = [at for at, is_moved in enumerate(table["relocated"]) if is_moved]
    listing = Listing(
        heads, tuple(rows[k] for k in moved), tuple(marks[k] for k in moved), f"Targets that moved: {caption}"
    )
    surveys_listing = Listing(
        heads, tuple(rows), tuple(marks), f"All targets surveyed again: {caption}", True, "resurveys.parquet"
    )
    return [listing, surveys_listing] if moved else [surveys_listing]


def _shift(r: object, axis: str) -> str:
    shift, sigma = (getattr(r, f"{kind}_{axis}_mm") for kind in ("shift", "sigma"))
    return "–" if shift is None or shift != shift else with_uncertainty(shift, sigma)


def _names(table: pd.DataFrame) -> list[Listing]:
    rows = tuple((r.body, r.called, r.target, _poses(r), f"{r.rows:,}", cell(r.reason)) for r in table.itertuples())
    heads = (
        BODY,
        Head("name in the files", "Name of the target in the raw files."),
        Head("used as", "Name of the target in the survey, which all results use."),
        Head("poses", "Poses in which the name was changed."),
        Head("points", "Number of points whose name was changed."),
        Head("by whom, and why", "Person who decided, with the reason in campaign.toml."),
    )
    return [Listing(heads, rows, caption="Under other names", folded=len(rows) > _OPEN, held_by="relabelled.parquet")]


def _poses(r: object) -> str:
    start, end = cell(getattr(r, "from_pose", "")), cell(getattr(r, "to_pose", ""))
    return f"{f'from {start}' if start else ''} {f'to {end}' if end else ''}".strip() or "all"


def _suggested(table: pd.DataFrame) -> list[Listing]:
    """Return lines for campaign.toml, to be copied after a check by a person."""
    lines = [line for r in table.itertuples() for line in _toml(r)]
    caption = "For campaign.toml, after a check: these names may belong to these targets"
    return [Listing((_LINES,), tuple((line,) for line in lines), caption=caption, held_by="likely_names.parquet")]


_LINES = Head("lines", "Lines for campaign.toml, to be copied.")


def _toml(r: object) -> list[str]:
    keys = ("body", "target", "called", "from_pose", "to_pose")
    given = [(key, cell(getattr(r, key, ""))) for key in keys]
    return ["[[renamed]]", *(f"{key} = {_quoted(value)}" for key, value in given if value)]


def _quoted(text: str) -> str:
    """Return a text as a TOML string."""
    plain_text = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in plain_text) + '"'


def _repeats_that_differ(table: pd.DataFrame | None) -> dict[int, str]:
    """Return, by row label, the subjects of repeats whose groups scatter significantly differently."""
    if table is None or "p_equal" not in table:
        return {}
    rows = table[table["p_equal"] < _UNEQUAL]
    return dict(zip(rows.index.tolist(), rows["subject"].astype(str), strict=True))


def _by_pose(table: pd.DataFrame) -> list[Listing]:
    """Return a row per subject and pose, with figures and intervals."""
    rows = []
    for (subject, pose), group in table.groupby(["subject", "pose"], sort=False):
        reported = {r.figure: f"{quantity(r.value, r.unit)} ({quantity(r.low, r.unit)} … {quantity(r.high, r.unit)})"
                for r in group.itertuples()}  # fmt: skip
        figures = [reported.get(name, "–") for name in ("sigma", "RP", "RP_a", "RP_b", "RP_c")]
        rows.append((str(subject), str(pose), f"{group['attained'].iloc[0]}", *figures))
    heads = (
        Head("subject", "Body or point that was measured repeatedly."),
        POSE,
        Head("measured", "Number of measurements of the pose."),
        Head(
            "sigma of a coordinate", "Standard deviation of one coordinate between the repeats, with its 95 % interval."
        ),
        Head("RP", "Repeatability of the position by ISO 9283, with its 95 % interval."),
        *(
            Head(f"RP_{c}", f"Repeatability of the rotation about {a} by ISO 9283.")
            for c, a in zip("abc", "xyz", strict=True)
        ),
    )
    caption = "Repeatability pose by pose (ISO 9283: RP from five measurements on), with 95 % intervals"
    return [Listing(heads, tuple(rows), (), caption, len(rows) > _OPEN, "pose_repeatability.parquet")]


def _repeats(table: pd.DataFrame) -> list[Listing]:
    rows = []
    differ = _repeats_that_differ(table)
    marks = tuple("warn" if at in differ else "" for at in table.index.tolist())
    for r in table.itertuples():
        stated = r.declared_sigma if r.declared_sigma == r.declared_sigma else None
        ratio = plain(r.pure_error / stated) if stated else "–"
        interval = f"{quantity(r.lower, r.unit)} … {quantity(r.upper, r.unit)}"
        rows.append(
            (r.repeated, r.subject, quantity(r.pure_error, r.unit), interval, f"{r.freedom_of_error:.0f}",
             quantity(stated, r.unit), ratio, p_value(p) if (p := getattr(r, "p_equal", math.nan)) == p else "–")
        )  # fmt: skip
    heads = (
        Head("of", "Repeated quantity: pose, point, attachment, reading or signal."),
        Head("subject", "Body, point, leg or channel that was measured repeatedly."),
        Head("pure error (1 sigma)", "Standard deviation between repeated measurements."),
        Head("95 % interval", "Interval that holds the pure error with 95 % confidence, by the number of repeats."),
        FREEDOM,
        Head("stated (1 sigma)", "Standard deviation that campaign.toml or the adjustment states."),
        Head("ratio", "Pure error divided by the stated standard deviation; 1 if the stated one is right."),
        Head("equal groups, p", "Probability of such differences in scatter between groups if all scatter alike."),
    )
    number = int(table["groups"].max())
    caption = f"Pure error: the scatter of {number} repeated groups, identified by {table['told_by'].iloc[0]}"
    return [Listing(heads, tuple(rows), marks, caption, len(rows) > _OPEN, "repeats.parquet")]


def _fits(table: pd.DataFrame) -> list[Listing]:
    """Return a row per model, for the subject with the largest lack of fit against pure error, counted among all
    subjects."""
    rows, marks = [], []
    for (kind, model), group in table.groupby(["repeated", "contender"], sort=False):
        worst = group.loc[group["p_value"].idxmin()]
        p = min(1.0, len(group) * float(worst["p_value"]))
        leaves = p < _SURE
        marks.append("warn" if leaves else "pass")
        freedom = f"{worst['freedom_of_fit']:.1f}, {worst['freedom_of_error']:.0f}"
        text = "exceeds pure error" if leaves else "within pure error"
        rows.append((text, str(kind), str(model), str(worst["subject"]), plain(worst["f_ratio"]), freedom, p_value(p)))
    heads = (
        Head("verdict", "Whether the misfit of the model exceeds pure error."),
        Head("of", "Repeated quantity: pose, point, attachment, reading or signal."),
        Head("model", "Model whose residuals are compared with pure error."),
        Head("most at", "Subject with the most significant misfit."),
        Head("F", "Mean square of the residuals beyond pure error, divided by the mean square of pure error."),
        Head("degrees of freedom", "Degrees of freedom of the misfit, then of pure error."),
        Head(
            "p, all subjects counted", "Probability of so large an F by chance, multiplied by the number of subjects."
        ),
    )
    caption = "Lack of fit: residuals of each model on the fitted measurements, compared with pure error from repeats"
    return [Listing(heads, tuple(rows), tuple(marks), caption, len(rows) > _OPEN, "lack_of_fit.parquet")]
