"""Page that compares runs: changes, trends, verdicts, and all numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import Head
from truing.report.comparison.compared_runs import (
    RunComparison,
    accuracy,
    change_text,
    error_classes,
    number_name,
    quality,
    quality_words,
    requirement_words,
    unit_of,
    value_text,
)
from truing.report.diagnosis.assessed_causes import REMAINDER
from truing.report.diagnosis.pulls import pull_figure
from truing.report.figure_style import BAR, BLUE, GREEN, GREY, ORANGE, RED, figure_template, label, style
from truing.report.numbers import count_text
from truing.report.page import Listing, PageHead, ReportSection, Verdict
from truing.report.parameter_names import MEANING, kind_of
from truing.report.tables import Row, cell, table_or_none
from truing.report.wordings.catalogue import cause_of_subject
from truing.schemas.verdict import OF_MODEL

_NAMED = 3
_FOUND, _SUSPECTED = "found", "suspected"

_HELD_BY = "compared.parquet"
_SERIES = {"z": "each number separately", "jump": "the fewest changes that explain all of them"}
_RATE = "If nothing changed, at most 5 of 100 comparisons report a change, for any number of compared values."
_JUDGED = {
    True: (
        "all numbers together, with their correlations; tolerances and a survey that both runs share are not counted "
        "twice"
    ),
    False: "each number separately",
}

_NUMBER = Head("number", "Parameter of the machine or of an effect, or entry of a matrix.")
_CHANGE_HEADS = (
    Head("from, to", "Runs that are compared, the earlier one first."),
    _NUMBER,
    Head("changed by", "Estimated change, if only the numbers listed here changed, with one standard deviation."),
    Head("in sigma", "Change divided by its standard deviation."),
    Head("or instead", "Parameters whose change would explain the data equally well."),
    Head("value now", "Value in the later run, with one standard deviation."),
)
_EFFECT = Head("effect", "Cause by its id, with the leg, target or axis that it concerns.")
_LARGEST_Z = Head(
    "largest z", "Difference from the previous run in standard deviations, of the step where it is largest."
)
_LEFT_OUT = Head("left out", "Reason why the number was not compared in some step.")
_RUN_HEADS = (
    Head("run", "Name of the run on this page."),
    Head("folder", "Folder of the run, as given."),
    Head("version", "Version of truing that wrote the run."),
)

_MOST = 12  # most figures of a page
_LOOKS = (
    (BLUE, "circle"),
    (ORANGE, "square"),
    (GREEN, "diamond"),
    ("#CC79A7", "cross"),
    ("#56B4E9", "x"),
    (GREY, "triangle-up"),
)


def comparison_head(comparison: RunComparison) -> PageHead:
    """Return the head of the page with the main results."""
    steps = range(len(comparison.between))
    texts = [*_change_verdicts(comparison), *_incomplete(comparison)]
    texts += [*requirement_words(comparison), *quality_words(comparison)]
    assessed = sum(len(comparison.assessed(step)) for step in steps)
    changed = int(comparison.numbers["changed"].sum())
    tiles = (("runs", str(len(comparison.runs))), ("numbers compared", f"{assessed:,}"), ("changed", str(changed)))
    title = (
        " → ".join(run.label for run in comparison.runs) if len(comparison.runs) < 4 else f"{len(comparison.runs)} runs"
    )
    return PageHead(f"{title}: what has changed", tuple(texts), tiles)


def _change_verdicts(comparison: RunComparison) -> list[Verdict]:
    """Return the changes of numbers and of effects step by step; one sentence where nothing changed."""
    steps = range(len(comparison.between))
    changed_words = [("found", _step_words(comparison, step)) for step in steps if has_changed(comparison, step)]
    effects = {step: _effect_verdicts(comparison, step) for step in steps}
    unchanged_steps = [step for step in steps if not has_changed(comparison, step) and len(comparison.assessed(step))]
    silent = [step for step in unchanged_steps if not effects[step]]
    of_numbers = [
        ("pass", f"{comparison.pair(k)}: no change beyond chance in {_assessed(comparison, [k])} that both runs have.")
        for k in unchanged_steps
        if effects[k]
    ]
    texts = [*changed_words, *(effect for step in steps for effect in effects[step]), *of_numbers]
    if silent:
        pairs_text = f" ({', '.join(map(comparison.pair, silent))})" if texts or len(silent) < len(steps) else ""
        numbers = _assessed(comparison, silent)
        texts.append(("pass", f"Nothing has changed beyond chance{pairs_text}: {numbers} compared from run to run."))
    return texts + [
        ("none", f"{comparison.pair(step)}: {_why_words(comparison, step)}")
        for step in steps
        if comparison.between[step].why
    ]


def _assessed(comparison: RunComparison, steps: Sequence[int]) -> str:
    """Return the count of numbers that the steps compare: ``90 numbers``, ``80 to 90 numbers``."""
    assessed = [len(comparison.assessed(step)) for step in steps]
    return (
        count_text(assessed[0], "number") if len(set(assessed)) == 1 else f"{min(assessed)} to {max(assessed)} numbers"
    )


def _why_words(comparison: RunComparison, step: int) -> str:
    """Return in words the reason that numbers of a step were not assessed."""
    reason = "some numbers were not compared" if len(comparison.assessed(step)) else "no number was compared"
    return f"{reason}: {'; '.join(comparison.between[step].why)}."


def has_changed(comparison: RunComparison, step: int) -> bool:
    """Return True if anything changed from one run to the next."""
    return comparison.between[step].rebuilt or bool(comparison.assessed(step)["changed"].any())


def _step_words(comparison: RunComparison, step: int) -> str:
    """Return the numbers with significant changes, and the sizes of these."""
    assessed = comparison.assessed(step)
    changed = _largest_first(assessed[assessed["changed"]])
    if comparison.between[step].rebuilt:
        more = f" Beyond chance individually: {_largest_changes(changed)}." if len(changed) else ""
        change_text = "changed in too many places to name: it was rebuilt, or is another machine."
        return f"{comparison.pair(step)}: {change_text}{more}"
    sizes = f"{len(changed)} of {count_text(len(assessed), 'number')} changed: {_largest_changes(changed)}"
    return f"{comparison.pair(step)}: {sizes}."


def _largest_first(changed: pd.DataFrame) -> pd.DataFrame:
    jump = (changed["change"] / changed["sigma_change"]).fillna(changed["z"]).abs()
    return changed.assign(jump=jump).sort_values("jump", ascending=False, kind="stable", na_position="last")


def _largest_changes(changed: pd.DataFrame) -> str:
    most = "; ".join(
        f"{number_name(r)} by {change_text(r)}{_alternatives(r)}" for r in changed.head(_NAMED).itertuples()
    )
    return most + (f"; and {len(changed) - _NAMED} more" if len(changed) > _NAMED else "")


def _alternatives(row: object) -> str:
    alternatives = cell(getattr(row, "instead", None))
    return f" (or {alternatives}, which the campaigns cannot distinguish)" if alternatives else ""


def _effect_verdicts(comparison: RunComparison, step: int) -> list[Verdict]:
    """Return the effects that one of two runs found, and the other one neither found nor suspected."""
    before, after = (_effects_of_model(comparison, run) for run in (step, step + 1))
    pairs = {"found for the first time": (after, before), "no longer found": (before, after)}
    return [
        ("found", f"{comparison.pair(step)}: {words}: {', '.join(names)}.")
        for words, (own, other) in pairs.items()
        if (names := [name for name, verdict in own.items() if verdict == _FOUND and name not in other])
    ]


def _effects_of_model(comparison: RunComparison, run: int) -> dict[str, str]:
    """Return the effects in the model of a run, such as ``actuator gain (leg 3)``, with ``found`` or ``suspected``.

    What residuals depend on without the other effects is not in the model.
    """
    table = table_or_none(comparison.runs[run].tables, "diagnosis")
    if table is None:
        return {}
    rows = table[table["verdict"].isin((_FOUND, _SUSPECTED))]
    rows = rows[rows["reason_code"] != REMAINDER] if "reason_code" in rows else rows
    columns = (rows[name] for name in ("cause", "subject", "verdict"))
    return {cause_of_subject(str(c), cell(s)): str(verdict) for c, s, verdict in zip(*columns, strict=True)}


def _incomplete(comparison: RunComparison) -> Iterator[Verdict]:
    """Yield a warning of runs whose model as a whole does not fit."""
    labels = []
    for run in comparison.runs:
        table = table_or_none(run.tables, "verdict")
        rows = None if table is None else table[table["section"].isin(OF_MODEL)]
        if rows is not None and rows["state"].isin(("attention", "fails")).any():
            labels.append(run.label)
    if labels:
        what = "a difference may come from what the model lacks, not from the machine"
        yield "warn", f"The model does not hold as a whole in {', '.join(labels)}: {what}."


@figure_template()
def comparison_sections(comparison: RunComparison) -> list[ReportSection]:
    """Return the sections of changes, trends, verdicts, all numbers, and origin of the page."""
    parts = (
        *(
            _changes(comparison),
            _trends(comparison),
            _effects(comparison),
            accuracy(comparison),
            error_classes(comparison),
        ),
        *(quality(comparison), _numbers(comparison), _provenance(comparison)),
    )
    return [part for part in parts if part is not None]


def _changes(comparison: RunComparison) -> ReportSection:
    steps = range(len(comparison.between))
    lead = f"Each run is compared with the previous one: {_JUDGED[_is_mechanism(comparison)]}. {_RATE}"
    rows = [(step, r) for step in steps for r in comparison.assessed(step).itertuples() if r.changed]
    listing = Listing(
        _CHANGE_HEADS,
        tuple(
            (comparison.pair(step), number_name(r), change_text(r), _jump(r), cell(r.instead), value_text(r))
            for step, r in rows
        ),
        ("changed",) * len(rows),
        "What changed: the fewest numbers whose changes explain all differences" if _is_mechanism(comparison) else "",
        held_by=_HELD_BY,
    )
    assessed = any(len(comparison.assessed(step)) for step in steps)
    changed = any(has_changed(comparison, step) for step in steps)
    state = "changed" if changed else "pass" if assessed else "not evaluated"
    statements = tuple((_mark(comparison, step), _step(comparison, step)) for step in steps)
    return ReportSection(
        "changes", "What has changed", lead, tuple(_pulls(comparison)), (listing,) if rows else (), state, statements
    )


def _is_mechanism(comparison: RunComparison) -> bool:
    return bool((comparison.numbers["group"] == "geometry").any())


def _pulls(comparison: RunComparison) -> Iterator[tuple[object, str]]:
    """Return, for each step of a mechanism with changes, all numbers in standard deviations, and the changes."""
    for step in range(len(comparison.between)):
        if has_changed(comparison, step) and _is_mechanism(comparison):
            assessed = comparison.assessed(step)
            jumps = assessed.assign(jump=assessed["change"] / assessed["sigma_change"])
            title = label(f"{comparison.pair(step)}, in standard deviations")
            caption = "Correlated parameters may change together while each stays inside its own band."
            series = _SERIES if jumps["jump"].notna().any() else {"z": _SERIES["z"]}
            yield pull_figure(jumps, series, title, "change / its standard deviation"), caption


def _mark(comparison: RunComparison, step: int) -> str:
    return "found" if has_changed(comparison, step) else "pass" if len(comparison.assessed(step)) else "none"


def _step(comparison: RunComparison, step: int) -> str:
    if not len(comparison.assessed(step)):
        return f"{comparison.pair(step)}: {_why_words(comparison, step)}"
    rows = comparison.numbers[comparison.numbers["place"] == step + 2]
    words = (
        _step_words(comparison, step)
        if has_changed(comparison, step)
        else f"{comparison.pair(step)}: none of {count_text(len(comparison.assessed(step)), 'number')} changed."
    )
    left = rows[rows["z"].isna() & ~rows["changed"]]
    reasons = "; ".join(f"{n} {why}" for why, n in left["reason"].value_counts().items())
    return f"{words} Left out: {reasons}." if reasons else words


def _jump(r: Row) -> str:
    return f"{r.change / r.sigma_change:.1f}" if r.change == r.change else f"{r.z:.1f}"


def _trends(comparison: RunComparison) -> ReportSection | None:
    figures, left = _trend_figures(comparison)
    if not figures:
        return None
    lead = (
        "Each kind of parameter over the runs, in the given order; kinds with a change come first. "
        "Bars include prior knowledge, which is common to all runs; the section above decides on changes."
    )
    more = f" {count_text(left, 'further kind')}, which differ less, are in {_HELD_BY}." if left else ""
    more += f" Symbols: {MEANING}" if comparison.numbers["leg"].notna().any() else ""
    return ReportSection("trends", "Trends", lead + more, figures)


def _effects(comparison: RunComparison) -> ReportSection:
    names = [_effects_of_model(comparison, index) for index in range(len(comparison.runs))]
    every = list(dict.fromkeys(name for of_run in names for name in of_run))
    rows = tuple((name, *(of_run.get(name, "–") for of_run in names)) for name in every)
    if not rows:
        return ReportSection("effects", "Effects side by side", "No run found an effect.", state="pass")
    marks = tuple("none" if all(name in of_run for of_run in names) else "warn" for name in every)
    lead = (
        "Findings of each run. An effect found in one run may be present in the next one too; the comparison of "
        "numbers allows for both. The sizes are in the table of numbers."
    )
    heads = (_EFFECT, *comparison.heads("Whether the diagnosis of this run found or suspected the effect."))
    return ReportSection("effects", "Effects side by side", lead, listings=(Listing(heads, rows, marks),))


def _numbers(comparison: RunComparison) -> ReportSection | None:
    if not len(comparison.numbers):
        return None
    keys = ["group", "effect_of", "leg", "parameter"]
    rows, marks = [], []
    for _, group in comparison.numbers.groupby(keys, sort=False, dropna=False):
        by_place = {r.place: r for r in group.itertuples()}
        first = next(iter(by_place.values()))
        cells = [value_text(by_place[k]) if k in by_place else "–" for k in range(1, len(comparison.runs) + 1)]
        rows.append((number_name(first), *cells, _largest(group), _reasons(group)))
        marks.append("changed" if group["changed"].any() else "")
    values = comparison.heads("Value in this run, with one standard deviation.")
    heads = (_NUMBER, *values, _LARGEST_Z, _LEFT_OUT)
    listing = Listing(heads, tuple(rows), tuple(marks), f"All {len(rows)} numbers", True, _HELD_BY)
    lead = "Values with one standard deviation; z is the difference from the previous run over its standard deviation."
    return ReportSection("numbers", "Every number", lead, listings=(listing,))


def _largest(rows: pd.DataFrame) -> str:
    z = rows["z"].dropna()
    return f"{z.loc[z.abs().idxmax()]:.1f}" if len(z) else "–"


def _reasons(rows: pd.DataFrame) -> str:
    return "; ".join(dict.fromkeys(rows["reason"].dropna()))


def _provenance(comparison: RunComparison) -> ReportSection:
    rows = tuple((run.label, run.folder, run.version) for run in comparison.runs)
    lead = "The runs in the given order. Their folders were not changed."
    listing = Listing(_RUN_HEADS, rows)
    return ReportSection("provenance", "Provenance", lead, listings=(listing,))


def _trend_figures(comparison: RunComparison) -> tuple[tuple[tuple[go.Figure, str], ...], int]:
    """Return figures with captions, kinds with a change first, then the largest differences; and the
    number left out."""
    numbers = comparison.numbers[comparison.numbers["value"].notna()]
    numbers = numbers.assign(kind=[_kind(r) for r in numbers.itertuples()])
    known = numbers.groupby("kind", sort=False)["z"].transform(lambda z: z.notna().any())
    order = (
        numbers[known | numbers["changed"]]
        .assign(size=numbers["z"].abs())
        .groupby("kind", sort=False)
        .agg(changed=("changed", "any"), size=("size", "max"))
        .sort_values(["changed", "size"], ascending=False, kind="stable")
    )
    drawn = [_figure(comparison, numbers[numbers["kind"] == kind], str(kind)) for kind in order.index[:_MOST]]
    captions = [_caption(numbers[(numbers["kind"] == kind) & numbers["changed"]]) for kind in order.index[:_MOST]]
    return tuple(zip(drawn, captions, strict=True)), max(len(order) - _MOST, 0)


def _caption(changed: pd.DataFrame) -> str:
    """Return the meaning of the rings, and the reasons that may hide a change."""
    texts = []
    for r in changed.itertuples():
        together = cell(r.instead)
        why = f": correlated with {together}, so that the change is more certain than its bar shows" if together else ""
        texts.append(f"{number_name(r)} changed by {change_text(r)}{why}.")
    return f"Ringed: {' '.join(texts)}" if texts else ""


def _kind(row: Row) -> str:
    if row.group in ("compliance", "G_B"):
        head, _, tail = row.parameter.partition(" ")
        return (
            f"compliance by {tail}, {'rotations' if head[0] == 'r' else 'displacements'}"
            if (row.group == "compliance")
            else f"G_B, row {head}"
        )
    leg = row.leg if row.leg is not None else float("nan")
    kind = kind_of(row.parameter, leg)
    return f"{kind} of {row.effect_of}" if row.group == "effect" else kind


def _figure(comparison: RunComparison, numbers: pd.DataFrame, kind: str) -> go.Figure:
    figure = go.Figure()
    first = next(numbers.itertuples())
    lines = list(numbers.groupby(["leg", "parameter"], sort=False, dropna=False))
    shifts = [rows["value"] - _mean(rows) for _, rows in lines]
    factor, unit = unit_of(first, float(np.median(np.abs(np.concatenate([*shifts, numbers["sigma"]])))))
    if unit == "mm" and max(float(shift.abs().max()) for shift in shifts) * factor < 1.0:
        factor, unit = 1e3 * factor, "µm"
    aside = np.linspace(-0.18, 0.18, len(lines)) if len(lines) > 1 else np.zeros(1)
    for k, ((_, rows), shift) in enumerate(zip(lines, shifts, strict=True)):
        figure.add_trace(_line(rows, factor * shift, (factor, unit), aside[k], _LOOKS[k % len(_LOOKS)]))
    _ring(figure, lines, shifts, factor, aside)
    style(figure, label(kind), f"Each against its own mean over the runs, {unit or '1'}; bars: 95 %", 320)
    ticks = {
        "tickvals": list(range(1, len(comparison.runs) + 1)),
        "ticktext": [label(run.label) for run in comparison.runs],
    }
    figure.update_xaxes(**ticks, range=[0.6, len(comparison.runs) + 0.4], showgrid=False)
    figure.update_yaxes(title_text=f"shift, {unit or '1'}", zeroline=True, zerolinecolor=GREY)
    return figure


def _mean(rows: pd.DataFrame) -> float:
    """Return the mean of a number over the runs, weighted by its uncertainty."""
    sigma = rows["sigma"].to_numpy(float)
    usable = np.isfinite(sigma) & (sigma > 0.0)
    weight = 1.0 / sigma**2 if usable.all() else np.ones(len(rows))
    return float(np.average(rows["value"].to_numpy(float), weights=weight))


def _line(
    rows: pd.DataFrame, shift: pd.Series, printed_in: tuple[float, str], aside: float, look: tuple[str, str]
) -> go.Scatter:
    """Return the line of one number over the runs; ``printed_in``: factor and unit, ``look``: colour and symbol."""
    (factor, unit), (colour, symbol) = printed_in, look
    first = next(rows.itertuples())
    name = number_name(first) if rows["leg"].isna().all() else f"leg {int(first.leg)}"
    short = first.parameter if first.group in ("compliance", "G_B") else name
    return go.Scatter(
        x=rows["place"] + aside,
        y=shift,
        mode="lines+markers",
        name=label(short),
        line={"color": colour, "width": 1},
        marker={"color": colour, "symbol": symbol, "size": 8},
        error_y={"type": "data", "array": BAR * factor * rows["sigma"], "thickness": 1, "width": 3},
        hovertemplate=f"%{{y:.4g}} {unit}<extra>{label(name)}</extra>",
    )


def _ring(
    figure: go.Figure,
    lines: list[tuple[object, pd.DataFrame]],
    shifts: list[pd.Series],
    factor: float,
    aside: np.ndarray,
) -> None:
    """Draw rings around the numbers that changed."""
    points = [
        (index + aside[k], factor * value)
        for k, ((_, rows), shift) in enumerate(zip(lines, shifts, strict=True))
        for index, value, changed in zip(rows["place"], shift, rows["changed"], strict=True)
        if changed
    ]
    if points:
        x, y = zip(*points, strict=True)
        ring = {"symbol": "circle-open", "size": 18, "color": RED, "line": {"width": 2.5}}
        figure.add_trace(go.Scatter(x=x, y=y, mode="markers", name="changed", marker=ring, hoverinfo="skip"))
