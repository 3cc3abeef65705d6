"""Table of the numbers of a chain that its measurements do not separate, with what would separate them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from truing.report.column_heads import Head
from truing.report.numbers import count_text, plain
from truing.report.page import Listing
from truing.report.tables import Row

_NONE = "none"
_OWN = ("link", "offset")
_REMEDIES = {
    "poses": "other poses",
    "payload": "another payload",
    "base-targets": "targets of known place on the base",
    "target-places": "known places of the targets",
    _NONE: "no pose: together they move no target",
}
_MOST = 4  # numbers of links in a combination that is shown; the artifact holds all
_SINGLY = 2  # numbers of the base, or places of targets, that are named one by one
_MILLI = 1e3
_HEADS = (
    Head("change together", "Changes of numbers that together change no measurement, or too little to be seen."),
    Head("would separate them", "What a further campaign needs to separate these numbers."),
    Head(
        "pose", "Readings of a pose that would separate them, within the ranges of the joints; collisions not tested."
    ),
)


def inseparable_listing(table: pd.DataFrame, numbers: pd.DataFrame) -> Listing | None:
    """Return the combinations with a number that is not determined, those that other poses would separate first.

    ``numbers``: rows of chain_parameters. None where there are no combinations.
    """
    groups = _shown(table, numbers)
    if not groups:
        return None
    rows, marks = [], []
    for group in groups:
        remedy, pose = str(group["remedy"].iloc[0]), group["separating_pose"].iloc[0]
        rows.append((_together(group), _REMEDIES[remedy], pose if isinstance(pose, str) else "–"))
        marks.append("warn" if remedy == "poses" else "none")
    caption = "Numbers that these measurements do not separate"
    return Listing(_HEADS, tuple(rows), tuple(marks), caption, held_by="chain_inseparable.parquet")


def inseparable_words(table: pd.DataFrame, numbers: pd.DataFrame) -> str:
    """Return a sentence on the number of combinations by what would separate them; empty where there are none."""
    remedies = [str(group["remedy"].iloc[0]) for group in _shown(table, numbers)]
    if not remedies:
        return ""
    parts = [
        f"{remedies.count(key)} by {words}" for key, words in _REMEDIES.items() if key in remedies and key != _NONE
    ]
    left = remedies.count(_NONE)
    text = f"These poses do not separate {count_text(len(remedies), 'combination')} of numbers."
    text += f" Further data can separate {', '.join(parts)}." if parts else ""
    return f"{text} No pose of the joints separates {'the other ' if parts else ''}{left}." if left else text


def _shown(table: pd.DataFrame, numbers: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the combinations of few numbers of links, one of which the data do not determine."""
    unknown = {(r.joint, r.parameter) for r in numbers.itertuples() if not r.identifiable}
    groups = []
    for _, group in table.groupby("combination_number", sort=True):
        own = group[group["number_kind"].isin(_OWN)]
        named = set(zip(own["subject"], own["parameter"], strict=True))
        if 0 < len(own) <= _MOST and named & unknown:
            groups.append(group)
    return sorted(groups, key=lambda group: str(group["remedy"].iloc[0]) != "poses")


def _together(group: pd.DataFrame) -> str:
    """Return the members with their changes; many places of the base or of targets are named without changes.

    Changes are scaled: the largest angle of the links' numbers is 1 mrad or, without angles, their largest length 1 mm.
    """
    own = group[group["number_kind"].isin(_OWN)]
    angles, sizes = own["unit"] == "rad", own["number_change"].abs()
    scale = (1e-3 / sizes[angles].max()) if angles.any() else 1.0 / sizes.max()
    scale *= np.sign(own["number_change"].iloc[0])
    words = [_member(row, scale * row.number_change) for row in own.itertuples()]
    for kind, many in (("base", "the place of the base"), ("target", "the places of targets")):
        others = group[group["number_kind"] == kind]
        few = len(others) <= _SINGLY
        words += [_member(row, scale * row.number_change) for row in others.itertuples()] if few else [many]
    return ", ".join(words)


def _member(row: Row, change: float) -> str:
    size = f"{plain(_MILLI * change)} mrad" if row.unit == "rad" else _length(change)
    return f"{'+' if change > 0.0 else ''}{size.replace('-', '−')} {row.parameter} of {row.subject}"


def _length(change: float) -> str:
    return f"{plain(change)} mm" if abs(change) >= 1.0 else f"{plain(_MILLI * change)} µm"
