"""Checks of targets: completeness, geometry of the frame, positions, noise and repeatability."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.relation import RelationTest
from truing.estimation.quality import (
    Scatter,
    body_shape,
    exchanged_pairs,
    find_steps,
    isolated_values,
    residual_scatter,
    successive_sigma,
)
from truing.estimation.repeatability import at_one_reading, equal_scatter
from truing.estimation.rigid_poses.body_frames import redundancy
from truing.quality.bodies import (
    MOST_GROSS,
    BodyView,
    PoseSurroundings,
    chi_square_about_mean,
    is_trend,
    nearest_neighbour,
    odd_poses,
    repeated_positions,
    scatter_by_pose,
)
from truing.report.numbers import count_text, listed
from truing.stages.common.repeats import DECLARED
from truing.stages.quality.check import FAIL, PASS, WARN, CampaignLimits, Check, gross_error_count, not_evaluated
from truing.stages.quality.unit_slips import IMPLAUSIBLE_RATIO, unit_slip

_EITHER_SIDE = 3  # poses before and after a step
_OFTEN = 0.1  # share of a target's readings, far above that of ordinary gross errors
_STAYS, _FEWEST_AROUND = 0.75, 5  # share of poses by which gross errors stay from one on; poses on either side
_NOISE_TOLERATED = 1.5  # beyond this multiple of the declared noise the declaration is unusable
_AXIS_NOISE_TOLERATED = 2.5  # photogrammetry is worse in depth, and one declared number stands for all axes
_NOISE_NOTED = 1.1
_POSE_NOISE_TOLERATED = 3.0
_ODD_POSES_FAIL = 0.1
_NOTED, _TOLERATED = 1.5, 3.0  # times what is stated
_UNEQUAL = 1e-3
_AXES, _TWO = 3, 2
_FEWEST_POINTS = 10  # of fewer points, a coordinate may be equal by a coarse resolution
_COMPUTED = (
    " If a program computed the points from a fitted pose, as motion capture does of rigid bodies, they are one "
    "measurement of a pose: give this pose in [files.poses], with its own uncertainty."
)


def unobserved_poses(around: PoseSurroundings, limits: CampaignLimits) -> Check:
    """Check for configurations without any measured point: forgotten, or with another name in the points."""
    lost = [str(pose) for pose in around.unobserved]
    share = len(lost) / max(len(lost) + len(around.poses), 1)
    text = f"No point was measured in pose {listed(lost)}." if lost else "Points were measured in every pose."
    return limits.of("unobserved-poses").row("", share, "1", text)


def coordinates_vary(bodies: Sequence[BodyView]) -> Check:
    """Check for coordinates that are the same in all points of a campaign: they were not measured."""
    seen = [body.points.points[body.points.is_observed] for body in bodies]
    points = np.concatenate(seen) if seen else np.empty((0, _AXES))
    if len(points) < _FEWEST_POINTS:
        return not_evaluated("coordinates that do not vary", "coordinates-vary", "", "fewer than ten points")
    constant = [axis for axis in range(_AXES) if np.ptp(points[:, axis]) == 0.0]
    if not constant or len(constant) == _AXES:
        return Check("coordinates-vary", "", 0.0, 0.0, "1", PASS, "All coordinates differ between points.")
    named = [f"{'xyz'[axis]} is {1e3 * points[0, axis]:.6g} mm" for axis in constant]
    measured = _AXES - len(constant)
    text = (
        f"{' and '.join(named)} in all {count_text(len(points), 'point')}: not measured, but counted as measured "
        f"without error. Rms errors per coordinate and noise ratios of this page are therefore too small; those of "
        f"the {'two' if measured == _TWO else 'one'} measured "
        f"{'coordinates' if measured == _TWO else 'coordinate'} are {math.sqrt(_AXES / measured):.2f} times as large."
    )
    return Check("coordinates-vary", "", float(len(constant)), 0.0, "1", WARN, text)


def attachment_labels(bodies: Sequence[BodyView], attachments: Array) -> Iterator[Check]:
    """Check that each target on an attachment is nearest to the nominal attachment (L, 3) of its leg."""
    for body in bodies:
        if body.name != "platform" or not len(attachments):
            continue
        marked = np.nonzero((body.survey.leg > 0) & (body.survey.leg <= len(attachments)))[0]
        for t in marked:
            distance = np.linalg.norm(attachments - body.survey.points[t], axis=1)
            leg, nearest = body.survey.leg[t], int(distance.argmin()) + 1
            text = f"platform: target {body.survey.targets[t]} lies {1e3 * distance[leg - 1]:.2f} mm from b_{leg}"
            value, limit = 1e3 * float(distance[leg - 1]), 1e3 * float(np.delete(distance, leg - 1).min())
            verdict, subject = PASS if nearest == leg else FAIL, f"target {body.survey.targets[t]}"
            text += (
                "." if nearest == leg else f", but {1e3 * distance.min():.2f} mm from b_{nearest}: is its leg right?"
            )
            yield Check("attachment-labels", subject, value, limit, "mm", verdict, text)


def completeness(body: BodyView, due: Mask, limits: CampaignLimits) -> Iterator[Check]:
    """Check the share of expected targets (B, T) that were observed, and the poses without a frame."""
    is_observed = body.points.is_observed
    missing = due & ~is_observed
    text = f"{body.name}: {int(missing.sum())} of {int(due.sum())} target readings are missing "
    text += f"({count_text(is_observed.shape[1], 'target')}, {count_text(is_observed.shape[0], 'pose')})."
    yield limits.of("completeness").row(body.name, float(missing.sum()) / max(int(due.sum()), 1), "1", text)
    lost = [str(p) for p, ok in zip(body.points.poses, body.fit.ok, strict=True) if not ok]
    text = f"{count_text(len(lost), 'pose')} with too few usable targets ({listed(lost)})" if lost else ""
    text = f"{body.name}: {text or 'every pose can be determined'}."
    yield limits.of("poses-determined", per=len(is_observed)).row(body.name, float(len(lost)), "1", text)


def geometry(body: BodyView, limits: CampaignLimits) -> Iterator[Check]:
    """Check that the targets determine a frame: spread beyond a line, and no single target that it depends on."""
    points = body.survey.points[body.frame]
    if len(points) < 3:
        text = f"{body.name}: fewer than three targets."
        yield Check("geometry", body.name, float(len(points)), 3.0, "1", FAIL, text)
        return
    shape = body_shape(points)
    length = shape.extents[0] if shape.extents[0] > 0.0 else 1.0  # all targets in one place are neither wide nor thick
    across, thick = shape.extents[1] / length, shape.extents[2] / length
    spread, line = float(shape.extents[1] * 1e3), limits.of("geometry-line", per=float(np.median(body.sigma)) * 1e3)
    sizes = " x ".join(f"{extent * 1e3:.1f}" for extent in shape.extents[:3])
    in_line = "" if line.verdict(spread) == PASS else ": nearly in line, so the roll is not determined"
    yield line.row(body.name, spread, "mm", f"{body.name}: targets spread {sizes} mm (rms){in_line}.")
    plane, many = limits.of("geometry-plane"), len(points) > 3
    flat = many and plane.verdict(float(thick)) != PASS
    text = f"{body.name}: thickness over length {thick:.3f}, width over length {across:.3f}"
    text += ": nearly planar, so mirrored labels cannot be detected." if flat else "."
    yield plane.row(body.name, float(thick), "1", text, counts=many)
    names = np.array(body.survey.targets, dtype=object)[body.frame]
    for name, leverage in zip(names, shape.leverage, strict=True):
        text = f"{body.name}: {100 * leverage:.0f} % of an error of target {name} goes into the frame."
        yield limits.of("geometry-leverage").row(f"target {name}", float(leverage), "1", text, counts=many)


def gross_errors(body: BodyView, limits: CampaignLimits) -> Iterator[Check]:
    """Check the share of targets far from their positions, in poses with enough targets; a few per cent are
    ordinary."""
    if why := body.why_no_positions:
        yield not_evaluated("gross errors", "gross-errors", body.name, why)
        return
    seen, gross = int(body.points.is_observed[body.framed].sum()), body.gross[body.framed]
    share = float(gross.sum()) / max(seen, 1)
    per_target = gross.sum(axis=0)
    often = [f"{body.survey.targets[t]} ({per_target[t]})" for t in np.argsort(-per_target)[:5] if per_target[t] > 0]
    tail = f", most often {', '.join(often)}" if often else ""
    poses = [pose for pose, is_framed in zip(body.points.poses, body.framed, strict=True) if is_framed]
    count, row = gross_error_count(int(gross.sum()), seen), limits.of("gross-errors")
    since = _since(poses, np.any(gross, 1))
    is_observed = body.points.is_observed[body.framed]
    if (
        not since
        and row.verdict(share) != PASS
        and (where := _of_whole_poses(gross, is_observed) or _of_few_targets(gross, is_observed))
    ):
        count, since = f"{int(gross.sum())} of {seen} readings are as far off as gross errors", where
    yield row.row(body.name, share, "1", f"{body.name}: {count}{tail}{since}.")


def _of_whole_poses(gross: Mask, is_observed: Mask) -> str:
    """Return that most of many gross errors (B, T) are of some poses as a whole; else empty.

    Gross errors of single targets hardly meet in one pose. Where most targets of a pose are off, it is noisier: the
    machine vibrated, or the body was not at rest.
    """
    several = gross.sum(axis=1) > 1
    whole = several & (2 * gross.sum(axis=1) > is_observed.sum(axis=1))
    of_whole = int(gross[whole].sum())
    if whole.sum() < _FEWEST_AROUND or 2 * of_whole <= gross.sum():
        return ""
    where = f"{of_whole} of them in {int(whole.sum())} of {len(gross)} poses in which most targets are off"
    return f"; {where}: these poses as a whole may be noisier, as by vibration"


def _of_few_targets(gross: Mask, is_observed: Mask) -> str:
    """Return that most of many gross errors (B, T) are of the same few targets; else empty.

    Gross errors meet any target. Targets that are often off may be loose, or sit where the body deforms.
    """
    counts = gross.sum(axis=0)
    often = (counts >= _FEWEST_AROUND) & (counts > _OFTEN * is_observed.sum(axis=0))
    of_them = int(counts[often].sum())
    if 2 * often.sum() > len(often) or 2 * of_them <= gross.sum():
        return ""
    where = f"{of_them} of them at {int(often.sum())} of {len(often)} targets"
    known = "targets at attachments: column leg of the survey"
    return f"; {where}: these may be loose, or sit where the body deforms ({known})"


def _since(poses: Sequence[int | str], is_affected: Mask) -> str:
    """Return from which pose, in the order of the table, most poses are affected (B,) after hardly any; else empty.

    Gross errors come and go. Where they stay, the targets lie otherwise from then on.
    """
    before, after = np.cumsum(is_affected), np.cumsum(is_affected[::-1])[::-1]
    onsets = np.arange(_FEWEST_AROUND, len(is_affected) - _FEWEST_AROUND + 1)
    if not len(onsets):
        return ""
    shares = after[onsets] / (len(is_affected) - onsets) - before[onsets - 1] / onsets
    onset = int(onsets[np.argmax(shares)])
    if shares.max() < _STAYS:
        return ""
    share = f"{after[onset]} of the {len(is_affected) - onset} poses from {poses[onset]} on"
    return f", in {share} and {before[onset - 1]} of the {onset} before: a target was moved or replaced there"


def exchanged_labels(body: BodyView, around: PoseSurroundings) -> Iterator[Check]:
    """Check for pairs of targets at each other's positions."""
    if why := body.why_no_positions or ("" if body.fit.ok.any() else f"{body.name}: no pose could be determined"):
        yield not_evaluated("exchanged labels", "exchanged-labels", body.name, why)
        return
    source = body.survey.points
    expected = body.fit.apply(np.broadcast_to(source, body.points.points.shape))
    ok = body.gross & body.fit.ok[:, None]
    limit = np.maximum(10.0 * np.sqrt((body.sigma**2).sum(axis=2)), 0.02 * nearest_neighbour(source))
    pairs = exchanged_pairs(np.nan_to_num(expected), body.points.points, ok, limit)
    if not pairs:
        yield Check("exchanged-labels", body.name, 0.0, 0.0, "1", PASS, f"{body.name}: no labels are exchanged.")
    for a, b in sorted({(a, b) for _, a, b in pairs}):
        poses = [str(around.poses[p]) for p, i, j in pairs if (i, j) == (a, b)]
        names = f"{body.survey.targets[a]} {body.survey.targets[b]}"
        text = f"{body.name}: the labels {names} are exchanged in pose {listed(poses)}."
        yield Check("exchanged-labels", f"targets {names}", float(len(poses)), 0.0, "1", FAIL, text)


def moved_targets(body: BodyView, around: PoseSurroundings, share: float) -> Iterator[Check]:
    """Check for targets that moved at a pose, with pose and shift."""
    is_observed = body.points.is_observed & body.fit.ok[:, None]
    sigma = np.maximum(body.sigma, successive_sigma(body.residuals, is_observed)[None])
    is_used = is_observed & ~isolated_values(body.residuals, sigma, is_observed, limit=4.0)
    assessed = is_used.sum(axis=0) >= 2 * _EITHER_SIDE
    if not assessed.any():
        why = f"{body.name}: no target was seen in three poses before and three after a step"
        yield not_evaluated("moved targets", "moved-targets", body.name, body.why_no_positions or why)
        return
    step = find_steps(body.residuals, sigma, is_used, _EITHER_SIDE)
    moved = np.nonzero(step.p_value < share / max(len(body.survey.targets), 1))[0]
    shifted = [
        t for t in moved if not is_trend(body.residuals[:, t], sigma[:, t], is_used[:, t], around.time, step.onset[t])
    ]
    if not shifted:
        text = f"{body.name}: no target has moved on its body."
        if rare := [body.survey.targets[t] for t in np.flatnonzero(~assessed)]:
            text += f" Seen in too few poses to test: {listed(rare)}."
        yield Check("moved-targets", body.name, 0.0, 0.0, "1", PASS, text)
    for t in shifted:
        d = step.size[t] * 1e3
        size, target = float(np.linalg.norm(d)), f"target {body.survey.targets[t]}"
        text = f"{body.name}: {target} moved by {size:.3f} mm ({d[0]:+.3f}, {d[1]:+.3f}, {d[2]:+.3f}) "
        text += f"from pose {around.poses[step.onset[t]]} on."
        yield Check("moved-targets", target, size, 0.0, "mm", WARN, text)


def noise_size(bodies: Sequence[BodyView], relations: Sequence[RelationTest]) -> Check:
    """Check whether the declared noise is so small that by it most points of a body would be gross errors. A body with
    a recording error, such as coarse steps, is reported by its consistency test."""
    rounded = {
        name for relation in relations if relation.reason in ("rounded", "slip") for name in relation.subject.split()
    }
    noisy = [body for body in bodies if body.noise_factor > 1.0 and body.name not in rounded]
    elsewhere = [body.name for body in bodies if body.gross_share > MOST_GROSS or body.noise_factor > 1.0]
    if not noisy and elsewhere:
        why = (
            f"most points of {listed(elsewhere)} are outside the declared noise, but by less than 10 times, or not by "
        )
        why += "scatter"
        return not_evaluated("size of the noise", "noise-size", "", why)
    if not any(body.framed.any() for body in bodies):
        why = "no pose shows three targets of a body, and fewer leave nothing to compare"
        return not_evaluated("size of the noise", "noise-size", "", why)
    if not noisy:
        return Check(
            "noise-size", "", 1.0, 1.0, "1", PASS, "Most points of every body agree within the declared noise."
        )
    worst, least = (choose(noisy, key=lambda body: body.noise_factor) for choose in (max, min))
    declared_mm = 1e3 * float(np.median(worst.measured_sigma[worst.points.is_observed])) / worst.noise_factor
    times = " to ".join(dict.fromkeys(f"{body.noise_factor:.0f}" for body in (least, worst)))
    text = f"{listed([body.name for body in noisy])}: all points scatter alike, by {times} times the declared noise "
    text += f"of {declared_mm:.3g} mm; by the declared noise most of them would be gross errors."
    text += unit_slip(least.noise_factor, declared_mm, "mm")
    text += " Or do these points belong to several bodies?" if len(noisy) == 1 else ""
    return Check("noise-size", worst.name, worst.noise_factor, 1.0, "1", FAIL, text)


def noise(body: BodyView, around: PoseSurroundings, share: float) -> Iterator[Check]:
    """Check the estimated noise per axis, without dependence on actuators, time and temperature, against the declared
    one."""
    is_used = body.good & body.frame & ~odd_poses(scatter_by_pose(body))[:, None]
    if is_used.sum() < 12:
        yield not_evaluated(f"noise of {body.name}", "noise", body.name, "too few readings")
        return
    part = redundancy(body.survey.points[body.frame], is_used[:, body.frame])
    declared_sigma = body.measured_sigma / body.noise_factor
    scatter = residual_scatter(body.residuals[:, body.frame], declared_sigma[:, body.frame], part, around.covariates)
    pooled = scatter.pooled
    if pooled.dof[0] < 1.0:
        why = "a single pose without a survey has no residual"
        yield not_evaluated(f"noise of {body.name}", "noise", body.name, why)
        return
    declared = 1e3 * float(np.median(declared_sigma[is_used]))
    first = _noise_check(body.name, "", pooled, _NOISE_TOLERATED, share / 2, around.shared)
    slip = unit_slip(float(pooled.ratio[0]), declared, "mm")
    verdict = FAIL if slip else first.verdict
    if pooled.ratio[0] < 1.0 / IMPLAUSIBLE_RATIO:
        slip += " Or are the points in m in place of mm?" if slip else ""
        slip += _COMPUTED
    yield replace(first, message=first.message + slip, verdict=verdict)
    for k, axis in enumerate("xyz"):
        scatter_of_axis = Scatter(scatter.chi_square[k : k + 1], scatter.dof[k : k + 1])
        yield _noise_check(body.name, axis, scatter_of_axis, _AXIS_NOISE_TOLERATED, share / 6, around.shared)


def _times(ratio: float) -> str:
    """Return a ratio with two decimals, a small one with two digits: ``0.00`` times would be meaningless."""
    return f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.2g}"


def _noise_check(body: str, axis: str, scatter: Scatter, tolerated: float, share: float, shared: bool) -> Check:
    ratio = float(scatter.ratio[0])
    failing = scatter.p_above(tolerated)[0] < share
    # What all points of a pose share of their errors moves or scales them together: the declared is more than scatters.
    below = not shared and scatter.p_below(1.0 / _NOISE_NOTED)[0] < share
    noted = below or scatter.p_above(_NOISE_NOTED)[0] < share
    where = f"the scatter along {axis}" if axis else "the scatter"
    noise = "standard deviations, which include common errors of points" if shared else "declared noise"
    freedom = f"{count_text(round(scatter.dof[0]), 'degree')} of freedom"
    sentence = f"{body}: {where} is {_times(ratio)} times the {noise} ({freedom})."
    verdict = FAIL if failing else WARN if noted else PASS
    return Check("noise", f"{body} {axis}".strip(), ratio, tolerated, "1", verdict, sentence)


def noise_by_pose(body: BodyView, around: PoseSurroundings, share: float) -> Iterator[Check]:
    """Check for poses with larger residuals than the body's typical scatter."""
    scatter = scatter_by_pose(body)
    assessed = scatter.dof > 0.0
    if assessed.sum() < 3:
        yield not_evaluated(f"noise by pose of {body.name}", "noise-by-pose", body.name, "too few targets per pose")
        return
    odd = odd_poses(scatter)
    much = scatter.p_above(_POSE_NOISE_TOLERATED) < share / assessed.sum()
    worst = int(np.argmax(np.where(assessed, np.nan_to_num(scatter.ratio), -1.0)))
    failing = much.sum() > _ODD_POSES_FAIL * assessed.sum()
    pose, ratio, verdict = (
        around.poses[worst],
        float(scatter.ratio[worst]),
        FAIL if failing else WARN if odd.any() else PASS,
    )
    text = f"{body.name}: the noisiest pose is {pose}, {ratio:.2f} times the ordinary "
    text += f"scatter; {int(odd.sum())} of {int(assessed.sum())} poses are noisier than the others."
    yield Check("noise-by-pose", f"{body.name} pose {pose}", ratio, _POSE_NOISE_TOLERATED, "1", verdict, text)


def repeatability(
    bodies: Sequence[BodyView],
    around: PoseSurroundings,
    groups: Sequence[Index],
    how: str,
    share: float,
    *,
    is_instrument_fixed: bool = False,
) -> Iterator[Check]:
    """Check the scatter of repeated poses against their stated uncertainty.

    ``is_instrument_fixed``: the instrument did not move, so bodies need no reference body.
    """
    if not groups:
        why = "no configuration was measured twice; measure three of them again at the end"
        yield not_evaluated("repeatability", "repeatability", "", why)
        return
    seen = list(repeated_positions(bodies, is_instrument_fixed=is_instrument_fixed))
    if not seen:
        why = "no body is measured relative to another; put three targets on the body that stands still"
        yield not_evaluated("repeatability", "repeatability", "", why)
    for repeats in seen:
        position = repeats.position
        if how == DECLARED:
            position = at_one_reading(np.where(repeats.known[:, None], position, np.nan), around.settings, groups)
        parts = [part for group in groups if len(part := group[repeats.known[group]]) > 1]
        squares = np.array([chi_square_about_mean(position[part], repeats.cov[part]) for part in parts])
        names = [str(around.poses[int(part[0])]) for part in parts]
        freedom = np.array([3.0 * (len(part) - 1) for part in parts])
        yield _check(repeats.name, Scatter(squares, freedom), names, how, share / len(seen))


def _check(name: str, scatter: Scatter, poses: Sequence[str], how: str, share: float) -> Check:
    """Return the check of one subject over all groups, and of each group; groups that differ are reported
    separately."""
    if not poses:
        why = f"no repeated pose determines the place of {name} twice; measure three poses twice"
        return not_evaluated("repeatability", "repeatability", name, why)
    pooled = scatter.pooled
    verdicts = [
        (pooled.p_above(times)[0] < 0.5 * share or bool((scatter.p_above(times) < 0.5 * share / len(poses)).any()))
        for times in (_NOTED, _TOLERATED)
    ]
    verdict = FAIL if verdicts[1] else WARN if verdicts[0] else PASS
    ratio, repeats = float(pooled.ratio[0]), int(pooled.dof[0] / 3)
    scatter_test = equal_scatter(scatter.chi_square, scatter.dof)
    text = f"{name}: repeated poses scatter {ratio:.2f} times as much as their noise "
    if scatter_test is not None and scatter_test.p_value < _UNEQUAL:
        ratio = float(scatter.ratio[scatter_test.worst])
        verdict = WARN if verdict == PASS else verdict
        text = f"{name}: repeats of pose {poses[scatter_test.worst]} scatter {ratio:.2f} times as much as their noise, "
        text += f"those of all others {scatter_test.others:.2f} times: no single value represents all "
    text += f"({count_text(repeats, 'repeat')} of {count_text(len(poses), 'pose')}, recognised by {how})."
    return Check("repeatability", name, ratio, _TOLERATED, "1", verdict, text)
