"""The checks of a campaign's quality: each gives a value, a limit, a verdict and one sentence.

A failing check gates the exit code, so together they may trip on one good campaign in a hundred at most: that budget
(``[qa] false_alarm``) is shared out among the checks that rest on chance, and within a check among its
subjects. Checks that only warn are held at ten times their share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.quality_bodies import BodyView, Surroundings
from truing.estimation.frame import redundancy
from truing.estimation.quality import (
    Scatter,
    body_shape,
    exchanged_pairs,
    find_drift,
    find_steps,
    isolated,
    repeated_groups,
    successive_sigma,
    unexplained_scatter,
)

Array = NDArray[np.float64]

PASS, WARN, FAIL, NOT_EVALUATED = "pass", "warn", "fail", "not evaluated"

_CHANCE_CHECKS = 3  # noise per body, noise per pose, repeatability: the failing checks that chance can trip
_NOISE_TOLERATED = 1.5  # beyond this multiple of the declared noise the declaration is unusable
_AXIS_NOISE_TOLERATED = 2.5  # photogrammetry is worse in depth, and one declared number stands for all axes
_NOISE_NOTED = 1.1
_POSE_NOISE_TOLERATED = 3.0
_ODD_POSE = 1e-6
_ODD_POSES_FAIL = 0.1
_LOST_WARN = 0.05
_MISSING_WARN, _MISSING_FAIL = 0.1, 0.3
_GROSS_WARN, _GROSS_FAIL = 0.05, 0.15
_SPREAD_IN_SIGMA = 5.0  # below it the roll about the line is known to some 5 degrees at best
_NEARLY_PLANAR = 0.01
_LEVERAGE = 0.9


@dataclass(frozen=True)
class Check:
    """One row of qa.parquet."""

    check: str
    subject: str
    value: float | None
    limit: float | None
    unit: str
    verdict: str
    message: str


def all_checks(bodies: Sequence[BodyView], around: Surroundings, actuator_mm: float, budget: float) -> Iterator[Check]:
    """Every check, body by body, then those of the campaign as a whole."""
    share = budget / _CHANCE_CHECKS
    for body in bodies:
        yield from completeness(body)
        yield from geometry(body)
        yield from gross_errors(body)
        yield from exchanged_labels(body, around)
        yield from moved_targets(body, around, 10.0 * share / len(bodies))
        yield from noise(body, around, share / len(bodies))
        yield from noise_by_pose(body, around, share / len(bodies))
    yield from base_drift(bodies[0], 10.0 * share)
    yield from repeatability(bodies, around, actuator_mm, share)
    yield time_gaps(around)
    yield temperature_span(around)


def completeness(body: BodyView) -> Iterator[Check]:
    """Targets seen per pose, and poses without a frame."""
    seen = body.points.seen
    share = 1.0 - float(seen.mean())
    verdict = FAIL if share > _MISSING_FAIL else WARN if share > _MISSING_WARN else PASS
    yield Check(
        "completeness",
        body.name,
        share,
        _MISSING_FAIL,
        "1",
        verdict,
        f"{body.name}: {int((~seen).sum())} of {seen.size} target readings are missing "
        f"({seen.shape[1]} targets, {seen.shape[0]} poses).",
    )
    lost = [str(p) for p, ok in zip(body.points.poses, body.fit.ok, strict=True) if not ok]
    yield Check(
        "poses-determined",
        body.name,
        float(len(lost)),
        _MISSING_FAIL * len(seen),
        "1",
        FAIL if len(lost) > _MISSING_FAIL * len(seen) else WARN if len(lost) > _LOST_WARN * len(seen) else PASS,
        f"{body.name}: every pose can be determined."
        if not lost
        else f"{body.name}: {len(lost)} poses have too few usable targets ({_listed(lost)}).",
    )


def geometry(body: BodyView) -> Iterator[Check]:
    """Whether the targets fix a frame: spread across a line and a plane, and no single target on which it hangs."""
    points = body.survey.points[body.frame]
    if len(points) < 3:
        yield Check(
            "geometry", body.name, float(len(points)), 3.0, "1", FAIL, f"{body.name}: fewer than three targets."
        )
        return
    shape = body_shape(points)
    across, thick = shape.extents[1] / shape.extents[0], shape.extents[2] / shape.extents[0]
    sigma = float(np.median(body.sigma))
    in_line = shape.extents[1] < _SPREAD_IN_SIGMA * sigma
    yield Check(
        "geometry-line",
        body.name,
        float(shape.extents[1] * 1e3),
        _SPREAD_IN_SIGMA * sigma * 1e3,
        "mm",
        FAIL if in_line else PASS,
        f"{body.name}: targets spread {shape.extents[0] * 1e3:.1f} x {shape.extents[1] * 1e3:.1f} x "
        f"{shape.extents[2] * 1e3:.1f} mm (rms){': nearly in line, the roll is free' if in_line else ''}.",
    )
    flat = len(points) > 3 and thick < _NEARLY_PLANAR
    yield Check(
        "geometry-plane",
        body.name,
        float(thick),
        _NEARLY_PLANAR,
        "1",
        WARN if flat else PASS,
        f"{body.name}: thickness over length {thick:.3f}, width over length {across:.3f}"
        f"{': nearly planar, mirrored labels would not be noticed' if flat else ''}.",
    )
    worst = int(shape.leverage.argmax())
    heavy = len(points) > 3 and shape.leverage[worst] > _LEVERAGE
    name = np.array(body.survey.targets, dtype=object)[body.frame][worst]
    yield Check(
        "geometry-leverage",
        f"target {name}",
        float(shape.leverage[worst]),
        _LEVERAGE,
        "1",
        WARN if heavy else PASS,
        f"{body.name}: the frame hangs most on target {name}, of whose own error {100 * shape.leverage[worst]:.0f} % "
        "stays in it.",
    )


def gross_errors(body: BodyView) -> Iterator[Check]:
    """Share of targets far from their place; a few per cent are ordinary."""
    seen = int(body.points.seen.sum())
    share = float(body.gross.sum()) / max(seen, 1)
    verdict = FAIL if share > _GROSS_FAIL else WARN if share > _GROSS_WARN else PASS
    per_target = body.gross.sum(axis=0)
    often = [f"{body.survey.targets[t]} ({per_target[t]})" for t in np.argsort(-per_target)[:5] if per_target[t] > 0]
    tail = f", most often {', '.join(often)}" if often else ""
    yield Check(
        "gross-errors",
        body.name,
        share,
        _GROSS_FAIL,
        "1",
        verdict,
        f"{body.name}: {int(body.gross.sum())} of {seen} readings are far from their place{tail}.",
    )


def exchanged_labels(body: BodyView, around: Surroundings) -> Iterator[Check]:
    """Pairs of targets that lie on each other's places."""
    source = body.survey.points
    expected = body.fit.apply(np.broadcast_to(source, body.points.points.shape))
    ok = body.gross & body.fit.ok[:, None]
    limit = np.maximum(10.0 * np.sqrt((body.sigma**2).sum(axis=2)), 0.02 * _nearest_neighbour(source))
    pairs = exchanged_pairs(np.nan_to_num(expected), body.points.points, ok, limit)
    if not pairs:
        yield Check("exchanged-labels", body.name, 0.0, 0.0, "1", PASS, f"{body.name}: no labels are exchanged.")
    for a, b in sorted({(a, b) for _, a, b in pairs}):
        poses = [str(around.poses[p]) for p, i, j in pairs if (i, j) == (a, b)]
        names = f"{body.survey.targets[a]} {body.survey.targets[b]}"
        yield Check(
            "exchanged-labels",
            f"targets {names}",
            float(len(poses)),
            0.0,
            "1",
            FAIL,
            f"{body.name}: the labels {names} are exchanged in pose {_listed(poses)}.",
        )


def moved_targets(body: BodyView, around: Surroundings, share: float) -> Iterator[Check]:
    """Targets that sit elsewhere from some pose on, with the pose and the shift."""
    seen = body.points.seen & body.fit.ok[:, None]
    own = np.maximum(body.sigma, successive_sigma(body.residuals, seen)[None])
    kept = seen & ~isolated(body.residuals, own, seen, limit=4.0)
    step = find_steps(body.residuals, own, kept)
    moved = np.nonzero(step.p_value < share / max(len(body.survey.targets), 1))[0]
    shifted = [
        t for t in moved if not _is_trend(body.residuals[:, t], own[:, t], kept[:, t], around.time, step.onset[t])
    ]
    if not shifted:
        yield Check("moved-targets", body.name, 0.0, 0.0, "1", PASS, f"{body.name}: no target has moved on its body.")
    for t in shifted:
        d = step.size[t] * 1e3
        size = float(np.linalg.norm(d))
        yield Check(
            "moved-targets",
            f"target {body.survey.targets[t]}",
            size,
            0.0,
            "mm",
            WARN,
            f"{body.name}: target {body.survey.targets[t]} sits {size:.3f} mm elsewhere "
            f"({d[0]:+.3f}, {d[1]:+.3f}, {d[2]:+.3f}) "
            f"from pose {around.poses[step.onset[t]]} on.",
        )


def _is_trend(values: Array, sigma: Array, kept: NDArray[np.bool_], time: Array, onset: int) -> bool:
    """Whether a straight line in time explains the values (B, 3) better than the step at ``onset``."""
    left = []
    for shape in ((np.arange(len(time)) >= onset).astype(float), time):
        design = np.column_stack([np.ones(int(kept.sum())), shape[kept]])
        fitted = design @ np.linalg.lstsq(design, values[kept], rcond=None)[0]
        left.append((((values[kept] - fitted) / sigma[kept]) ** 2).sum())
    return bool(left[1] < left[0])


def noise(body: BodyView, around: Surroundings, share: float) -> Iterator[Check]:
    """Estimated against declared noise per axis, of what follows neither drives, time nor temperature."""
    good = body.good & body.frame & ~_odd_poses(_scatter_by_pose(body))[:, None]
    if good.sum() < 12:
        yield _without(f"noise of {body.name}", "noise", body.name, "too few readings")
        return
    part = redundancy(body.survey.points[body.frame], good[:, body.frame])
    scatter = unexplained_scatter(
        body.residuals[:, body.frame], body.measured_sigma[:, body.frame], part, around.covariates
    )
    yield _noise_check(body.name, "", _pooled(scatter), _NOISE_TOLERATED, share / 2)
    for k, axis in enumerate("xyz"):
        one = Scatter(scatter.chi_square[k : k + 1], scatter.dof[k : k + 1])
        yield _noise_check(body.name, axis, one, _AXIS_NOISE_TOLERATED, share / 6)


def _pooled(scatter: Scatter) -> Scatter:
    return Scatter(scatter.chi_square.sum(keepdims=True), scatter.dof.sum(keepdims=True))


def _noise_check(body: str, axis: str, scatter: Scatter, tolerated: float, share: float) -> Check:
    ratio = float(scatter.ratio[0])
    failing = scatter.p_above(tolerated)[0] < share
    verdict = FAIL if failing else WARN if _noted(scatter, share)[0] else PASS
    where = f"the scatter along {axis}" if axis else "the scatter"
    sentence = f"{body}: {where} is {ratio:.2f} times the declared noise ({scatter.dof[0]:.0f} degrees of freedom)."
    return Check("noise", f"{body} {axis}".strip(), ratio, tolerated, "1", verdict, sentence)


def _noted(scatter: Scatter, share: float) -> NDArray[np.bool_]:
    """Noise that differs from the declared by more than a tenth, beyond chance."""
    return (scatter.p_above(_NOISE_NOTED) < share) | (scatter.p_below(1.0 / _NOISE_NOTED) < share)


def noise_by_pose(body: BodyView, around: Surroundings, share: float) -> Iterator[Check]:
    """Poses whose residuals are larger than the body's own scatter: one is a pose to look at, many are no campaign."""
    scatter = _scatter_by_pose(body)
    judged = scatter.dof > 0.0
    if judged.sum() < 3:
        yield _without(f"noise by pose of {body.name}", "noise-by-pose", body.name, "too few targets per pose")
        return
    odd = _odd_poses(scatter)
    much = scatter.p_above(_POSE_NOISE_TOLERATED) < share / judged.sum()
    worst = int(np.argmax(np.where(judged, np.nan_to_num(scatter.ratio), -1.0)))
    failing = much.sum() > _ODD_POSES_FAIL * judged.sum()
    yield Check(
        "noise-by-pose",
        f"{body.name} pose {around.poses[worst]}",
        float(scatter.ratio[worst]),
        _POSE_NOISE_TOLERATED,
        "1",
        FAIL if failing else WARN if odd.any() else PASS,
        f"{body.name}: the noisiest pose is {around.poses[worst]}, {scatter.ratio[worst]:.2f} times the ordinary "
        f"scatter; {int(odd.sum())} of {int(judged.sum())} poses stand out.",
    )


def _scatter_by_pose(body: BodyView) -> Scatter:
    """Chi-square of each pose's residuals in units of the body's ordinary scatter, the median over its poses."""
    good = body.good & body.frame
    dof = np.maximum(3.0 * good.sum(axis=1) - 6.0, 0.0)
    square = np.where(good[..., None], (body.residuals / body.sigma) ** 2, 0.0).sum(axis=(1, 2))
    judged = dof > 0.0
    level = max(1.0, float(np.median(square[judged] / dof[judged]))) if judged.any() else 1.0
    return Scatter(np.where(judged, square / level, 0.0), dof)


def _odd_poses(scatter: Scatter) -> NDArray[np.bool_]:
    """Poses that chance makes as noisy once in a million: a gross error that its few neighbours hid, most often."""
    return (scatter.p_above(1.0) < _ODD_POSE) & (np.nan_to_num(scatter.ratio) > 1.5)


def base_drift(body: BodyView, share: float) -> Iterator[Check]:
    """A reference body that walks in the frame of the measurement; without meaning where that frame changes by
    pose."""
    drift = find_drift(body.points.points, body.good)
    size = float(drift.span.max(initial=0.0)) * 1e3
    sigma = float(np.median(body.sigma)) * 1e3
    walks = drift.p_value < share and size > 3.0 * sigma
    target = body.survey.targets[int(drift.span.argmax())] if len(drift.span) else ""
    message = f"{body.name}: stands still in the frame of the measurement, or that frame changes from pose to pose."
    if walks:
        message = f"{body.name}: drifts by {size:.3f} mm over the campaign, most at target {target}."
    yield Check("base-drift", body.name, size if walks else 0.0, 3.0 * sigma, "mm", WARN if walks else PASS, message)


def repeatability(
    bodies: Sequence[BodyView], around: Surroundings, actuator_mm: float, share: float
) -> Iterator[Check]:
    """Poses taken more than once at the same readings: their scatter against their stated uncertainty."""
    reference, moving = bodies[0], [b for b in bodies[1:] if not b.name.startswith("leg")]
    groups = []
    if around.settings.shape[1] and moving:
        groups = repeated_groups(around.settings, np.full(around.settings.shape[1], max(5.0 * actuator_mm, 1e-9)))
    if not groups:
        yield _without("repeatability", "repeatability", "", "no configuration was measured twice")
        return
    for body in moving:
        both = reference.fit.ok & body.fit.ok
        p, cov = _relative_position(reference, body)
        parts = [g[both[g]] for g in groups]
        squares = sum(_spread(p[g], cov[g]) for g in parts if len(g) > 1)
        dof = 3.0 * sum(len(g) - 1 for g in parts if len(g) > 1)
        scatter = Scatter(np.array([squares]), np.array([dof]))
        ratio = float(scatter.ratio[0]) if dof else 0.0
        failing = scatter.p_above(_POSE_NOISE_TOLERATED)[0] < share / len(moving)
        noted = scatter.p_above(_NOISE_TOLERATED)[0] < share / len(moving)
        yield Check(
            "repeatability",
            body.name,
            ratio,
            _POSE_NOISE_TOLERATED,
            "1",
            FAIL if failing else WARN if noted else PASS,
            f"{body.name}: repeated poses scatter {ratio:.2f} times as much as their noise says "
            f"({int(dof / 3)} repeats).",
        )


def _relative_position(reference: BodyView, body: BodyView) -> tuple[Array, Array]:
    """(B, 3) position of the body from the reference body, and its covariance to first order."""
    turn = np.swapaxes(np.nan_to_num(reference.fit.R), 1, 2)
    offset = np.nan_to_num(body.fit.t - reference.fit.t)
    arm = np.cross(np.eye(3)[None], offset[:, None])
    jacobian = np.concatenate([-np.broadcast_to(np.eye(3), arm.shape), arm], axis=2)
    cov = np.nan_to_num(body.fit.covariance[:, :3, :3])
    cov = cov + np.einsum("bij,bjk,blk->bil", jacobian, np.nan_to_num(reference.fit.covariance), jacobian)
    return np.einsum("bij,bj->bi", turn, offset), np.einsum("bij,bjk,blk->bil", turn, cov, turn)


def _spread(values: Array, cov: Array) -> float:
    """Chi-square of a group's values (G, 3) about their weighted mean."""
    weight = np.linalg.inv(cov)
    mean = np.linalg.solve(weight.sum(axis=0), np.einsum("gij,gj->i", weight, values))
    return float(np.einsum("gi,gij,gj->", values - mean, weight, values - mean))


def time_gaps(around: Surroundings) -> Check:
    """A pause much longer than the usual pace: something may have changed meanwhile."""
    steps = np.diff(around.time)
    if len(steps) < 3 or np.median(steps) <= 0.0:
        return _without("time gaps", "time-gaps", "", "no times")
    longest = int(steps.argmax())
    ratio, limit = float(steps[longest] / np.median(steps)), 10.0
    return Check(
        "time-gaps",
        f"pose {around.poses[longest + 1]}",
        float(steps[longest]),
        limit * float(np.median(steps)),
        "s",
        WARN if ratio > limit else PASS,
        f"The longest pause is {steps[longest]:.0f} s, {ratio:.1f} times the usual, "
        f"before pose {around.poses[longest + 1]}.",
    )


def temperature_span(around: Surroundings) -> Check:
    """How far the temperature walked: what thermal effects have to work with."""
    if around.temperature is None or not np.isfinite(around.temperature).any():
        return _without("temperature", "temperature-span", "", "no temperatures were recorded")
    low, high = float(np.nanmin(around.temperature)), float(np.nanmax(around.temperature))
    return Check(
        "temperature-span",
        "",
        high - low,
        2.0,
        "K",
        WARN if high - low > 2.0 else PASS,
        f"Temperature ran from {low:.2f} to {high:.2f} degrees C.",
    )


def _without(what: str, check: str, subject: str, why: str) -> Check:
    return Check(check, subject, None, None, "", NOT_EVALUATED, f"Not evaluated ({what}): {why}.")


def _nearest_neighbour(points: Array) -> Array:
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)


def _listed(names: Sequence[str], most: int = 8) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
