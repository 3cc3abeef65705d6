"""Tables of the pose stage from the poses of all bodies: poses, residuals, and effects of common errors of points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, TableRow
from truing.estimation.covariance import relative_slope
from truing.estimation.measured_numbers import pose_numbers
from truing.estimation.rigid_poses.body_poses import BodyPoses, seen_from
from truing.estimation.rotation import log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.point_arrays import decisions

MEASUREMENT = "measurement"
_COVARIANCE = [(i, j) for i in range(6) for j in range(i, 6)]
_NAMES = pa.dictionary(pa.int32(), pa.string())


def poses_table(
    bodies: Sequence[BodyPoses], reference: str | None, identifier: str, frame: str = MEASUREMENT
) -> pa.Table:
    """One row per pose, body and method; bodies other than the reference are seen from it, those of a campaign without
    it from ``frame``, the name of the measurement's frame."""
    base = next((body for body in bodies if body.name == reference), None)
    parts = [
        _pose_columns(body, method, None if body is base else base, frame) for body in bodies for method in body.fits
    ]
    return _table("poses", parts, identifier)


def residuals_table(bodies: Sequence[BodyPoses], identifier: str) -> pa.Table:
    """One row per observed point: measured minus fitted by the default method, and whether it was used."""
    return _table("residuals", [_residual_columns(body) for body in bodies], identifier)


def _pose_columns(body: BodyPoses, method: str, base: BodyPoses | None, frame: str) -> dict[str, object]:
    fit = body.fits[method]
    if base is None:
        R, p, covariance, status = fit.R, fit.t, fit.covariance, fit.status.astype(object)
    else:
        R, p, covariance, status = seen_from(base, fit, method, body.cross.get((method, base.name)))
    count = len(R)
    vector = np.full((count, 3), np.nan)
    ok = np.isfinite(R).all(axis=(1, 2))
    vector[ok] = log_so3(R[ok])
    return {
        "pose": np.array(body.points.poses),
        "body": _repeated(body.name, count),
        "parent": _repeated(frame if base is None else base.name, count),
        "method": _repeated(method, count),
        "default": np.full(count, method == body.default),
        **{f"p{a}_mm": 1e3 * p[:, k] for k, a in enumerate("xyz")},
        **{f"r{a}_rad": vector[:, k] for k, a in enumerate("xyz")},
        **{f"cov_{i}_{j}": covariance[:, i, j] for i, j in _COVARIANCE},
        "rms_mm": 1e3 * fit.rms,
        "n_used": fit.n_used,
        "n_rejected": body.rejections[method],
        "status": status,
    }


def sensitivities_table(
    bodies: Sequence[BodyPoses], reference: str | None, parameters: Sequence[str], identifier: str
) -> pa.Table:
    """Return the change of each default pose by one standard deviation of each common parameter."""
    base = next((body for body in bodies if body.name == reference), None)
    reported = [body for body in bodies if body.effects is not None]
    parts = [_effect_columns(body, None if body is base else base, parameters) for body in reported]
    return _table("pose_sensitivities", parts, identifier)


def _effect_columns(body: BodyPoses, base: BodyPoses | None, parameters: Sequence[str]) -> dict[str, object]:
    effects = cast("Array", body.effects)
    if base is not None and base.effects is not None:
        slope = relative_slope(base.fit.R, base.fit.t, body.fit.t)
        effects = slope @ np.concatenate([base.effects, effects], axis=1)
    at_pose, at_parameter = np.nonzero(np.isfinite(effects).all(axis=1))
    values = effects[at_pose, :, at_parameter]
    count = len(at_pose)
    return {
        "pose": np.array(body.points.poses)[at_pose],
        "body": _repeated(body.name, count),
        "parent": _repeated(MEASUREMENT if base is None else base.name, count),
        "parameter": np.array(parameters, dtype=object)[at_parameter],
        **{f"effect_{a}_mm": 1e3 * values[:, k] for k, a in enumerate("xyz")},
        **{f"effect_r{a}_rad": values[:, 3 + k] for k, a in enumerate("xyz")},
    }


def covariances_table(bodies: Sequence[BodyPoses], reference: str | None, identifier: str) -> pa.Table:
    """Covariances between the default poses of different bodies, as the reference sees them, where points have errors
    in common."""
    base = next((body for body in bodies if body.name == reference), None)
    others = [body for body in bodies if body is not base]
    parts = [_relative_pose_rows(body, other, base) for n, body in enumerate(others) for other in others[n + 1 :]]
    return _table("pose_covariances", [part for part in parts if part], identifier)


def _relative_pose_rows(body: BodyPoses, other: BodyPoses, base: BodyPoses | None) -> dict[str, object]:
    """Rows for one pair of bodies, of the poses in which they, and the reference, were fitted together."""
    cross_cov = body.cross.get((body.default, other.name))
    if cross_cov is None:
        return {}
    covariance = cross_cov
    if base is not None:
        by_base, by_other = (
            member.cross.get((member.default, partner.name)) for member, partner in ((body, base), (base, other))
        )
        if by_base is None or by_other is None:
            return {}
        own_slope, other_slope = (relative_slope(base.fit.R, base.fit.t, member.fit.t) for member in (body, other))
        joint_cov = np.block([[base.fit.covariance, by_other], [by_base, cross_cov]])
        covariance = own_slope @ joint_cov @ np.swapaxes(other_slope, 1, 2)
    reported = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    pose, i, j = (grid.ravel() for grid in np.meshgrid(reported, np.arange(6), np.arange(6), indexing="ij"))
    return {
        "pose": np.array(body.points.poses)[pose],
        "measured_number": pose_numbers(body.name)[i],
        "other_number": pose_numbers(other.name)[j],
        "joint_covariance": covariance[pose, i, j],
    }


def _residual_columns(body: BodyPoses) -> dict[str, object]:
    at_pose, at_target = np.nonzero(body.points.is_observed)
    residual = 1e3 * body.residual[at_pose, at_target]
    reason = body.reason[at_pose, at_target]
    reason[reason == ""] = None
    return {
        "pose": np.array(body.points.poses)[at_pose],
        "body": _repeated(body.name, len(at_pose)),
        "target": _coded(body.points.targets, at_target),
        **{f"d{a}_mm": residual[:, k] for k, a in enumerate("xyz")},
        "weight": body.used[at_pose, at_target].astype(np.float64),
        "rejected": body.rejected[at_pose, at_target],
        "reason": reason,
        "decision": decisions(body.excluded, body.kept)[at_pose, at_target],
    }


def table_schema(name: str, identifier: str) -> pa.Schema:
    """Return the schema of an artifact with all its columns; texts are dictionary-encoded, but for text poses."""
    schema = ARTIFACTS[name].arrow_schema(identifier, ARTIFACTS[name].optional)
    kinds = [f.with_type(_NAMES) if pa.types.is_string(f.type) and f.name != "pose" else f for f in schema]
    return pa.schema(kinds)


def _table(name: str, parts: Sequence[TableRow], identifier: str) -> pa.Table:
    """Return the parts as one table, with NaN as empty cells."""
    schema = table_schema(name, identifier)
    if not parts:
        return schema.empty_table()
    return pa.concat_tables(
        [pa.table([_column(part[f.name], f.type) for f in schema], schema=schema) for part in parts]
    )


def _column(values: object, kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.DictionaryArray):
        return values
    if pa.types.is_dictionary(kind):
        return pa.array(values, pa.string(), from_pandas=True).dictionary_encode()
    return pa.array(values, kind, from_pandas=True)


def _repeated(name: str, count: int) -> pa.DictionaryArray:
    return _coded((name,), np.zeros(count, np.int32))


def _coded(names: tuple[str, ...], index: Index) -> pa.DictionaryArray:
    """Return names by their numbers (N,)."""
    return pa.DictionaryArray.from_arrays(pa.array(index, pa.int32()), pa.array(names, pa.string()))
