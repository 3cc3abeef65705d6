"""Published displacements next to those of the campaign: traces of the curves, listing and sentence."""

from __future__ import annotations

from collections.abc import Iterator

import plotly.graph_objects as go

from truing.report.column_heads import UNIT, Head
from truing.report.figure_style import GREEN
from truing.report.numbers import count_text, plain, with_uncertainty
from truing.report.page import Listing
from truing.report.tables import CHANNELS, LOADS, Row, Tables, cell, kilo, table_or_none

_LOOKS = {"theory": "published theory", "measurement": "published measurement"}
_MARKS = {"differs": "warn", "agrees": "pass"}
_NAMED = 3  # values that a sentence names at most


def published_pairs(tables: Tables) -> set[tuple[str, str]]:
    """Return load and channel of the published values along their load's own axis."""
    table = table_or_none(tables, "published_compared")
    pairs = set() if table is None else set(zip(table["load"], table["channel"], strict=True))
    return pairs & set(zip(LOADS, CHANNELS, strict=True))


def published_traces(tables: Tables, load: str, channel: str, shown: set[str]) -> Iterator[go.Scatter]:
    """Yield the published theory as a line through zero, and published measurements as points."""
    table = table_or_none(tables, "published_compared")
    if table is None:
        return
    rows = table[(table["load"] == load) & (table["channel"] == channel)]
    for source, name in _LOOKS.items():
        part = rows[rows["source"] == source]
        if not len(part):
            continue
        x, y = (1e-3 * part["applied"]).tolist(), part["published"].tolist()
        look: dict[str, object] = {"mode": "markers", "marker": {"symbol": "star-open", "size": 11, "color": "black"}}
        if source == "theory":
            x, y = [-x[0], x[0]], [-y[0], y[0]]
            look = {"mode": "lines", "line": {"color": GREEN, "width": 2, "dash": "dash"}}
        yield go.Scatter(
            x=x, y=y, name=name, legendgroup=name, showlegend=name not in shown,
            hovertemplate=f"{name}: %{{x:.4g}} → %{{y:.5g}}<extra></extra>", **look,
        )  # fmt: skip
        shown.add(name)


def published_listing(tables: Tables) -> Listing | None:
    """Return every published value, the value of this campaign at the same load, and the verdict."""
    table = table_or_none(tables, "published_compared")
    if table is None:
        return None
    rows, marks = [], []
    for row in table.itertuples():
        known = row.own == row.own
        sigma = row.own_sigma if row.own_sigma == row.own_sigma else None
        verdict = cell(row.verdict) or "not compared"
        rows.append(
            (
                cell(getattr(row, "published_in", None)) or "–",
                _called(row),
                row.source,
                f"{row.published:.6g}",
                with_uncertainty(row.own, sigma) if known else _why_not(row.source),
                str(row.unit),
                f"{100.0 * (row.published / row.own - 1.0):+.1f} %" if known and row.own else "–",
                f"± {plain(row.allowed_difference)}" if row.allowed_difference == row.allowed_difference else "–",
                verdict,
            )
        )
        marks.append(_MARKS.get(verdict, "none"))
    heads = (
        Head("figure", "Figure or table of the publication."),
        Head("displacement", "Component of the platform's motion, and the load under which it was taken."),
        Head("published as", "Whether the published value was computed (theory) or measured (measurement)."),
        Head("published", "Published value, in the unit of its row."),
        Head("this campaign", "The same quantity in this campaign: simulated for theory, measured for a measurement."),
        UNIT,
        Head("apart", "Published value minus that of this campaign, in per cent of the latter."),
        Head("allowed", "Difference that noise and tolerances of this campaign explain with 95 % probability."),
        Head("verdict", "Whether both values agree within the allowed difference."),
    )
    caption = (
        "Published values compared with this campaign: theory with the simulation; measured values with "
        "those measured here "
    )
    caption += "at the same load. Allowed: 95 %, by noise and tolerances"
    return Listing(heads, tuple(rows), tuple(marks), caption, held_by="published_compared.parquet")


def _why_not(source: str) -> str:
    return "no simulation" if source == "theory" else "beyond the loads applied"


def published_sentence(tables: Tables) -> list[str]:
    """Return the number of published values that this campaign reproduces, and the others, the worst first."""
    table = table_or_none(tables, "published_compared")
    if table is None:
        return []
    compared = table[table["verdict"].notna()]
    left = len(table) - len(compared)
    not_compared = f" Not compared: {count_text(left, 'published value')}." if left else ""
    if not len(compared):
        return [not_compared.strip()]
    differing = compared[compared["verdict"] == "differs"]
    if not len(differing):
        return [f"This campaign reproduces all {count_text(len(compared), 'published value')} compared.{not_compared}"]
    over = (differing["published"] - differing["own"]).abs() / differing["allowed_difference"]
    worst = differing.reindex(over.sort_values(ascending=False, kind="stable").index)
    named = ", ".join(f"{_called(row)} ({row.source})" for row in worst.head(_NAMED).itertuples())
    more = f" and {len(differing) - _NAMED} more" if len(differing) > _NAMED else ""
    agree = "none" if len(differing) == len(compared) else f"{len(compared) - len(differing)}"
    values = count_text(len(compared), "published value")
    return [f"This campaign reproduces {agree} of {values} compared; it differs in {named}{more}.{not_compared}"]


def _called(row: Row) -> str:
    """Return the name of a displacement: ``dz under fz +9 kN``."""
    return f"{row.channel} under {row.load} {1e-3 * row.applied:+.4g} {kilo(row.load)}"
