"""Later surveys of the targets: who lies elsewhere than before, and whether the campaign takes that into account."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.estimation.rigid_poses.rigid import FitStatus
from truing.schemas.sections import Overrule
from truing.stages.quality.check import FAIL, Check, without
from truing.stages.quality.limits import CampaignLimits

if TYPE_CHECKING:
    import pyarrow as pa

_AXES = "xyz"


def later_surveys(resurveys: pa.Table | None, exclude: Sequence[Overrule], limits: CampaignLimits) -> Iterator[Check]:
    """A row per body and survey, or per target that moved; one whose old place still holds counts."""
    if resurveys is None or not resurveys.num_rows:
        yield without("a later survey", "resurvey", "", "the targets were surveyed once; survey them again at the end")
        return
    for (survey, body), rows in groupby(resurveys.to_pylist(), key=lambda row: (row["later_survey"], row["body"])):
        yield from _of_body(f"{body} survey {survey}", body, list(rows), exclude, limits)


def _of_body(
    subject: str, body: str, rows: list[dict[str, Any]], exclude: Sequence[Overrule], limits: CampaignLimits
) -> Iterator[Check]:
    compared = [row for row in rows if row["shift_x_mm"] is not None]
    if not compared:
        yield _untold(subject, rows)
        return
    moved = [row for row in compared if row["relocated"]]
    limit = limits.of("resurvey")
    for row in moved:
        size, ratio = _size(row), _over_sigma(row)
        taken = _taken_into_account(row, exclude)
        said = f"{body}: {row['target']} lies {size:.3f} mm elsewhere in survey {row['later_survey']} ("
        said += ", ".join(f"{row[f'shift_{a}_mm']:+.3f} ± {row[f'sigma_{a}_mm']:.3f}" for a in _AXES) + " mm); "
        said += taken or "since when is not said, and its first place holds for all poses."
        yield limit.row(f"target {row['target']} survey {row['later_survey']}", ratio, "sigma", said, counts=not taken)
    if not moved:
        worst = max(compared, key=_over_sigma)
        said = f"{subject}: all {len(compared)} targets lie where they did, their common motion taken out; most off is "
        said += f"{worst['target']}, by {_size(worst):.3f} mm (p = {worst['p_value']:.2g})."
        yield limit.row(subject, 0.0, "sigma", said)


def _untold(subject: str, rows: list[dict[str, Any]]) -> Check:
    """Of a body whose targets could not be compared one by one: something moved, or too little is there to tell."""
    status = FitStatus(rows[0]["status"])
    if status not in (FitStatus.NO_CONSENSUS, FitStatus.AMBIGUOUS):
        why = f"its targets of both surveys, but those known to have moved, fix no frame ({status})"
        return without("a later survey", "resurvey", subject, why)
    said = f"{subject}: targets lie otherwise than before, but which of them moved cannot be told ({status}); "
    said += "the first survey holds for all poses."
    return Check("resurvey", subject, float(len(rows)), 0.0, "1", FAIL, said)


def _size(row: dict[str, Any]) -> float:
    return float(np.linalg.norm([row[f"shift_{a}_mm"] for a in _AXES]))


def _over_sigma(row: dict[str, Any]) -> float:
    return _size(row) / float(np.sqrt(np.mean([row[f"sigma_{a}_mm"] ** 2 for a in _AXES])))


def _taken_into_account(row: dict[str, Any], exclude: Sequence[Overrule]) -> str:
    if row["holds_as"]:
        return f"from pose {row['from_pose']} on it is {row['holds_as']}."
    for rule in exclude:
        if rule.pose is None and rule.body in (None, row["body"]) and rule.target == row["target"]:
            return f"it was excluded by {rule.signed}."
    return ""
