"""From a run's tables to what the diagnosis compares where there is no mechanism: measured points of all bodies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.inference.observations import Epochs, Frames, Observations
from truing.report.numbers import count as counted
from truing.schemas.covariates import stand_in
from truing.simulation.bodies.causes.terms import CAME_FROM, place_columns
from truing.simulation.bodies.model import FIRST_BODY, BodyConditions, BodyModel, KnownBodies
from truing.simulation.inputs import approach, order_in_time
from truing.simulation.targets import Targets, shape_unknowns
from truing.stages.common.point_arrays import number_column, pose_ids, positions
from truing.stages.common.why_not import NO_BODY_TO_DIAGNOSE, why_reference_unseen, why_too_few_determined
from truing.stages.diagnosis.body_standing import Standing, standing
from truing.stages.diagnosis.body_targets import BodyTargets, targets_of
from truing.stages.diagnosis.mechanism_points import Gathered

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

# So many poses are never too many.
_ALWAYS = 60
_KNOWN_SHARE = 0.9
# A drive has moved where it did so by more than this share of its range.
_MOVED = 1e-3
# Numbers that all candidates of a search may hold; beyond it, poses are left out evenly. A body's targets have about so
# many candidate courses, each with a pattern of its own.
_MOST_NUMBERS, _COURSES = 6_000_000, 16


def gather_bodies(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """Return what the diagnosis compares; raises ValueError, saying why, where the campaign does not hold it."""
    if any(name not in tables or not tables[name].num_rows for name in ("observations", "poses", "residuals")):
        raise ValueError("needs measured points of bodies")
    poses = pose_ids(tables["observations"])
    covariates, role = known_of_poses(tables.get("configurations"), poses, settings.campaign.drives)
    found, words = targets_of(tables, poses, covariates["order"], settings.noise.point_mm)
    if not found:
        raise ValueError(_why_none(tables, settings.reference_body))
    stands = [standing(body, settings, covariates) for body in found]
    lead = -1 if any(one.levels for one in stands) else _lead(found, settings.reference_body)
    covariates |= _places(found, lead, covariates["order"]) if not settings.campaign.drives else {}
    model = _model(found, stands, lead, covariates, poses, settings)
    usable = np.any([body.ok for body in found], 0)
    fitted, held = usable & (role != "verification"), usable & (role == "verification")
    if why := why_too_few_determined(int(fitted.sum())):
        raise ValueError(why)
    fitted, thinned = _thinned(fitted, model)
    words += [f"{counted(int((~usable).sum()), 'pose')} without a body that is determined"] if not usable.all() else []
    return Gathered(
        model.at(_at(model.conditions, fitted)),
        _poses(found, model.conditions, lead, fitted),
        _poses(found, model.conditions, lead, held) if held.any() else None,
        "; ".join([*words, *thinned]),
        None,
        tuple(cause for body in found for cause in body.certain),
    )


def _why_none(tables: Mapping[str, pa.Table], reference: str | None) -> str:
    """Why no body can be diagnosed."""
    bodies, poses = (tables["observations"].column(name).to_pylist() for name in ("body", "pose"))
    seen = Counter(pose for body, pose in zip(bodies, poses, strict=True) if body == reference)
    is_seen_from = reference in tables["poses"].column("parent").to_pylist()
    why = why_reference_unseen(str(reference), max(seen.values())) if seen and is_seen_from else ""
    return why or NO_BODY_TO_DIAGNOSE


def known_of_poses(
    table: pa.Table | None, poses: tuple[int | str, ...], drives: tuple[str, ...]
) -> tuple[dict[str, Array], NDArray]:
    """Covariates (B,) by column, with the order in time and the direction of each drive's last movement; roles (B,)."""
    role = np.full(len(poses), "", object)
    covariates: dict[str, Array] = {}
    if table is not None:
        place = positions(table.column("pose"), poses)
        role[place[place >= 0]] = np.asarray(table.column("role").to_pylist(), object)[place >= 0]
        for field in table.schema:
            if field.name not in ("pose", "role") and str(field.type) in ("double", "int64"):
                values = np.full(len(poses), np.nan)
                values[place[place >= 0]] = number_column(table, field.name)[place >= 0]
                covariates[stand_in(field.name)] = values
    time = covariates.get("time_s")
    if time is not None and np.array_equal(np.diff(np.sort(time)), np.ones(len(time) - 1)):
        del covariates["time_s"]  # numbers of rows, and no seconds
    covariates["order"] = order_in_time(time, len(poses))
    for drive in map(stand_in, drives):
        if drive in covariates and np.ptp(covariates[drive]) > 0:
            least = _MOVED * float(np.ptp(covariates[drive]))
            covariates[CAME_FROM + drive] = approach(covariates[drive][:, None], covariates["order"], least)[:, 0]
    return covariates, role


def _lead(found: list[BodyTargets], reference: str | None) -> int:
    """The body in whose frame the others are modelled: the reference, else the one that is determined most often."""
    names = [body.name for body in found]
    if reference in names:
        return names.index(reference)
    return int(np.argmax([body.ok.sum() for body in found]))


def _places(found: list[BodyTargets], lead: int, order: Array) -> dict[str, Array]:
    """Where other bodies are, seen from the leading one (B,), m: without drives, what there is to deform with.

    Between poses that do not tell, a body is taken to go straight; one that most poses do not tell is left out.
    """
    columns: dict[str, Array] = {}
    for body in found if lead >= 0 else []:
        known = body.ok & found[lead].ok
        if body is found[lead] or known.mean() < _KNOWN_SHARE:
            continue
        centre = body.t + body.R @ body.shape.mean(0) - found[lead].t
        seen = np.einsum("bji,bj->bi", found[lead].R, centre)
        rows = np.flatnonzero(known)[np.argsort(order[known], kind="stable")]
        for axis, name in enumerate(place_columns(body.name)):
            columns[name] = np.interp(order, order[rows], seen[rows, axis])
    return columns


def _model(
    found: list[BodyTargets],
    stands: list[Standing],
    lead: int,
    covariates: Mapping[str, Array],
    poses: tuple[int | str, ...],
    settings: Campaign,
) -> BodyModel:
    counts = [len(body.names) for body in found]
    targets = Targets(
        np.repeat(np.arange(len(found)) + FIRST_BODY, counts),
        np.full(sum(counts), -1),
        tuple(name for body in found for name in body.names),
        tuple(body.name for body in found for _ in body.names),
    )
    shape = np.concatenate([body.shape for body in found])
    known = KnownBodies(
        shape,
        shape_unknowns(targets, shape, np.concatenate([body.shape_cov for body in found])),
        np.repeat([body.surveyed for body in found], [3 * count - 6 for count in counts]),
        np.array([one.levels for one in stands]),
        np.stack([one.jitter for one in stands]),
        lead,
        tuple(map(stand_in, settings.campaign.drives)),
        tuple(body.name for body in found if place_columns(body.name)[0] in covariates),
        settings.mechanism.reference_temperature_c,
    )
    return BodyModel(targets, _conditions(stands, lead, covariates, poses), known)


def _conditions(
    stands: list[Standing], lead: int, covariates: Mapping[str, Array], poses: tuple[int | str, ...]
) -> BodyConditions:
    """Where each body was found in the model's frame: that of the leading body where it was found, else as measured."""
    R, t = np.stack([one.R for one in stands], 1), np.stack([one.t for one in stands], 1)
    if lead >= 0:
        back = np.swapaxes(R[:, lead], 1, 2)[:, None]
        t = (back @ (t - t[:, [lead]])[..., None])[..., 0]
        R = back @ R
    time = covariates.get("time_s")
    known = time is not None and bool(np.isfinite(time).all())
    span = (float(np.min(time)), float(np.max(time))) if time is not None and known else None
    level = np.stack([one.level for one in stands], 1)
    return BodyConditions(np.zeros((len(poses), 0)), dict(covariates), poses, span, R, t, level)


def _at(conditions: BodyConditions, rows: NDArray[np.bool_]) -> BodyConditions:
    return replace(
        conditions,
        readings=conditions.readings[rows],
        covariates={name: values[rows] for name, values in conditions.covariates.items()},
        poses=tuple(pose for pose, kept in zip(conditions.poses, rows, strict=True) if kept),
        R=conditions.R[rows],
        t=conditions.t[rows],
        level=conditions.level[rows],
    )


def _poses(found: list[BodyTargets], conditions: BodyConditions, lead: int, rows: NDArray[np.bool_]) -> Epochs:
    measured = Observations(
        np.concatenate([body.points[rows] for body in found], 1),
        np.concatenate([body.cov[rows] for body in found], 1),
        np.concatenate([body.seen[rows] & body.ok[rows, None] for body in found], 1),
    )
    count = int(rows.sum())
    frames = Frames(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), free=False)
    if lead >= 0:
        frames = Frames(found[lead].R[rows], found[lead].t[rows])
    return Epochs(measured, _at(conditions, rows), frames)


def _thinned(rows: NDArray[np.bool_], model: BodyModel) -> tuple[NDArray[np.bool_], list[str]]:
    """The poses that can be held in memory at a time, evenly over the campaign, and what was left out for it."""
    count, coordinates = int(rows.sum()), 3 * len(model.targets.body)
    columns = model.shared_size + model.local_size + _COURSES * (coordinates + 6 * int(model.known.still.sum()))
    most = max(_MOST_NUMBERS // (coordinates * columns), _ALWAYS)
    if count <= most:
        return rows, []
    kept = np.zeros_like(rows)
    kept[np.flatnonzero(rows)[np.linspace(0, count - 1, most).round().astype(int)]] = True
    return kept, [
        f"{count - most} of {counted(count, 'pose')}, evenly over the campaign: all together would not fit into memory"
    ]
