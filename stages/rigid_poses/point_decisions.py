"""Points that a person excluded or kept, and the effects of the exclusions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Mask
from truing.estimation.rigid_poses.body_estimate import BodyEstimate, Points, estimate_body, largest_motion
from truing.estimation.rigid_poses.body_poses import PointDecisions
from truing.stages.common.manual_decisions import chosen_by, exclusion_row
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.estimation.rigid_poses.points import SurveyPoints
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule


def exclusion_rows(bodies: Sequence[tuple[BodyEstimate, SurveyPoints]], settings: Campaign) -> Rows:
    """A row per [[exclude]] and body that it concerns; all exclusions of a body are taken back together."""
    exclusions = []
    for body, survey in bodies:
        points, name = body.points, body.name
        named = [(n, rule, chosen_points(points, name, rule)) for n, rule in enumerate(settings.exclude, 1)]
        named = [entry for entry in named if entry[2].any()]
        if named:
            with_all = estimate_body(points, name, survey, None, body.kept)
            exclusions += [(number, _exclusion(number, rule, chosen, body, with_all)) for number, rule, chosen in named]
    rows = Rows("exclusion_effects")
    for _, row in sorted(exclusions, key=lambda numbered_row: numbered_row[0]):
        rows.add(**row)
    return rows


def _exclusion(
    number: int, rule: Overrule, chosen: Mask, body: BodyEstimate, with_all: BodyEstimate
) -> dict[str, object]:
    motion_m = largest_motion(body, with_all, np.flatnonzero(chosen.any(axis=1)))  # NaN: lost without these points
    sigma = float(np.sqrt(np.median(body.points.variance[body.points.is_observed]) / 3.0))
    return {
        **exclusion_row(number, rule, body.name, 1e3 * motion_m, motion_m / sigma),
        "rows": int(chosen.sum()),
        "gross_anyway": int((with_all.rejected & chosen).sum()),
        "unit": "mm",
    }


def decided_points(points: Points, body: str, rules: Iterable[Overrule], verb: str) -> PointDecisions | None:
    """The points of a body that rules name, None without rules; verb: excluded, or kept."""
    rules = list(rules)
    if not rules:
        return None
    return PointDecisions(
        *chosen_by(points.is_observed.shape, rules, verb, lambda rule: chosen_points(points, body, rule))
    )


def chosen_points(points: Points, body: str, rule: Overrule) -> Mask:
    """Return the mask (B, T) of points of a body that a rule matches; an absent key matches all, and a run matches
    none."""
    if rule.body not in (None, body):
        return np.zeros(points.is_observed.shape, bool)
    at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
    at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
    return np.asarray(at_pose[:, None] & at_target & points.is_observed)
