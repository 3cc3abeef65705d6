"""What a person's exclusions change: every body once more with all of its points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.common.rows import Rows
from stages.rigid_poses.body_pose import BodyPoses, chosen_points, fit_body

if TYPE_CHECKING:
    from schemas.campaign import Campaign
    from schemas.sections import Overrule
    from stages.common.point_arrays import SurveyPoints

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def exclusion_rows(bodies: Sequence[tuple[BodyPoses, SurveyPoints]], settings: Campaign) -> Rows:
    """A row per [[exclude]] and body that it concerns; all exclusions of a body are taken back together."""
    found = []
    for body, survey in bodies:
        named = [(number, rule, chosen_points(body.points, body.name, rule)) for number, rule in _numbered(settings)]
        named = [one for one in named if one[2].any()]
        if named:
            with_all = fit_body(body.points, body.name, survey, (), settings.keep)
            found += [(number, _row(number, rule, chosen, body, with_all)) for number, rule, chosen in named]
    rows = Rows("exclusion_effects")
    for _, row in sorted(found, key=lambda one: one[0]):
        rows.add(**row)
    return rows


def _numbered(settings: Campaign) -> list[tuple[int, Overrule]]:
    return list(enumerate(settings.exclude, 1))


def _row(number: int, rule: Overrule, chosen: Mask, body: BodyPoses, with_all: BodyPoses) -> dict[str, Any]:
    off = _moved(body, with_all)[chosen.any(axis=1)]
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


def _moved(body: BodyPoses, other: BodyPoses) -> Array:
    """(B,) how far apart in m the two fits put the body at most, of the targets that were seen; NaN without both."""
    places = [np.einsum("bij,bti->btj", fit.R, body.points.points - fit.t[:, None]) for fit in (body.fit, other.fit)]
    distance = np.linalg.norm(places[0] - places[1], axis=-1)
    return np.where(body.points.seen, distance, 0.0).max(axis=1)
