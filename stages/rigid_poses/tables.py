"""The rows of the poses and residuals artifacts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.covariance import relative_slope
from truing.estimation.measured_numbers import pose_numbers
from truing.estimation.rigid_poses.body_poses import BodyPoses, seen_from
from truing.estimation.rotation import log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.point_arrays import decisions

MEASUREMENT = "measurement"
_COVARIANCE = [(i, j) for i in range(6) for j in range(i, 6)]


def poses_table(
    bodies: Sequence[BodyPoses], reference: str | None, identifier: str, frame: str = MEASUREMENT
) -> pa.Table:
    """One row per pose, body and method; bodies other than the reference are seen from it, those of a campaign without
    it from ``frame``: what the frame of the measurement is called."""
    base = next((body for body in bodies if body.name == reference), None)
    parts = [
        _pose_columns(body, method, None if body is base else base, frame) for body in bodies for method in body.fits
    ]
    return _table("poses", parts, identifier)


def residuals_table(bodies: Sequence[BodyPoses], identifier: str) -> pa.Table:
    """One row per observed point: measured minus fitted by the default method, and whether it was used."""
    return _table("residuals", [_residual_columns(body) for body in bodies], identifier)


def _pose_columns(body: BodyPoses, method: str, base: BodyPoses | None, frame: str) -> dict[str, Any]:
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
        "pose": np.array(body.points.poses, dtype=object),
        "body": np.full(count, body.name, dtype=object),
        "parent": np.full(count, frame if base is None else base.name, dtype=object),
        "method": np.full(count, method, dtype=object),
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
    """What one standard deviation of each parameter common to all poses does to each default pose."""
    base = next((body for body in bodies if body.name == reference), None)
    told = [body for body in bodies if body.effects is not None]
    parts = [_effect_columns(body, None if body is base else base, parameters) for body in told]
    return _table("pose_sensitivities", parts, identifier)


def _effect_columns(body: BodyPoses, base: BodyPoses | None, parameters: Sequence[str]) -> dict[str, Any]:
    effects = cast("NDArray[np.float64]", body.effects)
    if base is not None and base.effects is not None:
        slope = relative_slope(base.fit.R, base.fit.t, body.fit.t)
        effects = slope @ np.concatenate([base.effects, effects], axis=1)
    at_pose, at_parameter = np.nonzero(np.isfinite(effects).all(axis=1))
    values = effects[at_pose, :, at_parameter]
    count = len(at_pose)
    return {
        "pose": np.array(body.points.poses, dtype=object)[at_pose],
        "body": np.full(count, body.name, dtype=object),
        "parent": np.full(count, MEASUREMENT if base is None else base.name, dtype=object),
        "parameter": np.array(parameters, dtype=object)[at_parameter],
        **{f"effect_{a}_mm": 1e3 * values[:, k] for k, a in enumerate("xyz")},
        **{f"effect_r{a}_rad": values[:, 3 + k] for k, a in enumerate("xyz")},
    }


def covariances_table(bodies: Sequence[BodyPoses], reference: str | None, identifier: str) -> pa.Table:
    """Covariances between the default poses of different bodies, as the reference sees them, where points have errors
    in common."""
    base = next((body for body in bodies if body.name == reference), None)
    others = [body for body in bodies if body is not base]
    parts = [_between(body, other, base) for n, body in enumerate(others) for other in others[n + 1 :]]
    return _table("pose_covariances", [part for part in parts if part], identifier)


def _between(body: BodyPoses, other: BodyPoses, base: BodyPoses | None) -> dict[str, Any]:
    """Rows for one pair of bodies, of the poses in which they, and the reference, were fitted together."""
    known = body.cross.get((body.default, other.name))
    if known is None:
        return {}
    covariance = known
    if base is not None:
        by_base, by_other = (one.cross.get((one.default, two.name)) for one, two in ((body, base), (base, other)))
        if by_base is None or by_other is None:
            return {}
        own, far = (relative_slope(base.fit.R, base.fit.t, one.fit.t) for one in (body, other))
        whole = np.block([[base.fit.covariance, by_other], [by_base, known]])
        covariance = own @ whole @ np.swapaxes(far, 1, 2)
    told = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    pose, i, j = (grid.ravel() for grid in np.meshgrid(told, np.arange(6), np.arange(6), indexing="ij"))
    return {
        "pose": np.array(body.points.poses, dtype=object)[pose],
        "measured_number": pose_numbers(body.name)[i],
        "other_number": pose_numbers(other.name)[j],
        "joint_covariance": covariance[pose, i, j],
    }


def _residual_columns(body: BodyPoses) -> dict[str, Any]:
    at_pose, at_target = np.nonzero(body.points.seen)
    residual = 1e3 * body.residual[at_pose, at_target]
    return {
        "pose": np.array(body.points.poses, dtype=object)[at_pose],
        "body": np.full(len(at_pose), body.name, dtype=object),
        "target": np.array(body.points.targets, dtype=object)[at_target],
        **{f"d{a}_mm": residual[:, k] for k, a in enumerate("xyz")},
        "weight": body.used[at_pose, at_target].astype(np.float64),
        "rejected": body.rejected[at_pose, at_target],
        "reason": np.array([r or None for r in body.reason[at_pose, at_target]], dtype=object),
        "decision": decisions(body.excluded, body.kept)[at_pose, at_target],
    }


def _table(name: str, parts: list[dict[str, Any]], identifier: str) -> pa.Table:
    """The parts one after the other, NaN as empty."""
    schema = ARTIFACTS[name].arrow_schema(identifier, ARTIFACTS[name].optional)
    if not parts:
        return schema.empty_table()
    columns = {key: np.concatenate([part[key] for part in parts]) for key in schema.names}
    return pa.table(
        [pa.array(columns[key], schema.field(key).type, from_pandas=True) for key in schema.names], schema=schema
    )
