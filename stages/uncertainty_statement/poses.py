"""Uncertainty of poses by source: points, survey, and scatter above the declared noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array
from truing.calibration.calibration_input import PosesWithCovariance
from truing.estimation.covariance import relative
from truing.estimation.rigid_poses.body_poses import body_parts
from truing.estimation.rotation import left_jacobian_so3, log_so3
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source
from truing.schemas.photograph_artifacts import subject_and_name
from truing.simulation.photographs.ray_poses import BAR
from truing.stages.common.calibration_data import body_poses
from truing.stages.common.point_arrays import (
    default_motions,
    fitted_points,
    number_columns,
    pose_ids,
    positions,
    survey_points,
)
from truing.stages.common.point_errors import common_correlation
from truing.stages.uncertainty_statement.causes import found_causes, of_instrument
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Parts = Mapping[Source, Array]  # covariances (B, 6, 6)

_COMPONENTS = ("px", "py", "pz", "rx", "ry", "rz")
_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
_CLOSES = 1e-6  # relative: parts that sum to less, or more, than the covariance that was stated are not its parts
_EFFECTS = (*(f"effect_{a}_mm" for a in "xyz"), *(f"effect_r{a}_rad" for a in "xyz"))
_TO_SI = np.array([1e-3] * 3 + [1.0] * 3)
BARS = Source("lengths of scale bars, common to all poses", "B")
CAMERAS = Source("cameras, adjusted from the rays of all poses, common to all poses", "A")
OWN = Source("rays of the pose itself, and the survey", "A")


def state_poses(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every component of every pose of the platform, or of each body where there is no mechanism."""
    table = tables.get("poses")
    if table is None or not table.num_rows:
        return
    poses = pose_ids(table)
    parents = dict(zip(table.column("body").to_pylist(), table.column("parent").to_pylist(), strict=True))
    bodies = [name for name in parents if name == "platform" or not settings.mechanism.is_legged]
    for body in bodies:
        _state(statement, tables, body, parents[body], poses)
    if bodies:
        if not has_scale(tables):
            text = "no scale bar or certified length determines it"
            statement.omitted("pose", "scale of the measurement", text)
        for name, cause in found_causes(tables).items():
            if of_instrument(cause):
                statement.omitted("pose", name, NOT_HELD)


def _state(
    statement: Statement, tables: Mapping[str, pa.Table], body: str, parent: str, poses: tuple[int | str, ...]
) -> None:
    poses_of_body = body_poses(tables["poses"], body, poses, parent)
    seen = np.flatnonzero(poses_of_body.found)
    if not len(seen):
        statement.not_evaluated("pose", "all", "no pose of it was found", body)
        return
    try:
        of_network = parts_of_network(tables, body, poses, poses_of_body.covariance)
        parts = of_network or _parts(tables, body, parent, poses, poses_of_body) or _total(tables, poses_of_body)
    except np.linalg.LinAlgError:  # a point that is exact along an axis
        parts = _total(tables, poses_of_body)
    vector = log_so3(poses_of_body.R[seen])
    turn = np.linalg.inv(left_jacobian_so3(vector))  # of the rotation vector, by a small rotation before the pose
    estimate = np.concatenate([poses_of_body.p[seen] * 1e3, vector], 1)
    to_units = np.zeros((len(seen), 6, 6))
    to_units[:, :3, :3], to_units[:, 3:, 3:] = np.eye(3) * 1e3, turn
    reported = {
        source: np.einsum("bij,bjk,bik->bi", to_units, covariance[seen], to_units, optimize=True)
        for source, covariance in parts.items()
    }
    contributions = np.sqrt(np.maximum(np.array([row.ravel() for row in reported.values()]), 0.0))
    subject = [f"{body} in {parent}, pose {poses[n]}" for n in seen for _ in _COMPONENTS]
    statement.state(
        "pose",
        subject,
        list(_COMPONENTS) * len(seen),
        estimate.ravel(),
        list(_UNITS) * len(seen),
        Budget(tuple(reported), contributions),
    )


def _total(tables: Mapping[str, pa.Table], poses: PosesWithCovariance) -> Parts:
    """Return the total covariance as the only source, if its parts are unknown."""
    known = "observations" in tables and tables["observations"].column("sigma_x_mm").null_count == 0
    return {Source("points and shape of the body, estimated together", "B" if known else "A"): poses.covariance}


def _parts(
    tables: Mapping[str, pa.Table], body: str, parent: str, poses: tuple[int | str, ...], measured: PosesWithCovariance
) -> Parts | None:
    """Return the contributions of points and surveys of a body and of its reference to the covariance of its poses;
    None unless the poses come from a fit to surveys with declared noise."""
    parts_of_body = _parts_of_body(tables, body, poses)
    if parts_of_body is None:
        return None
    if parent == "measurement":
        parts = parts_of_body
    else:
        parts_of_parent = _parts_of_body(tables, parent, poses)
        if parts_of_parent is None:
            return None
        (R, p), (Ra, pa_) = (default_motions(tables["poses"], name, poses) for name in (body, parent))
        none = np.zeros((len(poses), 6, 6))
        parts = {source: relative(Ra, pa_, none, R, p, covariance)[2] for source, covariance in parts_of_body.items()}
        parts |= {
            source: relative(Ra, pa_, covariance, R, p, none)[2] for source, covariance in parts_of_parent.items()
        }
    by_declared = [covariance for source, covariance in parts.items() if source.evaluation == "B"]
    declared = np.sum(by_declared, axis=0)
    sigma, stated = (np.sqrt(np.diagonal(C[measured.found], axis1=1, axis2=2)) for C in (declared, measured.covariance))
    return parts if np.allclose(sigma, stated, rtol=_CLOSES, atol=0.0) else None


def _parts_of_body(tables: Mapping[str, pa.Table], body: str, poses: tuple[int | str, ...]) -> Parts | None:
    """Return covariances (B, 6, 6) of a body in the measurement frame, from its points, its survey, and scatter beyond
    them."""
    if "survey" not in tables or "observations" not in tables:
        return None
    survey = survey_points(tables["survey"], body)
    return body_parts(body, survey, fitted_points(tables, body, poses, survey.targets))


def parts_of_network(
    tables: Mapping[str, pa.Table], body: str, poses: tuple[int | str, ...], covariance: Array
) -> Mapping[Source, Array] | None:
    """Return the parts (B, 6, 6) of a body's covariance in m and rad; None if its points do not come from
    photographs."""
    effects = tables.get("pose_sensitivities")
    if effects is None or not effects.num_rows:
        return None
    rows = effects.filter(pc.equal(effects.column("body"), body))
    if not rows.num_rows:
        return None
    parameters = tuple(dict.fromkeys(rows.column("parameter").to_pylist()))
    by = np.zeros((len(poses), 6, len(parameters)))
    index = positions(rows.column("pose"), poses), positions(rows.column("parameter"), parameters)
    by[index[0], :, index[1]] = number_columns(rows, _EFFECTS) * _TO_SI
    correlation = common_correlation(tables.get("camera_correlations"), parameters)
    bar = np.array([subject_and_name(name)[0] == BAR for name in parameters], dtype=bool)
    common = by @ correlation @ np.swapaxes(by, 1, 2)
    by_bars = by[:, :, bar] @ correlation[np.ix_(bar, bar)] @ np.swapaxes(by[:, :, bar], 1, 2)
    parts = {CAMERAS: common - by_bars, OWN: covariance - common}
    return {BARS: by_bars, **parts} if bar.any() else parts


def has_scale(tables: Mapping[str, pa.Table]) -> bool:
    """Return True if scale bars define the scale, so that their uncertainty is in the budgets."""
    lengths = tables.get("scale_bar_lengths")
    return lengths is not None and "scale" in lengths.column("serves").to_pylist()
