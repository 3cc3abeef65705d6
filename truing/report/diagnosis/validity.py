"""Whether findings hold elsewhere: what was left out as a whole, and what to measure where nothing could be."""

from __future__ import annotations

import math
from collections.abc import Iterable

from truing.report.diagnosis.assessed_causes import EQUAL_ODDS, AssessedCause
from truing.report.diagnosis.prediction_errors import READINGS, PartNames
from truing.report.numbers import listed, plain

ONE_BLOCK, NONE = "one-block", "none"
_PARTS = {
    "series": "series",
    "run": "runs",
    "day": "days",
    "direction": "directions of approach",
}
# Of what regions are, by what is held out as a whole.
_REGIONS = {"pose": "regions of the workspace", "run": "ranges of the loads", "row": "ranges of the command"}
_MOST = 6.0  # decimal places of odds beyond which nobody needs more


def elsewhere(found: Iterable[AssessedCause], of: PartNames) -> list[str]:
    """The sentences on what was left out block by block, and on what no block could tell of."""
    rows = [row for row in found if row.left_out_by]
    texts = [_of_blocks(row, of) for row in rows if row.left_out_gain is not None]
    if lone := [row.name for row in rows if row.left_out_by == ONE_BLOCK]:
        texts.append(
            f"No two blocks tell of {listed(lone)}: the effect shows in one series, run, day or region alone, or too "
            "little in each. Whether it holds elsewhere, only a repetition on another day tells."
        )
    if unknown := [row.name for row in rows if row.left_out_by == NONE]:
        texts.append(
            "The campaign has no three series, runs, days or regions that could be left out as a whole, and "
            f"{of.single}s drawn from among the others cannot tell whether {listed(unknown)} holds elsewhere. "
            f"{_to_measure(of)}"
        )
    return texts


def _of_blocks(row: AssessedCause, of: PartNames) -> str:
    """What a finding does to blocks that are predicted from the others."""
    gain = row.left_out_gain or 0.0
    parts = f"each of the {row.left_out_blocks} {_PARTS.get(row.left_out_by, _REGIONS[of.single])} that tell of it"
    if abs(gain) < math.log(EQUAL_ODDS):
        return f"With {parts} left out in turn, the others do not tell whether {row.name} holds there ({_odds(gain)})."
    more = "more" if gain > 0.0 else "less"
    text = f"{row.name} makes them {more} probable ({_odds(gain)})"
    return f"With {parts} left out in turn and predicted from the others, {text}."


def _odds(gain: float) -> str:
    """The odds that a logarithm stands for, for or against."""
    power = abs(gain) / math.log(10.0)
    size = f"more than 10^{_MOST:.0f}" if power > _MOST else f"{10.0**power:.0f}" if power > 1.0 else plain(10.0**power)
    return f"odds of {size} to 1 {'for' if gain >= 0.0 else 'against'} it"


def _to_measure(of: PartNames) -> str:
    if of is READINGS:
        return "To tell, apply the loads in three runs or more, or in four ranges of loads, at least four steps each."
    return (
        f"To tell, measure at least four {of.single}s on each of three days, or in each quarter of the workspace; "
        "those under What to measure next serve."
    )
