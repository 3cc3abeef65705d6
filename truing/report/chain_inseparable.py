"""Table of the numbers of a chain that its measurements do not separate, with what would separate them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from truing.report.heads import Head
from truing.report.numbers import count_text, plain
from truing.report.page import Listing
from truing.report.tables import Row

_REMEDIES = {
    "poses": "other poses",
    "payload": "another payload",
    "base-targets": "targets of known place on the base",
    "target-places": "known places of the targets",
    "none": "no pose: together they move no target",
}
_MOST = 4  # members of a combination that is shown: longer ones concern places of targets within their survey
_MILLI = 1e3
_HEADS = (
    Head("change together", "Changes of numbers that together move no measurement, or less than was known before."),
    Head("would separate them", "What a further campaign needs to separate these numbers."),
    Head(
        "pose", "Readings of a pose that would separate them, within the ranges of the joints; collisions not tested."
    ),
)


def inseparable_listing(table: pd.DataFrame) -> Listing | None:
    """Return the combinations, those that other poses would separate first; None where there are none."""
    groups = [group for _, group in table.groupby("combination_number", sort=True) if len(group) <= _MOST]
    if not groups:
        return None
    groups.sort(key=lambda group: str(group["remedy"].iloc[0]) != "poses")
    rows, marks = [], []
    for group in groups:
        remedy, pose = str(group["remedy"].iloc[0]), group["separating_pose"].iloc[0]
        rows.append((_together(group), _REMEDIES[remedy], pose if isinstance(pose, str) else "–"))
        marks.append("warn" if remedy == "poses" else "none")
    caption = "Numbers that these measurements do not separate"
    return Listing(_HEADS, tuple(rows), tuple(marks), caption, held_by="chain_inseparable.parquet")


def inseparable_words(table: pd.DataFrame) -> str:
    """Return a sentence on the number of combinations by what would separate them; empty where there are none."""
    groups = [group for _, group in table.groupby("combination_number", sort=True) if len(group) <= _MOST]
    remedies = [str(group["remedy"].iloc[0]) for group in groups]
    if not remedies:
        return ""
    parts = [
        f"{remedies.count(key)} by {words}" for key, words in _REMEDIES.items() if key != "none" and remedies.count(key)
    ]
    left = remedies.count("none")
    parts += [f"{left} by no pose of the joints"] if left else []
    total = count_text(len(remedies), "combination")
    return f"These poses do not separate {total} of numbers, which would be separated: {', '.join(parts)}."


def _together(group: pd.DataFrame) -> str:
    """Return the members with their changes, scaled to a largest angle of 1 mrad, or a largest length of 1 mm."""
    angles = group["unit"] == "rad"
    sizes = group["number_change"].abs()
    scale = (1e-3 / sizes[angles].max()) if angles.any() else 1.0 / sizes.max()
    first = np.sign(group["number_change"].iloc[-1]) or 1.0
    return ", ".join(_member(row, first * scale * row.number_change) for row in group.iloc[::-1].itertuples())


def _member(row: Row, change: float) -> str:
    size = f"{plain(_MILLI * change)} mrad" if row.unit == "rad" else _length(change)
    return f"{'+' if change > 0.0 else ''}{size.replace('-', '−')} {row.parameter} of {row.subject}"


def _length(change: float) -> str:
    return f"{plain(change)} mm" if abs(change) >= 1.0 else f"{plain(_MILLI * change)} µm"
