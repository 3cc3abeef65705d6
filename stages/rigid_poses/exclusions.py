"""What a person's exclusions change: every body once more with all of its points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.body_poses import BodyPoses, PointDecisions, fit_body, largest_motion
from truing.estimation.rigid_poses.points import PosePoints
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.estimation.rigid_poses.points import SurveyPoints
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def exclusion_rows(bodies: Sequence[tuple[BodyPoses, SurveyPoints]], settings: Campaign) -> Rows:
    """A row per [[exclude]] and body that it concerns; all exclusions of a body are taken back together."""
    found = []
    for body, survey in bodies:
        named = [(number, rule, chosen_points(body.points, body.name, rule)) for number, rule in _numbered(settings)]
        named = [one for one in named if one[2].any()]
        if named:
            with_all = fit_body(
                body.points, body.name, survey, None, decided_points(body.points, body.name, settings.keep, "kept")
            )
            found += [(number, _row(number, rule, chosen, body, with_all)) for number, rule, chosen in named]
    rows = Rows("exclusion_effects")
    for _, row in sorted(found, key=lambda one: one[0]):
        rows.add(**row)
    return rows


def _numbered(settings: Campaign) -> list[tuple[int, Overrule]]:
    return list(enumerate(settings.exclude, 1))


def _row(number: int, rule: Overrule, chosen: Mask, body: BodyPoses, with_all: BodyPoses) -> dict[str, Any]:
    off = largest_motion(body, with_all)[chosen.any(axis=1)]
    told = off[np.isfinite(off)]  # a pose that is lost without these points has nothing to be compared with
    largest = float(told.max()) if len(told) else None
    sigma = float(np.sqrt(np.median(np.einsum("nii->n", body.points.cov[body.points.seen])) / 3.0))
    return {
        "entry": f"exclude {number}",
        "subject": body.name,
        "by": rule.by,
        "decided_on": None if rule.on is None else str(rule.on),
        "reason": rule.reason,
        "rows": int(chosen.sum()),
        "gross_anyway": int((with_all.rejected & chosen).sum()),
        "largest_change": None if largest is None else 1e3 * largest,
        "unit": "mm",
        "over_sigma": None if largest is None else largest / sigma,
    }


def decided_points(points: PosePoints, body: str, rules: Iterable[Overrule], verb: str) -> PointDecisions:
    """The points of a body that rules name; verb: excluded, or kept."""
    chosen = np.zeros(points.seen.shape, bool)
    words = np.full(points.seen.shape, "", dtype=object)
    for rule in rules:
        here = chosen_points(points, body, rule)
        chosen |= here
        words[here] = f"{verb} by {rule.signed}: {rule.reason}"
    return PointDecisions(chosen, words)


def chosen_points(points: PosePoints, body: str, rule: Overrule) -> Mask:
    """(B, T) which points of a body a rule names; an absent key stands for all, and runs have none."""
    if rule.body not in (None, body):
        return np.zeros(points.seen.shape, bool)
    at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
    at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
    return np.asarray(at_pose[:, None] & at_target & points.seen)
