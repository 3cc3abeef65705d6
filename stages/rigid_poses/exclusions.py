"""What a person's exclusions change: every body once more with all of its points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.body_poses import BodyPoses, PointDecisions, fit_body, largest_motion
from truing.estimation.rigid_poses.points import PosePoints
from truing.stages.common.overruled import chosen_by, exclusion_row
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
        points, name = body.points, body.name
        named = [(n, rule, chosen_points(points, name, rule)) for n, rule in enumerate(settings.exclude, 1)]
        named = [one for one in named if one[2].any()]
        if named:
            with_all = fit_body(points, name, survey, None, decided_points(points, name, settings.keep, "kept"))
            found += [(number, _row(number, rule, chosen, body, with_all)) for number, rule, chosen in named]
    rows = Rows("exclusion_effects")
    for _, row in sorted(found, key=lambda one: one[0]):
        rows.add(**row)
    return rows


def _row(number: int, rule: Overrule, chosen: Mask, body: BodyPoses, with_all: BodyPoses) -> dict[str, object]:
    off = largest_motion(body, with_all)[chosen.any(axis=1)]  # NaN: a pose that is lost without these points
    sigma = float(np.sqrt(np.median(np.einsum("nii->n", body.points.cov[body.points.seen])) / 3.0))
    return {
        **exclusion_row(number, rule, body.name, 1e3 * off, off / sigma),
        "rows": int(chosen.sum()),
        "gross_anyway": int((with_all.rejected & chosen).sum()),
        "unit": "mm",
    }


def decided_points(points: PosePoints, body: str, rules: Iterable[Overrule], verb: str) -> PointDecisions:
    """The points of a body that rules name; verb: excluded, or kept."""
    return PointDecisions(*chosen_by(points.seen.shape, rules, verb, lambda rule: chosen_points(points, body, rule)))


def chosen_points(points: PosePoints, body: str, rule: Overrule) -> Mask:
    """(B, T) which points of a body a rule names; an absent key stands for all, and runs have none."""
    if rule.body not in (None, body):
        return np.zeros(points.seen.shape, bool)
    at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
    at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
    return np.asarray(at_pose[:, None] & at_target & points.seen)
