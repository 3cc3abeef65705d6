"""What a person's exclusions change: every body once more with all of its points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.responses.tables import Rows
from stages.rigid_poses.body_pose import BodyPoses, chosen_points, fit_body

if TYPE_CHECKING:
    from schemas.campaign import Campaign
    from stages.point_arrays import SurveyPoints

Array = NDArray[np.float64]


def exclusion_rows(bodies: Sequence[tuple[BodyPoses, SurveyPoints]], settings: Campaign) -> Rows:
    """A row per [[exclude]] and body that it concerns; all exclusions of a body are taken back together."""
    rows = Rows("exclusion_effects")
    for body, survey in bodies:
        named = [
            (number, rule, chosen_points(body.points, body.name, rule))
            for number, rule in enumerate(settings.exclude, 1)
        ]
        named = [(number, rule, chosen) for number, rule, chosen in named if chosen.any()]
        if not named:
            continue
        with_all = fit_body(body.points, body.name, survey, (), settings.keep)
        off = _moved(body, with_all)
        sigma = np.sqrt(np.median(np.einsum("nii->n", body.points.cov[body.points.seen])) / 3.0)
        for number, rule, chosen in named:
            poses = chosen.any(axis=1)
            largest = float(np.nanmax(off[poses], initial=0.0))
            rows.add(
                entry=f"exclude {number}",
                subject=body.name,
                by=rule.by,
                decided_on=None if rule.on is None else str(rule.on),
                reason=rule.reason,
                rows=int(chosen.sum()),
                gross_anyway=int((with_all.rejected & chosen).sum()),
                largest_change=1e3 * largest,
                unit="mm",
                over_sigma=largest / float(sigma),
            )
    return rows


def _moved(body: BodyPoses, other: BodyPoses) -> Array:
    """(B,) how far apart in m the two fits put the body at most, of the targets that were seen; NaN without both."""
    places = [np.einsum("bij,bti->btj", fit.R, body.points.points - fit.t[:, None]) for fit in (body.fit, other.fit)]
    distance = np.linalg.norm(places[0] - places[1], axis=-1)
    return np.where(body.points.seen, distance, 0.0).max(axis=1)
