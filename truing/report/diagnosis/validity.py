"""Validity of findings in blocks that were left out, and measurements for a test where there were no blocks."""

from __future__ import annotations

import math
from collections.abc import Iterable

from truing.report.diagnosis.assessed_causes import EQUAL_ODDS, AssessedCause
from truing.report.diagnosis.prediction_errors import PartNames
from truing.report.numbers import plain

ONE_BLOCK, NONE = "one-block", "none"
_PARTS = {
    "series": "series",
    "run": "runs",
    "day": "days",
    "direction": "directions of approach",
}
# Words for regions, by the unit that is held out.
_REGIONS = {"pose": "regions of the workspace", "run": "ranges of the loads", "row": "ranges of the command"}
_MOST = 6.0  # largest power of ten of odds that is given


def held_out_sentences(findings: Iterable[AssessedCause], parts: PartNames) -> list[str]:
    """Return the sentences on blocks left out, and on findings without informative blocks."""
    rows = [row for row in findings if row.left_out_by]
    texts = _of_blocks([row for row in rows if row.left_out_gain is not None], parts)
    if one_block := dict.fromkeys(row.in_sentence for row in rows if row.left_out_by == ONE_BLOCK):
        texts.append(
            f"Not cross-validated: {'; '.join(one_block)}. The effect shows in only one series, run, day or region, or "
            "too weakly in each. A repetition on another day would test it."
        )
    if unknown := dict.fromkeys(row.in_sentence for row in rows if row.left_out_by == NONE):
        texts.append(
            f"Not cross-validated: {'; '.join(unknown)}. The campaign has fewer than three series, runs, days or "
            f"regions to leave out as a whole. Leaving out single {parts.single}s does not test whether an effect "
            f"holds elsewhere. {_to_measure(parts)}"
        )
    return texts


def _of_blocks(rows: list[AssessedCause], part_names_of_model: PartNames) -> list[str]:
    """Return in words the effect of findings on blocks that are predicted from the others, one text for each kind."""
    alike: dict[tuple[str, str], list[AssessedCause]] = {}
    for row in rows:
        gain = _gain(row)
        verb = "supports" if gain > 0.0 else "contradicts"
        verb = "does not decide about" if abs(gain) < math.log(EQUAL_ODDS) else verb
        parts = f"{row.left_out_blocks} {_PARTS.get(row.left_out_by, _REGIONS[part_names_of_model.single])}"
        alike.setdefault((verb, parts), []).append(row)
    texts = []
    for (verb, parts), causes in alike.items():
        names = "; ".join(f"{row.in_sentence} ({_odds(_gain(row))})" for row in causes)
        which_cause = "it" if len(causes) == 1 else "each of them"
        texts.append(
            f"Cross-validation {verb} {names}: {parts} that are sensitive to {which_cause} were left out in turn and "
            "predicted from the others."
        )
    return texts


def _gain(row: AssessedCause) -> float:
    """Return the log odds by blocks, at most those of all data.

    The form of a cause (an order, a time) may have been searched for in all data, the blocks included; only the
    evidence of all data is charged for this search.
    """
    gain = row.left_out_gain or 0.0
    return gain if row.evidence is None else min(gain, max(row.evidence, 0.0))


def _odds(gain: float) -> str:
    """Return the odds of a logarithm in words, for or against."""
    power = abs(gain) / math.log(10.0)
    rounded = f"{float(f'{10.0**power:.2g}'):,.0f}" if 1.0 < power <= _MOST else plain(10.0 ** min(power, 1.0))
    size = "more than 1,000,000" if power > _MOST else rounded
    return f"odds of {size} to 1 {'for' if gain >= 0.0 else 'against'} it"


def _to_measure(parts: PartNames) -> str:
    if parts.is_of_readings:
        return "To test it, apply loads in three runs or more, or in four ranges of loads, at least four steps each."
    return (
        f"To test it, measure at least four {parts.single}s on each of three days, or in each quarter of the workspace."
    )


def link_to_next_measurements(findings: Iterable[AssessedCause], parts: PartNames) -> tuple[tuple[str, str], ...]:
    """Return the section with measurements that would test findings without informative blocks."""
    untested = not parts.is_of_readings and any(row.left_out_by == NONE for row in findings)
    return (("next", "What to measure next"),) if untested else ()
