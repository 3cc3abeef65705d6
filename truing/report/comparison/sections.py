"""The sections of a comparison's page, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from truing.report.comparison.compared_runs import Comparison, called, told, told_change
from truing.report.comparison.head import effects_found, has_changed, step_words, why_words
from truing.report.comparison.trends import trend_figures
from truing.report.comparison.verdicts import accuracy, error_classes, quality
from truing.report.diagnosis.pull_figure import pull_figure
from truing.report.figure_style import common_look, label
from truing.report.numbers import count
from truing.report.page import Listing, Section
from truing.report.tables import cell

if TYPE_CHECKING:
    import pandas as pd

_HELD_BY = "compared.parquet"
_SERIES = {"z": "each by itself", "jump": "the fewest changes that explain all of them"}
_RATE = "Where nothing changed, a change is told in 5 of 100 comparisons at most, however many numbers are compared."
_JUDGED = {
    True: (
        "all numbers at once, with their correlations: tolerances, and a survey that both rest on, draw both runs the "
        "same way and are not counted twice"
    ),
    False: "each number by itself",
}


@common_look()
def comparison_sections(found: Comparison) -> list[Section]:
    """Changes, trends, verdicts side by side, every number, and what the page was made from."""
    parts = (
        *(_changes(found), _trends(found), _effects(found), accuracy(found), error_classes(found)),
        *(quality(found), _numbers(found), _provenance(found)),
    )
    return [part for part in parts if part is not None]


def _changes(found: Comparison) -> Section:
    steps = range(len(found.between))
    lead = f"Each run against the one before, {_JUDGED[_is_mechanism(found)]}. {_RATE}"
    rows = [(step, r) for step in steps for r in found.judged(step).itertuples() if r.changed]
    listing = Listing(
        ("from, to", "number", "changed by", "in sigma", "or instead", "value now"),
        tuple((found.pair(step), called(r), told_change(r), _jump(r), cell(r.instead), told(r)) for step, r in rows),
        ("fail",) * len(rows),
        "What changed: the fewest numbers whose changes explain all differences" if _is_mechanism(found) else "",
        held_by=_HELD_BY,
    )
    judged = any(len(found.judged(step)) for step in steps)
    changed = any(has_changed(found, step) for step in steps)
    state = "changed" if changed else "pass" if judged else "not evaluated"
    said = tuple((_mark(found, step), _step(found, step)) for step in steps)
    return Section("changes", "What has changed", lead, tuple(_pulls(found)), (listing,) if rows else (), state, said)


def _is_mechanism(found: Comparison) -> bool:
    return bool((found.numbers["group"] == "geometry").any())


def _pulls(found: Comparison) -> Iterator[tuple[object, str]]:
    """Of each step of a mechanism in which something changed: every number in standard deviations, and the changes."""
    for step in range(len(found.between)):
        if has_changed(found, step) and _is_mechanism(found):
            judged = found.judged(step)
            jumps = judged.assign(jump=judged["change"] / judged["sigma_change"])
            title = label(f"{found.pair(step)}, in standard deviations")
            caption = "Numbers that are told only together may change without leaving the band each by itself."
            series = _SERIES if jumps["jump"].notna().any() else {"z": _SERIES["z"]}
            yield pull_figure(jumps, series, title, "change / its standard deviation"), caption


def _mark(found: Comparison, step: int) -> str:
    return "found" if has_changed(found, step) else "pass" if len(found.judged(step)) else "none"


def _step(found: Comparison, step: int) -> str:
    if not len(found.judged(step)):
        return f"{found.pair(step)}: {why_words(found, step)}"
    own = found.numbers[found.numbers["place"] == step + 2]
    words = (
        step_words(found, step)
        if has_changed(found, step)
        else f"{found.pair(step)}: none of {count(len(found.judged(step)), 'number')} changed."
    )
    left = own[own["z"].isna() & ~own["changed"]]
    reasons = "; ".join(f"{n} {why}" for why, n in left["reason"].value_counts().items())
    return f"{words} Left out: {reasons}." if reasons else words


def _jump(r: Any) -> str:
    return f"{r.change / r.sigma_change:.1f}" if r.change == r.change else f"{r.z:.1f}"


def _trends(found: Comparison) -> Section | None:
    figures, left = trend_figures(found)
    if not figures:
        return None
    lead = (
        "Every kind of number over the runs, in the order in which they were named; kinds with a change come first. "
        "A bar holds what was known beforehand, too, in which all runs err alike: the judgement is that above."
    )
    more = f" {count(left, 'kind')} more, which differ less, are in {_HELD_BY}." if left else ""
    return Section("trends", "Trends", lead + more, figures)


def _effects(found: Comparison) -> Section:
    names = [effects_found(found, place) for place in range(len(found.runs))]
    every = list(dict.fromkeys(name for own in names for name in own))
    labels = tuple(run.label for run in found.runs)
    rows = tuple((name, *("found" if name in own else "–" for own in names)) for name in every)
    if not rows:
        return Section("effects", "Effects side by side", "No run found an effect.", state="pass")
    marks = tuple("none" if all(name in own for own in names) else "warn" for name in every)
    lead = (
        "What the diagnosis of each run found. An effect that one run found and its neighbour did not may be there in "
        "both: numbers are judged with that left open. Sizes stand among the numbers."
    )
    return Section("effects", "Effects side by side", lead, listings=(Listing(("effect", *labels), rows, marks),))


def _numbers(found: Comparison) -> Section | None:
    if not len(found.numbers):
        return None
    keys = ["group", "effect_of", "leg", "parameter"]
    rows, marks = [], []
    for _, own in found.numbers.groupby(keys, sort=False, dropna=False):
        by_place = {r.place: r for r in own.itertuples()}
        first = next(iter(by_place.values()))
        cells = [told(by_place[k]) if k in by_place else "–" for k in range(1, len(found.runs) + 1)]
        rows.append((called(first), *cells, _largest(own), _reasons(own)))
        marks.append("fail" if own["changed"].any() else "")
    heads = ("number", *(run.label for run in found.runs), "largest z", "left out")
    listing = Listing(heads, tuple(rows), tuple(marks), f"All {len(rows)} numbers", True, _HELD_BY)
    lead = "Values with one standard deviation; z is the difference from the run before over its own sigma."
    return Section("numbers", "Every number", lead, listings=(listing,))


def _largest(own: pd.DataFrame) -> str:
    z = own["z"].dropna()
    return f"{z.loc[z.abs().idxmax()]:.1f}" if len(z) else "–"


def _reasons(own: pd.DataFrame) -> str:
    return "; ".join(dict.fromkeys(own["reason"].dropna()))


def _provenance(found: Comparison) -> Section:
    rows = tuple((run.label, run.folder, run.version) for run in found.runs)
    lead = "The runs in the order in which they were named. Nothing in their folders was changed."
    listing = Listing(("run", "folder", "version"), rows)
    return Section("provenance", "Provenance", lead, listings=(listing,))
