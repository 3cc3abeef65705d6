"""Checks of names that the survey lacks, and of targets at new positions in a later survey."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import pyarrow as pa

from truing.arrays import Mask, TableRow
from truing.estimation.rigid_poses.points import PosePoints
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.quality.bodies import BodyView, PoseSurroundings
from truing.report.numbers import listed
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.near_names import meant_by
from truing.schemas.sections import Overrule
from truing.stages.common.point_arrays import pose_points
from truing.stages.quality.check import FAIL, PASS, WARN, CampaignLimits, Check, not_evaluated

_NEAR = 10.0  # deviations of its mean place, as for labels that are exchanged
_NEAR_SHARE = 0.02  # of the distance to the nearest other target
_AXES = "xyz"


@dataclass(frozen=True)
class LikelyName:
    """Missing target, and an unknown name at its position from ``from_pose`` to ``to_pose`` (ids)."""

    body: str
    called: str
    target: str
    from_pose: int | str | None
    to_pose: int | str | None
    poses: int
    off_mm: float


def likely_names(
    observations: pa.Table, bodies: Sequence[BodyView], around: PoseSurroundings, declared: set[tuple[str, str]]
) -> list[LikelyName]:
    """Return unknown names at the position of a target that was observed in none of their poses.

    ``declared``: body and name of targets that are known under another name.
    """
    names_found, names = [], _names(observations)
    for body in bodies:
        known = {*body.survey.targets, *(name for owner, name in declared if owner == body.name)}
        unknown = tuple(name for name in names[body.name] if name not in known)
        if unknown:
            points = pose_points(observations, body.name, around.poses, unknown)
            names_found += [
                likely_name for at in range(len(unknown)) if (likely_name := _likely(body, points, at)) is not None
            ]
    return names_found


def _names(observations: pa.Table) -> dict[str, list[str]]:
    """Return the names of the observed targets by body, in order of appearance."""
    import pyarrow.compute as pc

    # Not by `group_by`, which loads pyarrow.acero: as long as the rest of pyarrow.
    bodies, targets = observations.column("body"), observations.column("target")
    names = pc.unique(bodies).to_pylist()
    return {body: pc.unique(targets.filter(pc.equal(bodies, body))).to_pylist() for body in names}


def _likely(body: BodyView, points: PosePoints, at: int) -> LikelyName | None:
    rows = np.flatnonzero(points.is_observed[:, at] & body.fit.ok)
    if not len(rows):
        return None
    seen = np.einsum("bij,bi->bj", body.fit.R[rows], points.points[rows, at] - body.fit.t[rows])
    off = np.linalg.norm(body.survey.points - np.median(seen, axis=0), axis=1)
    off[body.points.is_observed[rows].any(axis=0)] = np.inf  # both in one pose: two targets
    nearest = int(off.argmin())
    sigma = float(np.sqrt(np.trace(points.cov[rows[0], at]) + np.trace(body.survey.cov[nearest])))
    other_points = np.delete(body.survey.points, nearest, axis=0)
    distance = float(np.linalg.norm(other_points - body.survey.points[nearest], axis=1).min(initial=np.inf))
    if not off[nearest] < max(_NEAR * sigma, _NEAR_SHARE * distance):
        return None
    indices = np.flatnonzero(body.points.is_observed[:, nearest])
    before, after = (indices < rows[0]).any(), (indices > rows[-1]).any()
    poses = body.points.poses
    return LikelyName(
        body.name,
        points.targets[at],
        body.survey.targets[nearest],
        poses[rows[0]] if before else None,
        poses[rows[-1]] if after else None,
        len(rows),
        1e3 * float(off[nearest]),
    )


def names_known(
    observations: pa.Table, bodies: Sequence[BodyView], likely: Sequence[LikelyName], declared: set[tuple[str, str]]
) -> Iterator[Check]:
    """Yield one row per body, or one warning per unknown name at the position of a missing target."""
    names = _names(observations)
    for body in bodies:
        likely_of_body = [candidate for candidate in likely if candidate.body == body.name]
        for likely_name in likely_of_body:
            since = "" if likely_name.from_pose is None else f" from pose {likely_name.from_pose}"
            until = "" if likely_name.to_pose is None else f" to pose {likely_name.to_pose}"
            text = f"{body.name}: {likely_name.called} lies {likely_name.off_mm:.3f} mm from the place of "
            text += f"{likely_name.target}, which was not seen"
            text += f"{since}{until}: is it the same target? Nothing was renamed; add [[renamed]] if so."
            yield Check("names-known", f"target {likely_name.called}", float(likely_name.poses), 0.0, "1", WARN, text)
        if likely_of_body:
            continue
        if not body.is_surveyed:
            yield not_evaluated(
                "names of targets", "names-known", body.name, f"{body.name}: no survey names its targets"
            )
            continue
        unsurveyed = [n for n in names[body.name] if n not in body.survey.targets and (body.name, n) not in declared]
        text = f"{body.name}: all targets have names of the survey."
        if unsurveyed:
            are = "is" if len(unsurveyed) == 1 else "are"
            text = f"{body.name}: {listed(unsurveyed)} {are} in no survey, and not near a "
            text += f"missing target{meant_by(unsurveyed, body.survey.targets) or '.'}"
        yield Check("names-known", body.name, 0.0, 0.0, "1", PASS, text)


def declared_names(relabelled: pa.Table | None) -> set[tuple[str, str]]:
    """Return body and name of the targets that a declaration renames."""
    if relabelled is None:
        return set()
    return set(zip(relabelled.column("body").to_pylist(), relabelled.column("target").to_pylist(), strict=True))


def likely_table(likely: Sequence[LikelyName]) -> pa.Table:
    """Return the artifact likely_names."""
    rows: list[TableRow] = [
        {
            "body": candidate.body,
            "called": candidate.called,
            "target": candidate.target,
            "from_pose": None if candidate.from_pose is None else str(candidate.from_pose),
            "to_pose": None if candidate.to_pose is None else str(candidate.to_pose),
            "rows": candidate.poses,
            "distance_mm": candidate.off_mm,
        }
        for candidate in likely
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["likely_names"].arrow_schema())


def expected_visible(resurveys: pa.Table | None, body: BodyView, around: PoseSurroundings) -> Mask:
    """Return the mask (B, T) of targets that should be observed: a target at a new position from its pose on, the
    former one until then."""
    out = np.ones(body.points.is_observed.shape, bool)
    index_of = {name: at for at, name in enumerate(body.survey.targets)}
    since = {str(pose): at for at, pose in enumerate(around.poses)}
    rows = [] if resurveys is None else resurveys.to_pylist()
    carried_name = {name: name for name in index_of}
    for row in rows:
        if row["body"] != body.name or not row["holds_as"]:
            continue
        new, start = index_of.get(row["holds_as"]), since.get(str(row["from_pose"]))
        if start is None:  # no point of that very pose: since it was seen first
            start = 0 if new is None else int(body.points.is_observed[:, new].argmax())
        if new is not None:
            out[:start, new] = False
        if row["holds_as"] != row["target"] and (old := index_of.get(carried_name.get(row["target"], ""))) is not None:
            out[start:, old] = False
        carried_name[row["target"]] = row["holds_as"]
    return out


def between_appearances(is_observed: Mask) -> Mask:
    """Return the mask (B, T) of poses from the first to the last that shows a target, of observations (B, T).

    A single reflector is moved from place to place on a robot's tool: its later place was not due before.
    """
    since = np.maximum.accumulate(is_observed, axis=0)
    until = np.maximum.accumulate(is_observed[::-1], axis=0)[::-1]
    return np.asarray(since & until)


def later_surveys(resurveys: pa.Table | None, exclude: Sequence[Overrule], limits: CampaignLimits) -> Iterator[Check]:
    """Yield one row per body and survey, or per moved target; only a move that is not declared counts."""
    if resurveys is None or not resurveys.num_rows:
        yield not_evaluated(
            "a later survey", "resurvey", "", "the targets were surveyed once; survey them again at the end"
        )
        return
    for (survey, body), rows in groupby(resurveys.to_pylist(), key=lambda row: (row["later_survey"], row["body"])):
        yield from _check_later_survey(f"{body} survey {survey}", body, list(rows), exclude, limits)


def _check_later_survey(
    subject: str, body: str, rows: list[TableRow], exclude: Sequence[Overrule], limits: CampaignLimits
) -> Iterator[Check]:
    compared = [row for row in rows if row["shift_x_mm"] is not None]
    if not compared:
        yield _check_without_comparison(subject, rows)
        return
    moved = [row for row in compared if row["relocated"]]
    limit = limits.of("resurvey")
    for row in moved:
        size, ratio = _size(row), _over_sigma(row)
        is_taken_into_account = _taken_into_account(row, exclude)
        text = f"{body}: {row['target']} lies {size:.3f} mm elsewhere in survey {row['later_survey']} ("
        text += ", ".join(f"{row[f'shift_{a}_mm']:+.3f} ± {row[f'sigma_{a}_mm']:.3f}" for a in _AXES) + " mm); "
        text += (
            is_taken_into_account or "from which pose on is not declared, so its first position is used for all poses."
        )
        yield limit.row(
            f"target {row['target']} survey {row['later_survey']}",
            ratio,
            "sigma",
            text,
            counts=not is_taken_into_account,
        )
    if not moved:
        worst = max(compared, key=_over_sigma)
        text = f"{subject}: none of {len(compared)} targets moved, apart from their common motion; the largest shift "
        text += f"is {_size(worst):.3f} mm of {worst['target']} (p = {worst['p_value']:.2g})."
        yield limit.row(subject, 0.0, "sigma", text)


def _check_without_comparison(subject: str, rows: list[TableRow]) -> Check:
    """Return the check of a body whose targets could not be compared: too many moved, or too few define a frame."""
    status = FitStatus(rows[0]["status"])
    if status not in (FitStatus.NO_CONSENSUS, FitStatus.AMBIGUOUS):
        why = f"targets of both surveys that did not move define no frame ({status})"
        return not_evaluated("a later survey", "resurvey", subject, why)
    text = f"{subject}: targets have moved, but it cannot be determined which ({status}); "
    text += "the first survey is used for all poses."
    return Check("resurvey", subject, float(len(rows)), 0.0, "1", FAIL, text)


def _size(row: TableRow) -> float:
    return float(np.linalg.norm([row[f"shift_{a}_mm"] for a in _AXES]))


def _over_sigma(row: TableRow) -> float:
    return _size(row) / float(np.sqrt(np.mean([row[f"sigma_{a}_mm"] ** 2 for a in _AXES])))


def _taken_into_account(row: TableRow, exclude: Sequence[Overrule]) -> str:
    if row["holds_as"]:
        return f"from pose {row['from_pose']} on it is {row['holds_as']}."
    for rule in exclude:
        if rule.pose is None and rule.body in (None, row["body"]) and rule.target == row["target"]:
            return f"it was excluded by {rule.signed}."
    return ""
